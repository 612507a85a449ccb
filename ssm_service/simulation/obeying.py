"""The robot's own watchdog: a command moves the plant while it is valid, and not a moment longer."""

from __future__ import annotations

from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from ..client import Followed
from .world import World


class Commands(Protocol):
    """Where the plant asks what holds now: ``client.Follower``, or a test's own."""

    def poll(self, now_ns: int | None = None) -> Followed:
        """Return what holds now."""


class Obeying:
    """Steps a world under the commands of a service.

    Between two steps the command of the first holds, until it expires; for the rest, and in every
    stop, the plant is commanded to stand still. So even while this process is held up, the simulated
    robot stops when a real one's controller would.

    Args:
        world: The world.
        commands: The service's commands.
    """

    def __init__(self, world: World, commands: Commands) -> None:
        self._world = world
        self._commands = commands
        self._zeros = np.zeros(len(world.robot.joint_names))
        self._held = self._zeros
        self._expires_ns = 0
        self._polled_ns = 0
        self._name: tuple[str, ...] = ()
        self._order: list[int] | None = None
        self.obeyed = 0
        self.watchdog_stops = 0
        self.followed: Followed | None = None

    @property
    def command(self) -> NDArray[np.float64]:
        """The commanded velocity in force, (n,) [rad/s or m/s]."""
        return self._held

    @property
    def misfit(self) -> bool:
        """Whether the service speaks of other joints than this robot has; the plant then stands still."""
        return bool(self._name) and self._order is None

    def step(self, dt: float, now_ns: int) -> None:
        """Move the world on by ``dt`` [s] under the command held, then ask for the next one.

        Args:
            dt: Time since the last step [s].
            now_ns: Now, by ``time.monotonic_ns``.
        """
        valid = min(max((self._expires_ns - self._polled_ns) * 1e-9, 0.0), dt) if self._held.any() else 0.0
        if valid > 0.0:
            self._world.step(self._held, valid)
        if dt - valid > 1e-9:
            self._world.step(self._zeros, dt - valid)
        self._hold(self._commands.poll(now_ns))
        self._polled_ns = now_ns

    def _hold(self, followed: Followed) -> None:
        before, self.followed = self.followed, followed
        if followed.stopped_by_consumer:
            self._held = self._zeros
            self.watchdog_stops += before is not None and not before.stopped_by_consumer
            return
        self.obeyed += 1
        self._expires_ns = followed.expires_ns
        order = self._order_of(followed.name)
        if order is None:
            self._held = self._zeros
        else:
            self._held = np.array([followed.velocity[index] for index in order])

    def _order_of(self, name: tuple[str, ...]) -> list[int] | None:
        """Return where each of the plant's joints stands in ``name``; ``None`` for another robot's names."""
        if name != self._name:
            joints = self._world.robot.joint_names
            self._name = name
            self._order = [name.index(joint) for joint in joints] if set(name) == set(joints) else None
        return self._order
