"""An outside peer for ``bench.avoidance``: pink's inverse kinematics by quadratic programming, with barriers.

``pin-pink``, the optional extra ``peers``. It gets the same links (their hull pieces), the same obstacles,
the same way to the goal and the same limits as ours: a ``FrameTask`` a tick ahead on the straight line, a
``SelfCollisionBarrier`` over the nearest pairs of hull piece and obstacle with the least distance of our
filter, velocity limits of the zone and position limits. Costs are those of its own examples. Its limit of
acceleration is left to the limits that follow every method: within the programme it also limits slowing
down, and with an obstacle that comes there often is no solution then. Its barrier knows no obstacle
velocities and no retreat that cannot be met: where the programme has no solution, the arm stands. A greater
gain of the barrier than our filter's did not help it: tried by hand in seven scenes with 10, 20 and 50 1/s,
it touched the same six obstacles that came.
"""

from __future__ import annotations

import importlib
import warnings
from typing import TYPE_CHECKING, Any

import coal
import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from ssm_service.model import Obstacle, Robot
from ssm_service.model.hulls import build_parts
from ssm_service.motion import linear_approach

if TYPE_CHECKING:
    from .avoidance_state import State

Array = NDArray[np.float64]

POSITION_COST = 50.0
POSTURE_COST = 1e-3
SAFE_DISPLACEMENT_GAIN = 1.0
SOLVER = "daqp"
MOST_PAIRS = 16
"""Its barrier takes the nearest so many of all pairs, as it offers."""


class Pink:
    """Pink with barriers.

    Args:
        robot: The arm.

    Attributes:
        failed: Ticks without a solution.
    """

    def __init__(self, robot: Robot) -> None:
        self._pink: Any = importlib.import_module("pink")
        self._barriers: Any = importlib.import_module("pink.barriers")
        self._limits: Any = importlib.import_module("pink.limits")
        self._robot = robot
        self._config = robot.config.file.motion
        self._model: Any = robot.model.copy()
        self._data: Any = self._model.createData()
        margin = robot.config.file.limits.position_margin_rad
        self._model.lowerPositionLimit = self._model.lowerPositionLimit + margin
        self._model.upperPositionLimit = self._model.upperPositionLimit - margin
        tasks: Any = importlib.import_module("pink.tasks")
        frame = robot.config.file.end_effector_frame
        self._task = tasks.FrameTask(frame, position_cost=POSITION_COST, orientation_cost=0.0)
        self._posture = tasks.PostureTask(cost=POSTURE_COST)
        self._position = self._limits.ConfigurationLimit(self._model)
        self._scene: tuple[tuple[str, tuple[float, ...]], ...] | None = None
        self._geometry: Any = None
        self._geometry_data: Any = None
        self._first = 0
        self._postured = False
        self.failed = 0

    def velocity(self, state: State) -> Array:
        """Return pink's joint velocity, (n,) [rad/s]; 0 where it finds none."""
        q = state.joints.position
        self._place(state.obstacles)
        configuration = self._pink.Configuration(
            self._model,
            self._data,
            q,
            copy_data=False,
            collision_model=self._geometry,
            collision_data=self._geometry_data,
        )
        if not self._postured:
            self._posture.set_target(q)
            self._postured = True
        ahead = linear_approach(state.end_effector, state.goal, self._config) * state.dt
        target = configuration.get_transform_frame_to_world(self._task.frame).copy()
        target.translation = target.translation + ahead
        self._task.set_target(target)
        self._model.velocityLimit = state.speed_limit
        pairs = min(MOST_PAIRS, len(self._geometry.collisionPairs))
        # A new barrier each tick: it keeps its values for as long as the joints stand, whatever else moves.
        barrier = self._barriers.SelfCollisionBarrier(
            n_collision_pairs=pairs,
            gain=self._config.filter.approach_gain,
            safe_displacement_gain=SAFE_DISPLACEMENT_GAIN,
            d_min=self._config.filter.margin_m,
        )
        found = self._solved(configuration, [barrier] if pairs else [], state.dt)
        return found if found is not None and np.isfinite(found).all() else np.zeros(self._model.nv)

    def _solved(self, configuration: Any, barriers: list[Any], dt: float) -> Array | None:
        """Return what pink finds; None where it finds nothing."""
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")
                found: Array = self._pink.solve_ik(
                    configuration,
                    [self._task, self._posture],
                    dt,
                    solver=SOLVER,
                    damping=1e-6,
                    limits=[self._position, self._limits.VelocityLimit(self._model)],
                    barriers=barriers,
                    safety_break=False,
                )
        except self._pink.exceptions.NoSolutionFound:
            self.failed += 1
            return None
        return found

    def _place(self, obstacles: tuple[Obstacle, ...]) -> None:
        """Bring the obstacles to their places; build the geometry anew where others are there."""
        scene = tuple([(one.shape, one.size) for one in obstacles])
        if scene != self._scene:
            self._scene = scene
            self._build(obstacles)
        for index, one in enumerate(obstacles):
            placement = pin.SE3(one.rotation(), np.array(one.position))
            self._geometry.geometryObjects[self._first + index].placement = placement

    def _build(self, obstacles: tuple[Obstacle, ...]) -> None:
        geometry = pin.GeometryModel()
        for part in build_parts(self._robot):
            for index, piece in enumerate(part.pieces):
                source = part.source
                name = f"{source.name}.{index}"
                geometry.addGeometryObject(
                    pin.GeometryObject(name, source.parentJoint, source.placement, piece)
                )
        self._first = geometry.ngeoms
        for one in obstacles:
            number = geometry.addGeometryObject(
                pin.GeometryObject(one.id, 0, pin.SE3.Identity(), _solid(one))
            )
            for piece in range(self._first):
                geometry.addCollisionPair(pin.CollisionPair(piece, number))
        self._geometry, self._geometry_data = geometry, pin.GeometryData(geometry)


def _solid(obstacle: Obstacle) -> Any:
    size = obstacle.size
    return {
        "sphere": lambda: coal.Sphere(size[0]),
        "box": lambda: coal.Box(*size),
        "capsule": lambda: coal.Capsule(*size),
        "cylinder": lambda: coal.Cylinder(*size),
    }[obstacle.shape]()
