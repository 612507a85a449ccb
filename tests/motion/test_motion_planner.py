"""The planner's paths are free, repeatable and lead to the goal; the guide never goes back on them."""

from __future__ import annotations

import importlib
import sys
from pathlib import Path as FilePath

import numpy as np
import pytest

from ssm_service.errors import InputError, SsmError
from ssm_service.model import DistanceModel, Obstacle, Robot
from ssm_service.motion.free_space import FreeSpace
from ssm_service.motion.guide import LOOKAHEAD_RAD, PathGuide
from ssm_service.motion.path import Path
from ssm_service.motion.planner import plan
from ssm_service.motion.self_collision import SelfCollision
from ssm_service.motion.shortening import shortened

ROBOT_FILE = FilePath(__file__).resolve().parents[2] / "bench" / "avoidance_robot.toml"
START = np.array([-0.8, -1.2, 1.2, -1.6, -1.57, 0.0])
END = np.array([0.8, -1.2, 1.2, -1.6, -1.57, 0.0])
CLEARANCE_M = 0.045


@pytest.fixture(scope="module")
def robot() -> Robot:
    return Robot.load(ROBOT_FILE)


def hand(robot: Robot, position: np.ndarray) -> np.ndarray:
    return robot.kinematics(position).transform_end_effector_to_base[:3, 3]


@pytest.fixture(scope="module")
def wall(robot: Robot) -> tuple[Obstacle, ...]:
    x, y, _ = hand(robot, 0.5 * (START + END))
    return (Obstacle(id="wall", shape="box", size=(0.3, 0.05, 0.5), position=(x + 0.05, y, 0.25)),)


def dense(path: Path, step: float = 0.005) -> list[np.ndarray]:
    return [path.at(arc) for arc in np.arange(0.0, path.length, step)] + [path.waypoints[-1]]


@pytest.fixture(scope="module")
def found(robot: Robot, wall: tuple[Obstacle, ...]) -> Path:
    path = plan(robot, START, hand(robot, END), wall, clearance_m=CLEARANCE_M, seconds=60.0, seed=1)
    assert path is not None
    return path


def test_path_round_a_wall_begins_at_the_start_and_ends_at_the_goal(robot: Robot, found: Path) -> None:
    np.testing.assert_array_equal(found.waypoints[0], START)
    np.testing.assert_allclose(hand(robot, found.waypoints[-1]), hand(robot, END), atol=2e-5)
    assert len(found.waypoints) > 2  # the straight way is blocked


def test_path_keeps_its_clearance_between_the_places_that_were_checked(
    robot: Robot, wall: tuple[Obstacle, ...], found: Path
) -> None:
    distance, itself = DistanceModel(robot), SelfCollision(robot, START)
    distance.set_obstacles(wall)
    least = min(float(distance.bounds(one).min()) for one in dense(found))
    assert least >= CLEARANCE_M - 0.01
    assert not any(itself.touches(one) for one in dense(found))


def test_same_seed_gives_the_same_path(robot: Robot, wall: tuple[Obstacle, ...], found: Path) -> None:
    again = plan(robot, START, hand(robot, END), wall, clearance_m=CLEARANCE_M, seconds=60.0, seed=1)
    other = plan(robot, START, hand(robot, END), wall, clearance_m=CLEARANCE_M, seconds=60.0, seed=2)
    assert again is not None
    assert other is not None
    np.testing.assert_array_equal(again.waypoints, found.waypoints)
    assert other.waypoints.shape != found.waypoints.shape or not np.allclose(other.waypoints, found.waypoints)


def test_nothing_in_the_way_is_a_straight_line(robot: Robot) -> None:
    path = plan(robot, START, END, (), clearance_m=CLEARANCE_M, seconds=20.0, joints=True)
    assert path is not None
    np.testing.assert_array_equal(path.waypoints, [START, END])
    assert path.goal is None


