"""Key expressions on the network: everything of one robot lies under ``ssm/{robot}``."""

from __future__ import annotations

import re
from dataclasses import dataclass

from ..errors import ConfigError

_NAME = re.compile(r"[A-Za-z0-9_][A-Za-z0-9_.-]{0,63}")


@dataclass(frozen=True, slots=True)
class Keys:
    """The keys of one robot.

    Attributes:
        robot: Name of the robot on the network: letters, digits, ``_``, ``-`` and ``.``.
    """

    robot: str

    def __post_init__(self) -> None:
        if not _NAME.fullmatch(self.robot):
            raise ConfigError("--name", "", self.robot, "1 to 64 letters, digits, '_', '-' or '.'")

    def input(self, source: str) -> str:
        """Return the key of an input, e.g. ``ssm/ur3/in/joints``."""
        return f"ssm/{self.robot}/in/{source}"

    def output(self, name: str) -> str:
        """Return the key of an output or query, e.g. ``ssm/ur3/zone``."""
        return f"ssm/{self.robot}/{name}"

    @property
    def alive(self) -> str:
        """Key of the liveliness token."""
        return f"ssm/{self.robot}/alive"


def robot_of(key: str) -> str:
    """Return the robot's name in a key ``ssm/{robot}/…``."""
    return key.split("/")[1]
