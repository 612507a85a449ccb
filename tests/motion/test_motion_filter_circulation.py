import math

import numpy as np
import pytest

from ssm_service.config import FilterConfig
from ssm_service.errors import InputError
from ssm_service.motion import VelocityFilter, barrier_bounds
from ssm_service.motion.circulation import LEAVE_S, SENSE_S, STUCK_S, WAIT_S, Circulation

CONFIG = FilterConfig()
DT = 0.008
SPEED = 0.1
FREE = (np.full(3, -0.5), np.full(3, 0.5))


class Ball:
    def __init__(self, centre, radius):
        self.centre, self.radius = np.array(centre), radius

    def nearest(self, point):
        offset = point - self.centre
        size = float(np.linalg.norm(offset))
        return size - self.radius, offset / size


class Block:
    """An upright box."""

    def __init__(self, low, high):
        self.low, self.high = np.array(low), np.array(high)

    def nearest(self, point):
        offset = point - np.clip(point, self.low, self.high)
        size = float(np.linalg.norm(offset))
        return size, offset / size


class Point:
    """A point that flies to its goal through the filter: its joints are its coordinates."""

    def __init__(self, obstacles, goal, config=CONFIG):
        self.obstacles, self.goal = obstacles, np.array(goal)
        self.circulation, self.filter = Circulation(config), VelocityFilter()
        self.position, self.blocked, self.normal = np.array([-0.4, 0.0, 0.0]), False, np.zeros(3)
        self.path, self.added, self.least = [], [], math.inf

    def run(self, seconds):
        for _ in range(int(seconds / DT)):
            self.tick()
        return self

    def tick(self):
        offset = self.goal - self.position
        distance = float(np.linalg.norm(offset))
        wanted = offset * min(2.0, SPEED / distance) if distance > 1e-3 else np.zeros(3)
        added = self.circulation.step(wanted, self.normal, self.blocked, distance, DT)
        found = [obstacle.nearest(self.position) for obstacle in self.obstacles]
        distances, normals = np.array([d for d, _ in found]), np.array([n for _, n in found])
        bounds = barrier_bounds(distances, np.zeros(len(found)), CONFIG)
        asked = wanted + added
        result = self.filter.solve(asked, -normals, bounds, FREE)
        self.blocked = bool(result.active) and asked @ result.velocity < 0.3 * (asked @ asked)
        self.normal = normals[result.active[0]] if result.active else np.zeros(3)
        self.position = self.position + DT * result.velocity
        self.path.append(self.position)
        self.added.append(added)
        self.least = min(self.least, distances.min())

    @property
    def arrived(self):
        return float(np.linalg.norm(self.goal - self.position)) < 2e-3


BALL = Ball([0.0, 0.0, 0.0], 0.12)
WALL = Block([-0.05, -0.2, -0.3], [0.05, 0.25, 0.15])
CORNER = [Block([-0.05, -0.2, -0.2], [0.05, 0.2, 0.2]), Block([-0.3, 0.1, -0.2], [0.05, 0.2, 0.2])]
GOAL = [0.4, 0.0, 0.0]


def test_without_it_the_point_stays_before_the_ball():
    point = Point([BALL], GOAL, FilterConfig(circulation_m_s=0.0)).run(30)
    assert not point.arrived
    assert point.position[0] < -0.14
    assert not np.any(point.added)


@pytest.mark.parametrize("obstacles", [[BALL], [WALL], CORNER], ids=["ball", "wall", "corner"])
def test_with_it_the_point_goes_round(obstacles):
    point = Point(obstacles, GOAL).run(40)
    assert point.arrived
    assert point.least >= CONFIG.margin_m - 1e-3
    assert not point.circulation.circulating


def test_it_keeps_its_sense_and_its_plane_round_the_ball():
    point = Point([BALL], GOAL).run(30)
    path = np.array(point.path)
    assert np.abs(path[:, 1]).max() < 1e-3  # upwards: the way leans nowhere
    assert path[:, 2].min() > -1e-6
    angle = np.unwrap(np.arctan2(path[:, 2], path[:, 0]))
    assert (np.diff(angle) < 1e-9).all()


@pytest.mark.parametrize("offset", [-0.05, 0.05])
def test_it_begins_with_the_side_to_which_the_way_leans(offset):
    circulation = Circulation(CONFIG)
    wanted = np.array([0.1, offset, 0.0])
    normal = np.array([-1.0, 0.0, 0.0])
    for _ in range(int(WAIT_S / DT) + 2):
        added = circulation.step(wanted, normal, True, 0.5, DT)
    assert math.copysign(1.0, added[1]) == math.copysign(1.0, offset)
    np.testing.assert_allclose(np.abs(added), [0.0, CONFIG.circulation_m_s, 0.0], atol=1e-15)


def test_it_gives_up_in_a_bounded_time_and_says_so():
    """Closed in: blocked whatever it does; each sense is tried once."""
    circulation = Circulation(CONFIG)
    normal = np.array([-1.0, 0.0, 0.0])
    seen, ticks = [], 0
    while not circulation.exhausted:
        ticks += 1
        assert ticks * DT < WAIT_S + 4 * STUCK_S + 0.1
        added = circulation.step(np.array([0.1, 0.0, 0.0]), normal, True, 0.5, DT)
        if added.any() and not any(np.allclose(added, other) for other in seen):
            seen.append(added)
    assert len(seen) == 4
    np.testing.assert_allclose(sum(seen), 0.0, atol=1e-15)
    for _ in range(1000):
        assert not circulation.step(np.array([0.1, 0.0, 0.0]), normal, True, 0.5, DT).any()
    circulation.reset()
    assert not circulation.exhausted
    for _ in range(int(WAIT_S / DT) + 2):
        added = circulation.step(np.array([0.1, 0.0, 0.0]), normal, True, 0.5, DT)
    assert added.any()


