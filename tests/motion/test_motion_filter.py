import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import minimize, nnls

from ssm_service.errors import InputError
from ssm_service.motion import Box, VelocityFilter, task_metric
from ssm_service.motion import filter as module
from ssm_service.motion.filter import DAMPING_M_RAD, MOST_SOFT, TOLERANCE_M_S

K = 6
SEEDED = settings(max_examples=200, derandomize=True, deadline=None, database=None)
WIDE = (np.full(K, -1.5), np.full(K, 1.5))


class Case:
    """A random programme: gradients over four decades, boxes with shut sides, doubled and opposed rows."""

    def __init__(self, seed, pairs=25, asked=0.15, soft=False):
        rng, self.soft = np.random.default_rng(seed), soft
        p = int(rng.integers(1, pairs + 1))
        gradients = rng.normal(size=(p, K)) * 10.0 ** rng.uniform(-4.0, 0.0, (p, 1))
        bounds = np.abs(rng.normal(size=p)) * 0.3
        bounds[rng.random(p) < asked] *= -1.0
        bounds[rng.random(p) < 0.2] = 0.0
        chosen = rng.integers(0, p, 2)
        if rng.random() < 0.5:
            gradients = np.vstack([gradients, gradients[chosen[0]], -gradients[chosen[1]]])
            bounds = np.append(bounds, [abs(bounds[chosen[0]]), 0.0])
        gradients[rng.random(len(gradients)) < 0.1] = 0.0
        gradients[:, rng.random(K) < 0.1] = 0.0
        self.lower, self.upper = -rng.random(K) * 1.5, rng.random(K) * 1.5
        self.lower[rng.random(K) < 0.1] = 0.0
        self.upper[rng.random(K) < 0.1] = 0.0
        self.wanted, self.gradients, self.bounds = rng.normal(size=K), gradients, bounds
        self.ceilings, self.softness = np.maximum(bounds, 0.0), np.full(len(bounds), DAMPING_M_RAD)
        if soft:
            self.ceilings = self.ceilings + rng.random(len(bounds)) * 0.2 * (rng.random(len(bounds)) < 0.7)
            self.softness = DAMPING_M_RAD * rng.uniform(0.3, 5.0, len(bounds))
        self.metric = task_metric(rng.normal(size=(3, K)) * 0.3) if rng.random() < 0.5 else None
        self.rng = rng

    def solve(self, **changes):
        values = {**vars(self), **changes}
        box = (values["lower"], values["upper"])
        more = (values["ceilings"], values["softness"]) if self.soft else ()
        return VelocityFilter().solve(
            values["wanted"], values["gradients"], values["bounds"], box, values["metric"], *more
        )

    def slack(self, velocity):
        """Return what the rows with slack are short of, those whose bound is below their ceiling."""
        ends = self.gradients * self.lower, self.gradients * self.upper
        moved = np.maximum(np.maximum(*ends).sum(axis=1), -np.minimum(*ends).sum(axis=1)) > TOLERANCE_M_S
        short = np.maximum(0.0, self.gradients @ velocity - self.bounds)
        return short * (moved & (self.bounds < self.ceilings))

    def cost(self, velocity):
        off = velocity - self.wanted
        weights = np.eye(K) if self.metric is None else self.metric
        slack = self.slack(velocity) / self.softness
        return 0.5 * off @ weights @ off + 0.5 * slack @ slack

    def slope(self, velocity):
        off = velocity - self.wanted
        task = off if self.metric is None else self.metric @ off
        return task + self.gradients.T @ (self.slack(velocity) / self.softness**2)

    def assert_admitted(self, velocity):
        assert (velocity >= self.lower).all()
        assert (velocity <= self.upper).all()
        assert (self.gradients @ velocity <= np.maximum(self.ceilings, TOLERANCE_M_S)).all()


