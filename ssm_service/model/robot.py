"""The robot: joints, limits, frames, Jacobians and sensor poses, computed by Pinocchio."""

from __future__ import annotations

import itertools
import math
from pathlib import Path
from typing import Any, Final

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike, NDArray

from ..config import RobotConfig, load_robot_config
from ..errors import ConfigError, InputError, listed
from .description import check_stopping, joint_names, link_names, read_description, require
from .kinematics import Kinematics
from .rings import Ring, SensorArray

_LARGEST_SPEED: Final = 1e6  # parsers write the greatest double where the URDF gives no limit


class Robot:
    """A robot as its file describes it. The base frame is the URDF's root frame.

    Not for use by several threads at once: Pinocchio's working memory is kept between calls.

    Attributes:
        config: The robot file.
        name: The robot's name.
        joint_names: The n joints of every message, in the URDF's order; ``joints.fixed`` are not among them.
        free: (k,) indices of the joints that commands move.
        velocity_limit: (n,) [rad/s or m/s].
        position_lower, position_upper: (n,) [rad or m], infinite for continuous joints.
        rest_position: (n,) locked joints at their values, the others at 0 or at the limit nearest to it.
        rings: The sensor rings.
        ring_slices: For each ring, its part of the concatenated readings.
        sensor_count: Number of sensors of all rings.
        ring_of_sensor: Each sensor's ring, in the order of the readings.
        link_of_sensor: The link that carries each sensor, in the order of the readings.
        sensor_arrays: The rings by the link that carries them, in the order of each link's first ring.
        monitored_links: The links whose distance is monitored.
        model: Pinocchio's model.
        collision: Pinocchio's collision geometry.
        geometry_of_link: Indices into ``collision.geometryObjects`` by link.
    """

    def __init__(self, config: RobotConfig) -> None:
        """Read what the file names.

        Raises:
            ConfigError: Something named does not exist or cannot be used.
        """
        description = read_description(config)
        self.config = config
        self.name = config.name
        self.model: Any = description.model
        self.collision: Any = description.collision
        self.geometry_of_link = description.geometry_of_link
        self.joint_names = tuple(joint_names(self.model))
        self.position_lower, self.position_upper = self._position_limits()
        self.velocity_limit = self._velocity_limits()
        self.free, self.rest_position = self._locked()
        self.monitored_links = self._monitored_links()
        self.rings = tuple(Ring.from_config(ring) for ring in config.file.rings)
        ends = np.cumsum([0, *(ring.count for ring in self.rings)]).tolist()
        self.ring_slices = tuple(slice(a, b) for a, b in itertools.pairwise(ends))
        self.sensor_count: int = ends[-1]
        self.ring_of_sensor = tuple(ring for ring in self.rings for _ in range(ring.count))
        for array in (
            self.position_lower,
            self.position_upper,
            self.velocity_limit,
            self.free,
            self.rest_position,
        ):
            array.flags.writeable = False
        self._data: Any = self.model.createData()
        self._continuous = [
            (i, joint.idx_q) for i, joint in enumerate(list(self.model.joints)[1:]) if joint.nq == 2
        ]
        self._index_q = np.array([joint.idx_q for joint in list(self.model.joints)[1:]], dtype=np.intp)
        self._end_effector = self._frame_id("end_effector_frame", config.file.end_effector_frame)
        self._ring_frames = [
            self._frame_id(f"rings[{i}].parent_frame", ring.parent_frame) for i, ring in enumerate(self.rings)
        ]
        self._links = {
            name: self.model.getFrameId(name, pin.FrameType.BODY) for name in link_names(self.model)
        }
        self.sensor_arrays = self._sensor_arrays()
        links = {int(i): array.link for array in self.sensor_arrays for i in array.indices}
        self.link_of_sensor = tuple(links[i] for i in range(self.sensor_count))
        self._check_names()

    @classmethod
    def load(cls, name_or_path: str | Path) -> Robot:
        """Load a robot by the name of a file that comes with the package, or by its path.

        Raises:
            ConfigError: The file, or something that it names, is wrong.
        """
        return cls(load_robot_config(name_or_path))

    def pinocchio_configuration(self, position: ArrayLike) -> NDArray[np.float64]:
        """Return Pinocchio's q, (nq,), which holds continuous joints as (cos, sin).

        Args:
            position: (n,) [rad or m].

        Raises:
            InputError: ``wrong_length`` or ``not_finite``.
        """
        joints = self._checked("position", position)
        if not self._continuous:
            return joints.copy()
        q = np.empty(self.model.nq)
        q[self._index_q] = joints
        for index, place in self._continuous:
            q[place], q[place + 1] = math.cos(joints[index]), math.sin(joints[index])
        return q

    def kinematics(self, position: ArrayLike) -> Kinematics:
        """Compute the poses of end effector, rings and sensors, and the Jacobian.

        Args:
            position: (n,) [rad or m].

        Raises:
            InputError: ``wrong_length`` or ``not_finite``.
        """
        model, data = self.model, self._data
        pin.computeJointJacobians(model, data, self.pinocchio_configuration(position))
        T_base_end = pin.updateFramePlacement(model, data, self._end_effector).homogeneous
        full = pin.getFrameJacobian(model, data, self._end_effector, pin.LOCAL_WORLD_ALIGNED)
        T_base_parents = [pin.updateFramePlacement(model, data, i).homogeneous for i in self._ring_frames]
        return Kinematics(
            transform_end_effector_to_base=T_base_end,
            jacobian_full=full,
            jacobian=full[:3, self.free],
            spatial_jacobian=np.array(data.J),
            rings=self.rings,
            transforms_parent_to_base=T_base_parents,
        )

    def link_transforms(self, position: ArrayLike) -> dict[str, NDArray[np.float64]]:
        """Return every link's transform to the base frame, (4, 4) [m], by link name.

        Args:
            position: (n,) [rad or m].

        Raises:
            InputError: ``wrong_length`` or ``not_finite``.
        """
        pin.forwardKinematics(self.model, self._data, self.pinocchio_configuration(position))
        pin.updateFramePlacements(self.model, self._data)
        return {name: self._data.oMf[frame].homogeneous for name, frame in self._links.items()}

    def point_velocity(
        self, position: ArrayLike, velocity: ArrayLike, link: str, point: ArrayLike
    ) -> NDArray[np.float64]:
        """Return the velocity of the material point of ``link`` that is now at ``point``.

        Args:
            position: (n,) [rad or m].
            velocity: (n,) [rad/s or m/s].
            link: Name of a link.
            point: (3,) in the base frame [m].

        Returns:
            (3,) [m/s], expressed in the base frame.

        Raises:
            InputError: ``wrong_length``, ``not_finite`` or ``unknown_link``.
        """
        frame = self._links.get(link)
        if frame is None:
            raise InputError("unknown_link", "link", link, f"a link of the robot: {listed(self._links)}")
        p = _finite_vector("point", point, 3)
        model, data = self.model, self._data
        pin.forwardKinematics(
            model, data, self.pinocchio_configuration(position), self._checked("velocity", velocity)
        )
        origin = pin.updateFramePlacement(model, data, frame).translation
        motion = pin.getFrameVelocity(model, data, frame, pin.LOCAL_WORLD_ALIGNED)
        result: NDArray[np.float64] = motion.linear + np.cross(motion.angular, p - origin)
        return result

    def _checked(self, where: str, values: ArrayLike) -> NDArray[np.float64]:
        return _finite_vector(where, values, len(self.joint_names))

    def _position_limits(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        lower = np.full(len(self.joint_names), -np.inf)
        upper = np.full(len(self.joint_names), np.inf)
        for i, (name, joint) in enumerate(zip(self.joint_names, list(self.model.joints)[1:], strict=True)):
            if joint.nq != 1:
                continue
            lower[i] = self.model.lowerPositionLimit[joint.idx_q]
            upper[i] = self.model.upperPositionLimit[joint.idx_q]
            if not lower[i] <= upper[i]:
                found = f"joint {name} with limits {lower[i]:g} to {upper[i]:g}"
                raise ConfigError(
                    self.config.path, "urdf", found, "lower limits that are not above the upper"
                )
        return lower, upper

    def _velocity_limits(self) -> NDArray[np.float64]:
        extra = self.config.file.limits.velocity_rad_s
        for name, value in extra.items():
            key = f"limits.velocity_rad_s.{name}"
            require(self.config, key, name, self.joint_names, "a joint of the robot")
            if not value > 0.0:
                raise ConfigError(self.config.path, key, value, "a speed above 0")
        limits = np.empty(len(self.joint_names))
        for i, name in enumerate(self.joint_names):
            urdf = float(self.model.velocityLimit[i])
            known = [v for v in (urdf, extra.get(name)) if v is not None and 0.0 < v < _LARGEST_SPEED]
            if not known:
                allowed = "a speed limit above 0: the URDF gives this joint none, so add this key"
                raise ConfigError(self.config.path, f"limits.velocity_rad_s.{name}", "nothing", allowed)
            limits[i] = min(known)
        return limits

    def _locked(self) -> tuple[NDArray[np.intp], NDArray[np.float64]]:
        """Return the indices of the free joints, (k,), and the rest position, (n,)."""
        rest = np.clip(0.0, self.position_lower, self.position_upper)
        locked = self.config.file.joints.locked
        for name, value in locked.items():
            key = f"joints.locked.{name}"
            require(self.config, key, name, self.joint_names, "a joint of the robot")
            i = self.joint_names.index(name)
            if not self.position_lower[i] <= value <= self.position_upper[i]:
                allowed = f"{self.position_lower[i]:g} to {self.position_upper[i]:g}, the URDF's limits"
                raise ConfigError(self.config.path, key, value, allowed)
            rest[i] = value
        free = [i for i, name in enumerate(self.joint_names) if name not in locked]
        if not free:
            raise ConfigError(
                self.config.path, "joints.locked", listed(locked), "at least one joint left free"
            )
        return np.array(free, dtype=np.intp), rest

    def _monitored_links(self) -> tuple[str, ...]:
        with_geometry = list(self.geometry_of_link)
        what = "a link with collision geometry"
        for name in self.config.file.hull_pieces:
            require(self.config, f"hull_pieces.{name}", name, with_geometry, what)
        links = self.config.file.links
        if links is None:
            links = with_geometry
        for i, name in enumerate(links):
            require(self.config, f"links[{i}]", name, with_geometry, what)
        if not links or len(set(links)) != len(links):
            allowed = f"at least one link with collision geometry, each once: {listed(with_geometry)}"
            raise ConfigError(self.config.path, "links", listed(links), allowed)
        return tuple(links)

    def _check_names(self) -> None:
        """Refuse stopping data of joints, and assumptions of links, that do not exist."""
        file = self.config.file
        for name in file.stopping:
            require(self.config, f"stopping.{name}", name, self.joint_names, "a joint of the robot")
        check_stopping(
            self.config, [self.joint_names[i] for i in self.free], self.velocity_limit[self.free].tolist()
        )
        links = None if file.assumptions is None else file.assumptions.links
        carriers = [array.link for array in self.sensor_arrays]
        for i, name in enumerate(links or ()):
            require(self.config, f"assumptions.links[{i}]", name, carriers, "a link that carries a ring")
        if file.assumptions is not None:
            for name in links or carriers:
                if name not in self.geometry_of_link:
                    allowed = "links with collision geometry: without it there is no distance from them"
                    raise ConfigError(self.config.path, "assumptions.links", name, allowed)

    def _sensor_arrays(self) -> tuple[SensorArray, ...]:
        carried: dict[int, list[int]] = {}
        for index, frame in enumerate(self._ring_frames):
            carried.setdefault(self._link_of_frame(frame), []).append(index)
        arrays = []
        for link, members in carried.items():
            T_link_joint = self.model.frames[link].placement.inverse()
            placements = [self.model.frames[self._ring_frames[i]].placement for i in members]
            arrays.append(
                SensorArray.of_rings(
                    self.model.frames[link].name,
                    [self.rings[i] for i in members],
                    [self.ring_slices[i] for i in members],
                    [(T_link_joint * T_joint_parent).homogeneous for T_joint_parent in placements],
                )
            )
        return tuple(arrays)

    def _link_of_frame(self, frame: int) -> int:
        """Return the frame of the link that carries a frame: itself, or the nearest link before it."""
        while self.model.frames[frame].type != pin.FrameType.BODY and frame:
            frame = self._child_link(frame) or self.model.frames[frame].parentFrame
        return frame

    def _child_link(self, frame: int) -> int | None:
        """Return the link that a joint's frame begins; the two coincide."""
        if self.model.frames[frame].type != pin.FrameType.JOINT:
            return None
        for index, other in enumerate(self.model.frames):
            if other.type == pin.FrameType.BODY and other.parentFrame == frame:
                return index
        return None

    def _frame_id(self, key: str, name: str) -> int:
        frames = [frame.name for frame in self.model.frames]
        require(self.config, key, name, frames, "a frame of the URDF")
        for index, frame in enumerate(self.model.frames):
            if frame.name == name and frame.type == pin.FrameType.BODY:
                return index  # a link and a joint may share a name
        return frames.index(name)


def _finite_vector(where: str, values: ArrayLike, length: int) -> NDArray[np.float64]:
    try:
        vector = np.asarray(values, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise InputError("wrong_type", where, values, f"{length} numbers") from error
    if vector.shape != (length,):
        raise InputError("wrong_length", where, f"shape {vector.shape}", f"{length} numbers")
    if not np.isfinite(vector).all():
        raise InputError("not_finite", where, vector, "finite numbers")
    return vector