def test_a_trap_costs_a_bounded_time_however_it_moves_in_it():
    trap = [
        Block([0.0, -0.6, -0.6], [0.02, 0.6, 0.6]),
        *(Block(low, high) for low, high in (
            ([-0.6, 0.58, -0.6], [0.0, 0.6, 0.6]), ([-0.6, -0.6, -0.6], [0.0, -0.58, 0.6]),
            ([-0.6, -0.6, 0.58], [0.0, 0.6, 0.6]), ([-0.6, -0.6, -0.6], [0.0, 0.6, -0.58]),
        )),
    ]  # fmt: skip
    point = Point(trap, GOAL).run(60)
    assert point.circulation.exhausted
    assert np.any(point.added, axis=1).sum() * DT <= 4 * SENSE_S + 0.1
    assert point.least >= CONFIG.margin_m - 1e-3
    assert not np.any(point.added[-500:])


def test_progress_gives_every_sense_another_chance():
    circulation = Circulation(CONFIG)
    normal, wanted = np.array([-1.0, 0.0, 0.0]), np.array([0.1, 0.0, 0.0])
    while not circulation.exhausted:
        circulation.step(wanted, normal, True, 0.5, DT)
    circulation.step(wanted, normal, False, 0.47, DT)
    assert not circulation.exhausted
    added = [circulation.step(wanted, normal, True, 0.47, DT) for _ in range(int(WAIT_S / DT) + 2)]
    assert added[-1].any()


def test_a_short_block_is_waited_out():
    circulation = Circulation(CONFIG)
    for tick in range(2000):
        added = circulation.step(
            np.array([0.1, 0.0, 0.0]), np.array([-1.0, 0.0, 0.0]), tick % 30 != 0, 0.5, DT
        )
        assert not added.any()


@pytest.mark.parametrize("seed", range(20))
def test_it_runs_along_the_surface_and_takes_out_what_is_against_it(seed):
    rng = np.random.default_rng(seed)
    normal = rng.normal(size=3)
    normal /= np.linalg.norm(normal)
    wanted = rng.normal(size=3) * 0.1
    wanted -= (wanted @ normal + 0.1) * normal
    circulation = Circulation(CONFIG)
    for _ in range(int(WAIT_S / DT) + 2):
        added = circulation.step(wanted, normal, True, 0.5, DT)
    assert abs(added @ normal) < 1e-12
    other = rng.normal(size=3) * 0.1
    turned = circulation.step(other, normal, False, 0.5, DT)
    tangent = added / np.linalg.norm(added)
    assert (other + turned) @ tangent == pytest.approx(
        CONFIG.circulation_m_s + max(0.0, other @ tangent), abs=1e-12
    )


@pytest.mark.parametrize(
    ("distance", "blocked", "leaves"), [(0.3, False, False), (0.01, False, True), (0.01, True, False)]
)
def test_just_before_the_goal_it_leaves_unless_blocked(distance, blocked, leaves):
    """The surface still opposes the way all the time."""
    circulation, wanted, normal = Circulation(CONFIG), np.array([0.1, 0.0, 0.0]), np.array([-1.0, 0.0, 0.0])
    while not circulation.circulating:
        circulation.step(wanted, normal, True, 0.3, DT)
    for _ in range(int(LEAVE_S / DT) + 2):
        circulation.step(wanted, normal, blocked, distance, DT)
    assert circulation.circulating == (not leaves)


def test_arrival_resets_it():
    circulation = Circulation(CONFIG)
    while not circulation.exhausted:
        circulation.step(np.array([0.1, 0.0, 0.0]), np.array([-1.0, 0.0, 0.0]), True, 0.5, DT)
    assert not circulation.step(np.zeros(3), np.zeros(3), False, 0.0, DT).any()
    assert not circulation.exhausted


def test_a_block_without_a_normal_is_not_gone_round():
    circulation = Circulation(CONFIG)
    for _ in range(500):
        assert not circulation.step(np.array([0.1, 0.0, 0.0]), np.zeros(3), True, 0.5, DT).any()


@pytest.mark.parametrize(
    ("change", "cause"),
    [
        ({"wanted_linear": np.array([math.nan, 0.0, 0.0])}, "not_finite"),
        ({"normal": np.array([math.inf, 0.0, 0.0])}, "not_finite"),
        ({"distance_to_goal": math.nan}, "not_finite"),
        ({"distance_to_goal": -0.1}, "out_of_range"),
        ({"dt": 0.0}, "out_of_range"),
        ({"dt": math.nan}, "out_of_range"),
        ({"normal": np.zeros(2)}, "wrong_length"),
    ],
)
def test_refuses_what_has_no_meaning(change, cause):
    good = {
        "wanted_linear": np.array([0.1, 0.0, 0.0]),
        "normal": np.array([-1.0, 0.0, 0.0]),
        "blocked": False,
        "distance_to_goal": 0.5,
        "dt": DT,
    }
    with pytest.raises(InputError) as caught:
        Circulation(CONFIG).step(**{**good, **change})
    assert caught.value.cause == cause