@pytest.mark.parametrize("soft", [False, True])
@pytest.mark.parametrize("seed", range(150))
def test_fulfils_every_constraint_and_the_conditions_of_optimality(seed, soft):
    """The slope of the cost is a sum, with weights ≥ 0, of the normals of the constraints that are tight."""
    case = Case(seed, pairs=MOST_SOFT - 4, soft=soft)
    found = case.solve()
    case.assert_admitted(found.velocity)
    assert found.status in ("free", "solved")
    tight = case.gradients @ found.velocity >= case.ceilings - 1e-5
    normals = [
        *case.gradients[tight & case.gradients.any(axis=1)],
        *np.eye(K)[found.velocity >= case.upper - 1e-6],
        *-np.eye(K)[found.velocity <= case.lower + 1e-6],
    ]
    slope = case.slope(found.velocity)
    scaled = [normal / np.linalg.norm(normal) for normal in normals]
    rest = nnls(np.array(scaled).T, -slope)[1] if normals else np.linalg.norm(slope)
    # What is admitted may be scaled by 1e-7 of itself, and a slack is stiff.
    assert rest <= 1e-3 * max(1.0, np.linalg.norm(slope))


@pytest.mark.parametrize("soft", [False, True])
@pytest.mark.parametrize("seed", range(8))
def test_agrees_with_a_general_optimiser(seed, soft):
    case = Case(1000 + seed, pairs=8, soft=soft)
    found = case.solve().velocity
    other = minimize(
        case.cost,
        np.zeros(K),
        jac=case.slope,
        bounds=list(zip(case.lower, case.upper, strict=True)),
        constraints={
            "type": "ineq",
            "fun": lambda v: case.ceilings - case.gradients @ v,
            "jac": lambda v: -case.gradients,
        },
        method="SLSQP",
        options={"maxiter": 500, "ftol": 1e-12},
    )
    assert case.cost(found) <= case.cost(other.x) + 1e-5 * max(1.0, case.cost(other.x))


@pytest.mark.parametrize("seed", range(100))
def test_the_order_of_the_pairs_does_not_matter(seed):
    case = Case(2000 + seed, pairs=MOST_SOFT - 4, soft=seed % 2 == 0)
    order = case.rng.permutation(len(case.bounds))
    one = case.solve()
    other = case.solve(
        **{name: getattr(case, name)[order] for name in ("gradients", "bounds", "ceilings", "softness")}
    )
    np.testing.assert_allclose(other.velocity, one.velocity, atol=2e-6)
    assert other.retreating == one.retreating
    assert other.missed == pytest.approx(one.missed, abs=1e-6)
    assert {int(order[i]) for i in other.active} == set(one.active)


def test_more_retreats_than_can_be_tasks_in_any_order():
    rng = np.random.default_rng(3)
    gradients = rng.normal(size=(80, K)) * 0.02 + np.array([0.3, 0.2, 0.1, 0.0, 0.0, 0.0])
    bounds = np.full(80, -0.1)
    bounds[MOST_SOFT:] = -0.05
    found = VelocityFilter().solve(np.ones(K), gradients, bounds, WIDE)
    order = rng.permutation(80)
    other = VelocityFilter().solve(np.ones(K), gradients[order], bounds[order], WIDE)
    np.testing.assert_allclose(other.velocity, found.velocity, atol=1e-7)
    assert (gradients @ found.velocity <= TOLERANCE_M_S).all()
    assert found.retreating
    assert found.missed < 0.01
    same = np.full(80, -0.1)  # of equal urgency the choice must not hang on the order either
    one = VelocityFilter().solve(np.ones(K), gradients, same, WIDE)
    two = VelocityFilter().solve(np.ones(K), gradients[order], same, WIDE)
    np.testing.assert_allclose(two.velocity, one.velocity, atol=1e-7)