def test_goal_inside_an_obstacle_has_no_path(robot: Robot) -> None:
    goal = hand(robot, END)
    inside = (Obstacle(id="o", shape="sphere", size=(0.1,), position=tuple(goal)),)
    assert plan(robot, START, goal, inside, clearance_m=0.0, seconds=20.0) is None


def test_goal_out_of_reach_has_no_path(robot: Robot) -> None:
    assert plan(robot, START, [2.0, 0.0, 0.0], (), clearance_m=0.0, seconds=20.0) is None


def test_search_ends_with_its_states(robot: Robot, wall: tuple[Obstacle, ...]) -> None:
    path = plan(robot, START, hand(robot, END), wall, clearance_m=CLEARANCE_M, seconds=60.0, states=100)
    assert path is None


def test_start_that_is_too_near_may_leave_but_not_come_nearer(robot: Robot) -> None:
    point = hand(robot, START) + np.array([0.0, 0.0, -0.05])
    near = (Obstacle(id="o", shape="sphere", size=(0.03,), position=tuple(point)),)
    distance = DistanceModel(robot)
    distance.set_obstacles(near)
    at_start = float(distance.bounds(START).min())
    assert at_start < CLEARANCE_M
    path = plan(robot, START, hand(robot, END), near, clearance_m=CLEARANCE_M, seconds=60.0)
    assert path is not None
    bounds = np.array([float(distance.bounds(one).min()) for one in dense(path)])
    assert bounds.min() >= at_start - 0.002
    assert bounds[-1] >= CLEARANCE_M


def test_locked_joints_stay() -> None:
    arm = Robot.load("ur3")
    start = arm.rest_position + np.array([0.3, -1.0, 1.0, 0.0, 0.0, 0.0])
    goal = hand(arm, start + np.array([0.5, 0.2, 0.0, 0.0, 0.0, 0.0]))
    path = plan(arm, start, goal, (), clearance_m=0.0, seconds=20.0)
    assert path is not None
    np.testing.assert_array_equal(path.waypoints[:, 3:], np.tile(start[3:], (len(path.waypoints), 1)))


@pytest.mark.parametrize(
    ("change", "cause"),
    [
        ({"start": [0.0] * 5}, "wrong_length"),
        ({"start": [np.nan] * 6}, "not_finite"),
        ({"start": [7.0] * 6}, "out_of_range"),
        ({"goal": [0.0] * 6}, "wrong_length"),
        ({"seconds": 0.0}, "out_of_range"),
        ({"clearance_m": np.nan}, "out_of_range"),
    ],
)
def test_wrong_questions_are_refused(robot: Robot, change: dict, cause: str) -> None:
    asked = {"start": START, "goal": [0.3, 0.0, 0.3], "clearance_m": 0.01, "seconds": 1.0} | change
    with pytest.raises(InputError) as refused:
        plan(
            robot,
            asked["start"],
            asked["goal"],
            (),
            clearance_m=asked["clearance_m"],
            seconds=asked["seconds"],
        )
    assert refused.value.cause == cause


def test_without_ompl_it_says_which_extra(robot: Robot, monkeypatch: pytest.MonkeyPatch) -> None:
    for name in [name for name in sys.modules if name == "ompl" or name.startswith("ompl.")]:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.setitem(sys.modules, "ompl", None)
    importlib.invalidate_caches()
    with pytest.raises(SsmError, match=r"ssm-service\[planner\]"):
        plan(robot, START, [0.3, 0.0, 0.3], (), clearance_m=0.0, seconds=1.0)


def test_folded_arm_touches_itself_and_the_start_is_believed(robot: Robot) -> None:
    folded = np.array([0.0, -1.57, 2.9, 0.0, 0.0, 0.0])
    assert SelfCollision(robot, START).touches(folded)
    assert not SelfCollision(robot, START).touches(START)
    assert not SelfCollision(robot, folded).touches(folded)


