"""The filter on the UR3's own geometry: whole arm, Coal's distances, no zones."""

import numpy as np
import pytest

from ssm_service.config import FilterConfig
from ssm_service.model import DistanceModel, Obstacle, Robot, closing_gradients, moved_by
from ssm_service.motion import VelocityFilter, approach_speeds, barrier_bounds, contact_bounds, velocity_box

CONFIG = FilterConfig()
DT = 0.008
START = np.array([0.3, -1.2, 1.0, 0.0, 0.0, 0.0])


@pytest.fixture(scope="module")
def robot():
    return Robot.load("ur3")


class Arm:
    """The arm obeys at once; the ball flies straight."""

    def __init__(self, robot, ball, velocity=(0.0, 0.0, 0.0), radius=0.05):
        self.robot, self.free = robot, robot.free
        self.model = DistanceModel(robot)
        self.moved = np.array([moved_by(robot, link) for link in robot.monitored_links])
        self.ball, self.velocity, self.radius = np.array(ball), np.array(velocity), radius
        self.position, self.command = START.copy(), np.zeros(len(robot.free))
        self.filter = VelocityFilter()
        self.distances, self.results, self.commands = [], [], []

    def tick(self, wanted):
        robot, free = self.robot, self.free
        ball = Obstacle(id="ball", shape="sphere", size=(self.radius,), position=tuple(self.ball.tolist()))
        self.model.set_obstacles([ball])
        pairs = self.model.pairs(self.position)
        kinematics = robot.kinematics(self.position)
        gradients = closing_gradients(
            kinematics.spatial_jacobian, self.moved[pairs.link], pairs.point_on_link, pairs.normal
        )[:, free]
        approach = approach_speeds(pairs.normal, np.tile(self.velocity, (len(pairs), 1)))
        box = velocity_box(
            self.position[free],
            self.command,
            robot.position_lower[free],
            robot.position_upper[free],
            np.full(len(free), 1.5),
            0.02,
            4.0,
            DT,
        )
        bounds, ceilings = (
            function(pairs.distance, approach, CONFIG) for function in (barrier_bounds, contact_bounds)
        )
        found = self.filter.solve(wanted, gradients, bounds, box, None, ceilings)
        self.distances.append(float(pairs.distance.min()))
        self.results.append(found)
        self.commands.append(found.velocity)
        self.command = found.velocity
        self.position[free] += DT * found.velocity
        self.ball += DT * self.velocity
        return found

    def run(self, seconds, wanted=(0.0, 0.0, 0.0)):
        for _ in range(int(seconds / DT)):
            self.tick(np.array(wanted))
        return self


def beside(robot, gap, side):
    """Return the centre of a ball at a gap beside the middle of the forearm, and the direction to it."""
    kinematics = robot.kinematics(START)
    ring = kinematics.transform_sensors_to_base[:, :3, :]
    direction = ring[side, :, 0]
    return ring[:, :, 3].mean(axis=0) + (0.0323 + 0.05 + gap) * direction, direction


@pytest.mark.parametrize("side", range(0, 8, 2))
def test_at_rest_it_retreats_from_what_approaches(robot, side):
    """It may be caught only where it has nowhere to go: the ball along a direction that the joints move."""
    centre, direction = beside(robot, 0.3, side)
    arm = Arm(robot, centre, -0.1 * direction).run(4.0)
    assert any(result.retreating for result in arm.results)
    assert np.abs(np.array(arm.commands)).max() > 0.05
    assert min(arm.distances) >= CONFIG.margin_m - 0.005
    assert not np.any(arm.commands[0])  # still far away


@pytest.mark.parametrize("side", range(8))
def test_in_penetration_it_comes_out(robot, side):
    centre, _ = beside(robot, -0.02, side)
    arm = Arm(robot, centre)
    first = arm.tick(np.zeros(3))
    assert arm.distances[0] < 0.0
    assert first.retreating
    arm.run(2.0)
    assert arm.distances[-1] >= CONFIG.margin_m - 0.003
    out = np.array(arm.distances)
    assert (np.diff(out[out < 0.0]) > -1e-5).all()  # and never deeper


@pytest.mark.parametrize("wanted", [(0.8, 0.0, 0.0), (-0.8, 0.3, 0.0), (0.0, 0.8, 0.0), (0.0, -0.5, 0.8)])
@pytest.mark.parametrize("side", [0, 3, 6])
def test_no_wanted_motion_drives_any_link_below_the_margin(robot, wanted, side):
    centre, _ = beside(robot, 0.08, side)
    arm = Arm(robot, centre).run(2.5, wanted)
    assert min(arm.distances) >= CONFIG.margin_m - 0.003
    free = robot.free
    assert (arm.position[free] >= robot.position_lower[free] + 0.02 - 1e-9).all()
    assert (arm.position[free] <= robot.position_upper[free] - 0.02 + 1e-9).all()


def test_nothing_speeds_up_faster_than_the_limit(robot):
    centre, direction = beside(robot, 0.3, 2)
    arm = Arm(robot, centre, -0.3 * direction).run(2.0, (0.2, -0.3, 0.4))
    speeds = np.abs(np.array(arm.commands))
    assert (np.diff(speeds, axis=0) <= 4.0 * DT + 1e-9).all()