@pytest.mark.parametrize("seed", range(40))
def test_equal_inputs_give_equal_bits_whatever_came_before(seed):
    case = Case(3000 + seed)
    solver = VelocityFilter()
    box = (case.lower, case.upper)
    first = solver.solve(case.wanted, case.gradients, case.bounds, box, case.metric)
    solver.solve(-case.wanted, -case.gradients[:1], case.bounds[:1], box)
    again = solver.solve(case.wanted, case.gradients, case.bounds, box, case.metric)
    assert first.velocity.tobytes() == again.velocity.tobytes()


@pytest.mark.parametrize("seed", range(40))
def test_a_pair_given_twice_changes_nothing(seed):
    case = Case(4000 + seed, asked=0.0)
    one = case.solve().velocity
    twice = case.solve(
        gradients=np.vstack([case.gradients, case.gradients]), bounds=np.tile(case.bounds, 2)
    ).velocity
    np.testing.assert_allclose(twice, one, atol=2e-6)


@SEEDED
@given(st.integers(0, 10_000), st.floats(-0.5, 0.5))
def test_one_pair_alone_has_a_closed_form(seed, bound):
    rng = np.random.default_rng(seed)
    gradient, wanted = rng.normal(size=K) * 0.3, rng.normal(size=K) * 0.3
    found = VelocityFilter().solve(
        wanted, gradient[None], np.array([bound]), (np.full(K, -100.0), np.full(K, 100.0))
    )
    square = gradient @ gradient
    expected = wanted - gradient * max(0.0, gradient @ wanted - max(bound, 0.0)) / square
    if bound < 0.0:
        damped = wanted - gradient * max(0.0, gradient @ wanted - bound) / (square + DAMPING_M_RAD**2)
        expected = damped if gradient @ damped <= 0.0 else expected
    np.testing.assert_allclose(found.velocity, expected, atol=1e-6)


def test_nothing_in_the_way_gives_the_wanted_velocity_to_the_bit():
    rng = np.random.default_rng(1)
    wanted = rng.normal(size=K) * 0.1
    gradients = rng.normal(size=(80, K)) * 0.3
    for metric in (None, task_metric(gradients[:3])):
        found = VelocityFilter().solve(wanted, gradients, np.full(80, np.inf), WIDE, metric)
        assert found.velocity.tobytes() == wanted.tobytes()
        assert (found.active, found.retreating, found.missed, found.status) == ((), False, 0.0, "free")
    empty = VelocityFilter().solve(wanted, np.empty((0, K)), np.empty(0), WIDE)
    assert empty.velocity.tobytes() == wanted.tobytes()


@pytest.mark.parametrize("seed", range(60))
def test_without_pairs_the_box_alone_says_the_same(seed):
    case = Case(seed)
    none = {"gradients": np.empty((0, K)), "bounds": np.empty(0)}
    found = module.in_box(case.wanted, Box(case.lower, case.upper), case.metric)
    expected = case.solve(**none)
    np.testing.assert_allclose(found.velocity, expected.velocity, atol=1e-9)
    assert (found.active, found.retreating, found.missed, found.rows) == ((), False, 0.0, 0)
    whole = bool((found.velocity == case.wanted).all())
    assert found.status == ("free" if case.metric is None or whole else "solved") == expected.status
    assert (found.velocity >= case.lower).all()
    assert (found.velocity <= case.upper).all()


def test_alone_what_the_box_holds_comes_back_to_the_bit():
    case = next(case for case in map(Case, range(99)) if case.metric is not None)
    inside = 0.5 * np.minimum(case.upper, -case.lower)
    found = module.in_box(inside, Box(case.lower, case.upper), case.metric)
    np.testing.assert_array_equal(found.velocity, inside)
    assert found.status == "free"