def rows_within(
    itself: SelfCollision, robot: Robot, position: np.ndarray, within: float
) -> tuple[np.ndarray, np.ndarray]:
    """Distances and gradients of the pairs that are nearer, whatever the joints' speeds."""
    return itself.rows(position, robot.kinematics(position).spatial_jacobian, np.zeros(6), within, 1.0)


def test_gradients_between_own_links_are_those_of_their_distances(robot: Robot) -> None:
    rng, step, seen = np.random.default_rng(4), 1e-3, 0
    itself = SelfCollision(robot, START)
    for _ in range(12):
        position = rng.uniform(-2.5, 2.5, 6)
        distance, gradients = rows_within(itself, robot, position, 9.0)
        velocity = rng.normal(size=6)
        ahead, behind = (
            rows_within(itself, robot, one, 9.0)[0]
            for one in (position + step * velocity, position - step * velocity)
        )
        clear = distance > 0.01
        seen += int(clear.sum())
        slope = (ahead - behind) / (2.0 * step)
        np.testing.assert_allclose(slope[clear], -(gradients @ velocity)[clear], atol=2e-3)
        touching = itself.touches(position)
        assert touching == bool((distance <= 0.0).any())
    assert seen > 200


def test_only_near_links_are_returned(robot: Robot) -> None:
    itself = SelfCollision(robot, START)
    every, _ = rows_within(itself, robot, START, 9.0)
    some, gradients = rows_within(itself, robot, START, float(np.median(every)))
    assert 0 < len(some) < len(every)
    assert gradients.shape == (len(some), 6)
    none, gradients = rows_within(itself, robot, START, 0.0)
    assert none.shape == (0,)
    assert gradients.shape == (0, 6)


def test_edge_through_an_obstacle_is_not_free(robot: Robot, wall: tuple[Obstacle, ...]) -> None:
    space = FreeSpace(robot, START, wall, CLEARANCE_M)
    assert space.free(START)
    assert space.free(END)
    assert not space.edge_free(START, END)
    beyond = START.copy()
    beyond[2] = 3.5
    assert not space.free(beyond)


def test_arm_that_touches_itself_is_not_free(robot: Robot) -> None:
    space = FreeSpace(robot, START, (), CLEARANCE_M)
    folded = np.array([0.0, -1.57, 2.9, 0.0, -1.57, 0.0])
    assert SelfCollision(robot, START).touches(folded)
    assert space.free(END)
    assert not space.free(folded)
    assert not space.edge_free(START, folded)


def test_shortening_keeps_the_ends_and_never_lengthens() -> None:
    rng = np.random.default_rng(3)
    points = np.cumsum(rng.normal(size=(12, 4)), axis=0)
    result = shortened(points, lambda a, b: True, rng, attempts=100, over=lambda: False)
    assert result is not None
    np.testing.assert_array_equal(result[[0, -1]], points[[0, -1]])
    straight = float(np.linalg.norm(points[-1] - points[0]))
    assert straight - 1e-9 <= Path(waypoints=result).length < 0.5 * Path(waypoints=points).length


def test_shortening_gives_up_a_path_with_an_edge_that_is_not_free() -> None:
    points = np.array([[0.0, 0.0], [1.0, 1.0], [2.0, 0.0]])
    rng = np.random.default_rng(0)
    assert shortened(points, lambda a, b: False, rng, attempts=5, over=lambda: False) is None


def zigzag() -> Path:
    return Path(waypoints=[[0.0, 0.0], [1.0, 0.0], [1.0, 0.0], [1.0, 2.0], [0.0, 2.0]])


def test_path_is_measured_by_its_length() -> None:
    path = zigzag()
    assert path.length == 4.0
    assert len(path.waypoints) == 4
    np.testing.assert_allclose(path.at(2.0), [1.0, 1.0])
    np.testing.assert_array_equal(path.at(-1.0), [0.0, 0.0])
    np.testing.assert_array_equal(path.at(9.0), [0.0, 2.0])


