"""How fast pairs of link and obstacle come closer at a joint velocity."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Closing:
    """The closing speed of p pairs as a function of the joint velocity.

    A directed pair closes at ``g·q̇``. Where nobody knows in which direction an obstacle is, the pair closes
    as fast as the fastest of the points that are given of the link moves, in whatever direction.

    Attributes:
        gradients: (p, n) [m/rad]; rows of undirected pairs do not count.
        undirected: (p,) which pairs have no direction.
        jacobians: (u, c, 3, n) [m/rad] of the c points of each undirected pair, in their order.
    """

    gradients: NDArray[np.float64]
    undirected: NDArray[np.bool_]
    jacobians: NDArray[np.float64]

    @classmethod
    def directed(cls, gradients: NDArray[np.float64]) -> Closing:
        """Return pairs that all have a direction, (p, n) [m/rad]."""
        count, joints = gradients.shape
        return cls(
            gradients=gradients,
            undirected=np.zeros(count, dtype=np.bool_),
            jacobians=np.empty((0, 1, 3, joints)),
        )

    def at(self, velocity: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the closing speeds, (p,) [m/s], at a joint velocity, (n,) [rad/s]."""
        speeds: NDArray[np.float64] = self.gradients @ velocity
        if len(self.jacobians):
            points = self.jacobians @ velocity
            speeds[self.undirected] = np.sqrt((points * points).sum(axis=-1)).max(axis=-1)
        return speeds

    def greatest(self, limits: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the greatest closing speeds, (p,) [m/s], of joints within ±``limits``, (n,) [rad/s].

        Exact for directed pairs, ``Σ|g_j|·limit_j``; never too low for the others.
        """
        speeds: NDArray[np.float64] = np.abs(self.gradients) @ limits
        if len(self.jacobians):
            columns = np.sqrt((self.jacobians * self.jacobians).sum(axis=-2))
            speeds[self.undirected] = (columns @ limits).max(axis=-1)
        return speeds

    def pair(self, index: int) -> Closing:
        """Return one pair alone."""
        before = int(self.undirected[:index].sum())
        count = int(self.undirected[index])
        return Closing(
            gradients=self.gradients[index : index + 1].copy(),
            undirected=self.undirected[index : index + 1].copy(),
            jacobians=self.jacobians[before : before + count].copy(),
        )