def test_alone_it_leaves_its_arguments_alone_and_refuses_the_same(monkeypatch):
    case = next(case for case in map(Case, range(99)) if case.metric is not None)
    given = [case.wanted, case.lower, case.upper, case.metric]
    before = [array.copy() for array in given]
    module.in_box(case.wanted, Box(case.lower, case.upper), case.metric)
    for array, copy in zip(given, before, strict=True):
        np.testing.assert_array_equal(array, copy)
    for place in range(4):
        broken = [array.copy() for array in before]
        broken[place].flat[0] = np.nan
        with pytest.raises(InputError) as caught:
            module.in_box(broken[0], Box(broken[1], broken[2]), broken[3])
        assert caught.value.cause == "not_finite"
    for flag, solution in ((-1, np.zeros(K)), (1, np.full(K, np.nan))):
        monkeypatch.setattr(module.daqp, "solve", lambda *_, f=flag, s=solution, **__: (s, 0.0, f, {}))
        assert module.in_box(case.wanted, Box(case.lower, case.upper), case.metric) is None


def test_at_rest_it_retreats_and_each_joint_takes_its_share():
    gradient = np.array([0.3, -0.2, 0.1, 0.0, 0.0, 0.0])
    found = VelocityFilter().solve(np.zeros(K), gradient[None], np.array([-0.1]), WIDE)
    assert found.retreating
    assert found.active == (0,)
    np.testing.assert_allclose(gradient @ found.velocity, -0.1, rtol=2e-3)
    assert found.missed == pytest.approx(0.1 + gradient @ found.velocity, abs=1e-12)
    np.testing.assert_allclose(found.velocity, -0.1 * gradient / (gradient @ gradient + 1e-4), rtol=1e-6)


def test_a_retreat_that_the_box_holds_goes_as_far_as_the_box():
    gradient = np.array([0.3, -0.2, 0.1, 0.0, 0.0, 0.0])
    box = (np.full(K, -0.03), np.full(K, 0.03))
    found = VelocityFilter().solve(np.ones(K), gradient[None], np.array([-0.5]), box)
    np.testing.assert_allclose(found.velocity[:3], [-0.03, 0.03, -0.03], atol=1e-9)
    np.testing.assert_allclose(found.velocity[3:], 0.03, atol=1e-9)  # the rest of the task goes on
    assert found.missed == pytest.approx(0.5 - 0.018)


def test_pinned_between_two_obstacles_it_stands_and_the_rest_goes_on():
    gradient = np.array([0.3, -0.2, 0.1, 0.0, 0.0, 0.0])
    rows, bounds = np.array([gradient, -gradient]), np.array([-0.2, -0.1])
    found = VelocityFilter().solve(np.array([0.0, 0.0, 0.0, 0.0, 0.4, 0.0]), rows, bounds, WIDE)
    assert abs(gradient @ found.velocity) <= TOLERANCE_M_S
    assert found.velocity[4] == pytest.approx(0.4, abs=1e-6)
    assert not found.retreating
    assert found.missed == pytest.approx(0.2, abs=1e-6)


def test_in_penetration_it_goes_out_and_never_deeper():
    gradient = np.array([0.3, 0.0, 0.0, 0.0, 0.0, 0.0])
    outwards, inwards = np.array([-0.5, 0.1, 0, 0, 0, 0]), np.array([0.5, 0.1, 0, 0, 0, 0])
    bound = np.array([-0.1])
    out = VelocityFilter().solve(outwards, gradient[None], bound, WIDE)
    np.testing.assert_allclose(out.velocity, outwards, atol=1e-9)  # 0.15 m/s is more than was asked
    deeper = VelocityFilter().solve(inwards, gradient[None], bound, WIDE)
    assert gradient @ deeper.velocity < -0.09
    assert deeper.velocity[1] == pytest.approx(0.1)