def test_nearest_agrees_with_a_search_of_all_places() -> None:
    path, rng = zigzag(), np.random.default_rng(5)
    arcs = np.linspace(0.5, 3.5, 30001)
    places = np.array([path.at(arc) for arc in arcs])
    for point in rng.uniform(-1.0, 3.0, (30, 2)):
        arc, distance = path.nearest(point, 0.5, 3.5)
        all_distances = np.linalg.norm(places - point, axis=1)
        assert distance == pytest.approx(float(all_distances.min()), abs=1e-4)
        assert np.linalg.norm(path.at(arc) - point) == pytest.approx(distance)


def test_guide_arrives_without_going_back_or_leaving() -> None:
    guide, position, arcs = PathGuide(zigzag()), np.zeros(2), []
    for _ in range(3000):
        velocity = guide.wanted(position, 0.5)
        assert np.linalg.norm(velocity) <= 0.5 + 1e-12
        position = position + 0.008 * velocity
        arcs.append(guide.arc)
        assert guide.path.nearest(position, 0.0, 4.0)[1] < LOOKAHEAD_RAD
    assert guide.valid
    assert np.all(np.diff(arcs) >= 0.0)
    np.testing.assert_allclose(position, [0.0, 2.0], atol=1e-3)


def test_guide_never_skips_a_loop() -> None:
    """A path that comes back to its beginning is followed all the way round."""
    guide = PathGuide(Path(waypoints=[[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0], [0.0, 0.0]]))
    position, seen = np.zeros(2), 0.0
    for _ in range(2000):
        position = position + 0.008 * guide.wanted(position, 0.5)
        seen = max(seen, float(position.sum()))
    assert seen > 1.8
    np.testing.assert_allclose(position, [0.0, 0.0], atol=1e-3)


def test_arm_that_is_pushed_back_goes_on_from_where_it_came() -> None:
    guide = PathGuide(zigzag())
    for along in np.linspace(0.0, 0.9, 20):
        guide.wanted(np.array([along, 0.0]), 0.5)
    assert guide.arc == pytest.approx(0.9)
    velocity = guide.wanted(np.array([0.7, 0.0]), 0.5)
    assert guide.arc == pytest.approx(0.9)
    # towards the place ahead of 0.9, round the corner, and not along the edge
    ahead = guide.path.at(0.9 + LOOKAHEAD_RAD) - [0.7, 0.0]
    np.testing.assert_allclose(velocity, 0.5 * ahead / np.linalg.norm(ahead))


def test_guide_gives_up_a_path_that_the_arm_has_left_for_good() -> None:
    guide = PathGuide(zigzag())
    assert np.any(guide.wanted(np.zeros(2), 0.5))
    np.testing.assert_array_equal(guide.wanted(np.array([0.0, -1.0]), 0.5), [0.0, 0.0])
    assert not guide.valid
    np.testing.assert_array_equal(guide.wanted(np.zeros(2), 0.5), [0.0, 0.0])


def test_guide_stands_where_the_position_is_not_a_number() -> None:
    guide = PathGuide(zigzag())
    np.testing.assert_array_equal(guide.wanted(np.array([np.nan, 0.0]), 0.5), [0.0, 0.0])
    assert not guide.valid


def test_guide_knows_its_goal() -> None:
    path = Path(waypoints=[[0.0, 0.0], [1.0, 0.0]], goal=np.array([0.1, 0.2, 0.3]))
    assert PathGuide(path).leads_to(np.array([0.1, 0.2, 0.3]))
    assert not PathGuide(path).leads_to(np.array([0.1, 0.2, 0.4]))
    assert not PathGuide(zigzag()).leads_to(np.array([0.1, 0.2, 0.3]))


@pytest.mark.parametrize(
    ("waypoints", "cause"), [([], "wrong_length"), ([[0.0, np.inf]], "not_finite"), ([0.0], "wrong_length")]
)
def test_path_without_places_is_refused(waypoints: list, cause: str) -> None:
    with pytest.raises(InputError) as refused:
        Path(waypoints=np.array(waypoints))
    assert refused.value.cause == cause
