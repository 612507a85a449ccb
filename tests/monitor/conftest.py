import numpy as np
import pytest

from ssm_service.model import Obstacle, Robot
from ssm_service.monitor import Inputs, JointSample, Monitor, Received, Target

POSE = (0.4, -1.1, 1.0, 0.0, 0.0, 0.0)


@pytest.fixture(scope="session")
def robot() -> Robot:
    return Robot.load("ur3")


@pytest.fixture
def monitor(robot: Robot) -> Monitor:
    return Monitor(robot)


class Scene:
    """Builds the inputs of a tick, everything fresh unless said otherwise."""

    def __init__(self) -> None:
        self.position = np.array(POSE)
        self.ranges: np.ndarray | None = np.full(8, np.inf)
        self.obstacles: tuple[Obstacle, ...] | None = None
        self.target: Target | None = None
        self.age = {"joints": 0.001, "ranges": 0.01, "obstacles": 0.01, "target": 0.01}
        self.invalid: set[str] = set()
        self.overrun_s = 0.0
        self.duplicate = False

    def inputs(self) -> Inputs:
        values = {
            "joints": None
            if self.position is None
            else JointSample(position=self.position, velocity=np.zeros(6)),
            "ranges": self.ranges,
            "obstacles": self.obstacles,
            "target": self.target,
        }
        received = {
            name: Received(
                value=value,
                age_s=None if value is None else self.age[name],
                invalid=name in self.invalid,
            )
            for name, value in values.items()
        }
        return Inputs(**received, overrun_s=self.overrun_s, duplicate=self.duplicate)


@pytest.fixture
def scene() -> Scene:
    return Scene()


@pytest.fixture
def sphere():
    def make(x: float, y: float = 0.0, z: float = 0.2, radius: float = 0.05, id: str = "ball") -> Obstacle:
        return Obstacle(id=id, shape="sphere", size=(radius,), position=(x, y, z))

    return make