def test_a_margin_gives_way_to_a_retreat_and_to_little_else():
    """A plate at the margin on one side, a ball that comes from the other: the link leaves the margin."""
    gradient = np.array([0.3, 0.0, 0.0, 0.0, 0.0, 0.0])
    rows, bounds, ceilings = np.array([gradient, -gradient]), np.array([0.0, -0.2]), np.array([0.25, 0.0])
    soft = np.array([5.0 * DAMPING_M_RAD, DAMPING_M_RAD])
    hit = VelocityFilter().solve(np.zeros(K), rows, bounds, WIDE, None, ceilings, soft)
    assert 0.18 < gradient @ hit.velocity < 0.2
    assert hit.retreating
    waiting = VelocityFilter().solve(np.zeros(K), rows, bounds, WIDE)  # with the margin a hard row
    np.testing.assert_allclose(waiting.velocity, 0.0, atol=1e-6)
    ceilings[0] = 0.05
    held = VelocityFilter().solve(np.zeros(K), rows, bounds, WIDE, None, ceilings, soft)
    assert gradient @ held.velocity == pytest.approx(0.05, abs=1e-6)
    into = VelocityFilter().solve(np.eye(K)[0], rows[:1], bounds[:1], WIDE, None, np.ones(1))
    assert 0.0 <= gradient @ into.velocity < 1e-3  # 1 rad/s is no reason
    assert into.active == (0,)


def test_links_that_no_joint_moves_ask_for_nothing():
    gradients = np.zeros((3, K))
    gradients[1, 0] = 1e-12
    found = VelocityFilter().solve(np.full(K, 0.2), gradients, np.array([-0.5, -0.5, 0.0]), WIDE)
    np.testing.assert_array_equal(found.velocity, np.full(K, 0.2))
    assert (found.missed, found.retreating, found.active) == (0.0, False, ())


@pytest.mark.parametrize("bound", [-0.5, -0.01, 0.0])
def test_a_vanishing_lever_makes_no_joint_race(bound):
    """The velocity goes to 0 with the gradient: a retreat is damped and does not jump at a singularity."""
    speeds = []
    for lever in (1.0, 0.1, 1e-2, 1e-3, 1e-4, 1e-5, 1e-6, 1e-7):
        gradient = np.zeros((1, K))
        gradient[0, 1] = lever
        found = VelocityFilter().solve(
            np.zeros(K), gradient, np.array([bound]), (np.full(K, -100.0), np.full(K, 100.0))
        )
        speeds.append(-found.velocity[1])
    assert max(speeds) <= -bound / (2.0 * DAMPING_M_RAD) + 1e-6
    assert speeds[-1] <= 1e-2
    assert min(speeds) >= 0.0


def test_continuous_as_the_bound_passes_zero():
    gradient = np.array([[0.3, -0.2, 0.1, 0.05, 0.0, 0.0]])
    wanted = np.array([0.5, 0.1, -0.1, 0.0, 0.3, 0.0])
    found = [
        VelocityFilter().solve(wanted, gradient, np.array([b]), WIDE).velocity
        for b in np.linspace(-0.02, 0.02, 401)
    ]
    assert np.abs(np.diff(found, axis=0)).max() < 1e-3


def test_the_metric_lets_the_other_joints_give():
    """The elbow is in the way; with the metric the end effector keeps its way, without it, it does not."""
    rng = np.random.default_rng(5)
    jacobian = rng.normal(size=(3, K)) * 0.3
    wanted = rng.normal(size=K) * 0.3
    gradient = jacobian[:1] * 0.0 + rng.normal(size=(1, K)) * 0.3
    bound = np.array([float(gradient[0] @ wanted) - 0.1])
    plain = VelocityFilter().solve(wanted, gradient, bound, WIDE).velocity
    held = VelocityFilter().solve(wanted, gradient, bound, WIDE, task_metric(jacobian)).velocity
    off = [np.linalg.norm(jacobian @ (v - wanted)) for v in (plain, held)]
    assert off[1] < 0.2 * off[0]
    metric = task_metric(jacobian)
    assert metric.trace() == pytest.approx(K)
    assert (np.linalg.eigvalsh(metric) > 0.0).all()
    np.testing.assert_array_equal(task_metric(np.zeros((3, K))), np.eye(K))


def test_active_names_the_worst_offender_first():
    gradients = np.eye(K)[:3] * 0.5
    found = VelocityFilter().solve(
        np.array([0.3, 0.9, 0.1, 0, 0, 0]), gradients, np.array([0.1, 0.1, 0.1]), WIDE
    )
    assert found.active == (1, 0)


