"""The URDF and its meshes, read strictly: whatever is missing or unusable is refused, never left out."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import coal
import pinocchio as pin

from ..config import RobotConfig
from ..config.describe import Phrase
from ..errors import ConfigError, listed, suggestion

PACKAGE: Final = "example-robot-data"


@dataclass(frozen=True, slots=True, kw_only=True)
class Description:
    """What the URDF says, with ``joints.fixed`` taken out.

    Attributes:
        model: Pinocchio's model; its joints are those of the messages, in their order.
        collision: The links' collision geometry.
        geometry_of_link: Indices into ``collision.geometryObjects`` by link, in the URDF's order.
    """

    model: Any
    collision: Any
    geometry_of_link: dict[str, tuple[int, ...]]


def read_description(config: RobotConfig) -> Description:
    """Read the URDF that a robot file names.

    Raises:
        ConfigError: The URDF or a mesh is missing or unreadable, a joint of ``joints.fixed`` does not
            exist or cannot stand at its position, or a joint's type is not supported.
    """
    urdf, package_dirs = _paths(config)
    if not urdf.is_file():
        raise ConfigError(config.path, "urdf", config.file.urdf, f"an existing file; there is no {urdf}")
    try:
        model = pin.buildModelFromUrdf(str(urdf))
    except (ValueError, RuntimeError) as error:
        raise ConfigError(config.path, "urdf", str(error), "a valid URDF") from error
    for index in range(1, model.njoints):
        if model.joints[index].nv != 1:
            found = f"joint {model.names[index]} of type {model.joints[index].shortname()}"
            raise ConfigError(config.path, "urdf", found, "revolute, continuous and prismatic joints")
    try:
        directories = [str(directory) for directory in package_dirs]
        collision = pin.buildGeomFromUrdf(
            model, str(urdf), pin.GeometryType.COLLISION, package_dirs=directories
        )
    except (ValueError, RuntimeError) as error:
        allowed = f"readable collision meshes; package:// is looked up in {listed(package_dirs)}"
        raise ConfigError(config.path, "package_dirs", " ".join(str(error).split()), allowed) from error
    model, collision = _without_fixed(config, model, collision)
    if model.njoints < 2:
        raise ConfigError(
            config.path, "urdf", "no joint that moves", "at least one joint not in joints.fixed"
        )
    _check_geometry(config, collision)
    return Description(model=model, collision=collision, geometry_of_link=_geometry_of_link(model, collision))


def joint_names(model: Any) -> list[str]:
    """Return the joints' names in Pinocchio's order, without the universe."""
    return list(model.names)[1:]


def link_names(model: Any) -> list[str]:
    """Return the links' names in Pinocchio's order."""
    return [frame.name for frame in model.frames if frame.type == pin.FrameType.BODY]


def require(config: RobotConfig, key: str, name: str, valid: Iterable[str], what: str) -> None:
    """Refuse a ``name`` that is not among ``valid``.

    Raises:
        ConfigError: It is not; the message lists the valid ones and the one that may have been meant.
    """
    names = list(valid)
    if name not in names:
        raise ConfigError(config.path, key, name, f"{suggestion(name, names)}{what}: {listed(names)}")


def check_stopping(config: RobotConfig, free: Sequence[str], limits: Sequence[float]) -> None:
    """Refuse a ``separation`` without stopping data of every free joint, up to its greatest speed.

    Args:
        config: The robot file.
        free: The joints that commands move.
        limits: Their greatest speeds [rad/s or m/s].

    Raises:
        ConfigError: There are none of a joint, or they end below its limit.
    """
    users = [name for name, profile in config.file.profiles.items() if profile.separation is not None]
    if not users:
        return
    for joint, limit in zip(free, limits, strict=True):
        key, data = f"stopping.{joint}", config.file.stopping.get(joint)
        if data is None:
            allowed = f"stopping data of every joint that moves: profiles.{users[0]}.separation needs them"
            raise ConfigError(config.path, key, Phrase("nothing"), allowed)
        if data.speed_rad_s < limit:
            allowed = f"at least {limit:g} rad/s or m/s, the joint's limit (or a lower limits.velocity_rad_s)"
            raise ConfigError(config.path, f"{key}.speed_rad_s", data.speed_rad_s, allowed)


def _paths(config: RobotConfig) -> tuple[Path, list[Path]]:
    """Return the URDF's path and the folders of ``package://``."""
    here = Path(config.path).parent
    package_dirs = [here / directory for directory in config.file.package_dirs]
    for index, directory in enumerate(package_dirs):
        if not directory.is_dir():
            key = f"package_dirs[{index}]"
            raise ConfigError(config.path, key, config.file.package_dirs[index], "an existing folder")
    prefix, _, inside = config.file.urdf.partition(":")
    share = _share()
    if prefix == PACKAGE:
        if share is None:
            allowed = f"a URDF's path, or an installed {PACKAGE} (pip install {PACKAGE})"
            raise ConfigError(config.path, "urdf", config.file.urdf, allowed)
        return share / PACKAGE / inside, [*package_dirs, share]
    urdf = here / config.file.urdf
    return urdf, [*package_dirs, urdf.parent, *([share] if share else [])]


def _share() -> Path | None:
    """Return the ``share`` folder of the prefix that holds example-robot-data, beside Pinocchio's."""
    for prefix in Path(pin.__file__).resolve().parents:
        if (prefix / "share" / PACKAGE).is_dir():
            return prefix / "share"
    return None


def _without_fixed(config: RobotConfig, model: Any, collision: Any) -> tuple[Any, Any]:
    """Weld the joints of ``joints.fixed`` at their positions."""
    fixed = config.file.joints.fixed
    if not fixed:
        return model, collision
    q = pin.neutral(model)
    for name, value in fixed.items():
        key = f"joints.fixed.{name}"
        require(config, key, name, joint_names(model), "a joint of the URDF")
        joint = model.joints[model.getJointId(name)]
        if joint.nq == 2:  # continuous, held as (cos, sin)
            q[joint.idx_q], q[joint.idx_q + 1] = math.cos(value), math.sin(value)
            continue
        lower, upper = model.lowerPositionLimit[joint.idx_q], model.upperPositionLimit[joint.idx_q]
        if not lower <= value <= upper:
            raise ConfigError(config.path, key, value, f"{lower:g} to {upper:g}, the URDF's limits")
        q[joint.idx_q] = value
    reduced, geometries = pin.buildReducedModel(
        model, [collision], [model.getJointId(name) for name in fixed], q
    )
    return reduced, geometries[0]


def _check_geometry(config: RobotConfig, collision: Any) -> None:
    """Refuse a mesh without triangles: against it, everything would be infinitely far."""
    for geometry in collision.geometryObjects:
        shape = geometry.geometry
        if isinstance(shape, coal.BVHModelBase):
            if shape.num_tris < 1:
                raise ConfigError(
                    config.path, "urdf", f"empty mesh {geometry.meshPath}", "meshes with triangles"
                )
        elif not isinstance(shape, coal.Box | coal.Sphere | coal.Cylinder | coal.Capsule | coal.Convex):
            found = f"{type(shape).__name__} of {geometry.name}"
            raise ConfigError(config.path, "urdf", found, "meshes, boxes, spheres, cylinders and capsules")


def _geometry_of_link(model: Any, collision: Any) -> dict[str, tuple[int, ...]]:
    links: dict[str, tuple[int, ...]] = {}
    for index, geometry in enumerate(collision.geometryObjects):
        link = model.frames[geometry.parentFrame].name
        links[link] = (*links.get(link, ()), index)
    return links