@pytest.mark.parametrize("flag", [-1, -4, 1])
@pytest.mark.parametrize("seed", range(30))
def test_when_the_solver_fails_what_is_left_is_safe(monkeypatch, flag, seed):
    """Also when it claims success and returns NaN."""
    case = Case(5000 + seed, asked=0.3, soft=seed % 2 == 0)
    monkeypatch.setattr(module.daqp, "solve", lambda *_, **__: (np.full(64, np.nan), 0.0, flag, {}))
    found = case.solve()
    case.assert_admitted(found.velocity)
    assert found.status in ("free", "fallback")
    assert case.cost(found.velocity) <= case.cost(np.zeros(K)) + 1e-9


@pytest.mark.parametrize("seed", range(30))
def test_what_the_solver_returns_is_checked(monkeypatch, seed):
    case = Case(6000 + seed, soft=seed % 2 == 0)
    wrong = case.rng.normal(size=64) * 3.0
    monkeypatch.setattr(module.daqp, "solve", lambda *_, **__: (wrong, 0.0, 1, {}))
    case.assert_admitted(case.solve().velocity)


def test_a_failing_solver_still_retreats(monkeypatch):
    monkeypatch.setattr(module.daqp, "solve", lambda *_, **__: (np.zeros(64), 0.0, -4, {}))
    gradient = np.array([[0.3, -0.2, 0.1, 0.0, 0.0, 0.0]])
    found = VelocityFilter().solve(np.zeros(K), gradient, np.array([-0.1]), WIDE)
    assert found.status == "fallback"
    assert found.retreating
    part = VelocityFilter().solve(np.ones(K), gradient, np.array([0.05]), WIDE)
    assert part.status == "fallback"
    assert float(gradient[0] @ part.velocity) == pytest.approx(0.05)


@pytest.mark.parametrize(
    "name", ["wanted", "gradients", "bounds", "lower", "upper", "metric", "ceilings", "softness"]
)
@pytest.mark.parametrize("bad", [math.nan, -math.inf])
def test_refuses_what_is_not_a_number(name, bad):
    case = Case(7, soft=True)
    case.metric = np.eye(K)
    getattr(case, name)[..., 0] = bad
    with pytest.raises(InputError) as caught:
        case.solve()
    assert caught.value.cause == "not_finite"


def test_refuses_boxes_without_zero_and_wrong_shapes():
    case = Case(7, soft=True)
    with pytest.raises(InputError) as caught:
        case.solve(softness=case.softness * np.where(np.arange(len(case.bounds)), 1.0, 0.0))
    assert caught.value.cause == "out_of_range"
    with pytest.raises(InputError, match="lower ≤ 0 ≤ upper"):
        case.solve(lower=np.full(K, 0.1))
    with pytest.raises(InputError, match="lower ≤ 0 ≤ upper"):
        case.solve(upper=np.full(K, -0.1))
    for changes in (
        {"wanted": np.zeros(K - 1)},
        {"bounds": np.zeros(len(case.bounds) + 1)},
        {"metric": np.eye(K - 1)},
        {"lower": np.zeros(1)},
        {"ceilings": np.zeros(1)},
        {"softness": np.ones(1)},
    ):
        with pytest.raises(InputError) as caught:
            case.solve(**changes)
        assert caught.value.cause == "wrong_length"
    for damping in (0.0, -1.0, math.nan, math.inf):
        with pytest.raises(InputError):
            VelocityFilter(damping)


def test_leaves_its_arguments_alone_and_returns_a_new_array():
    case = Case(11)
    before = [case.wanted.copy(), case.gradients.copy(), case.bounds.copy()]
    case.solve().velocity[:] = 7.0
    for array, old in zip((case.wanted, case.gradients, case.bounds), before, strict=True):
        np.testing.assert_array_equal(array, old)
