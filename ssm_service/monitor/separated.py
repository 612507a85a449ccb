"""All pairs of one tick as arrays: how near, how fast, and what the protective separation leaves."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from msgspec import Struct
from numpy.typing import NDArray

from ..safety import (
    Closing,
    ReactionTime,
    SeparationLaw,
    SeparationTerms,
    StoppingLevels,
    Zone,
    greatest_scaling,
    zone_of,
)

Array = NDArray[np.float64]


class PairTable(Struct, frozen=True, kw_only=True, eq=False):
    """The p pairs of one tick; vectors in the base frame.

    Attributes:
        ids: Ids of the tracked obstacles.
        link: (p,) indices into ``Separated.links``.
        obstacle: (p,) indices into ``ids``; -1 for what the rings see or cannot rule out.
        distance: (p,) [m], as the equation takes it.
        exact: (p,) whether it was measured to the link's triangles.
        point_on_link: (p, 3) [m].
        point_on_obstacle: (p, 3) [m].
        normal: (p, 3) unit, from the obstacle to the link.
        human_speed: (p,) v_h [m/s].
        uncertainty: (p,) Z_d [m].
        reaction_time: (p,) T_r [s].
        closing: Their closing speeds by joint velocity.
    """

    ids: tuple[str, ...]
    link: NDArray[np.intp]
    obstacle: NDArray[np.intp]
    distance: Array
    exact: NDArray[np.bool_]
    point_on_link: Array
    point_on_obstacle: Array
    normal: Array
    human_speed: Array
    uncertainty: Array
    reaction_time: Array
    closing: Closing

    def followed_by(self, other: PairTable) -> PairTable:
        """Return these pairs and then those of ``other``, which has no ids of its own."""

        def both(name: str) -> Array:
            """Return one column of both tables."""
            joined: Array = np.concatenate([getattr(self, name), getattr(other, name)])
            return joined

        vectors = {name: both(name) for name in self.__struct_fields__ if name not in ("ids", "closing")}
        closing = Closing(
            gradients=np.concatenate([self.closing.gradients, other.closing.gradients]),
            undirected=np.concatenate([self.closing.undirected, other.closing.undirected]),
            jacobians=other.closing.jacobians,
        )
        return PairTable(ids=self.ids, closing=closing, **vectors)  # type: ignore[arg-type]


class Limit(Struct, frozen=True, kw_only=True, eq=False):
    """What limits a joint velocity: some pairs, and their speeds by stopping level.

    Attributes:
        closing: The p pairs.
        by_level: (p, L) [m/s].
        levels: The stopping levels.
    """

    closing: Closing
    by_level: Array
    levels: StoppingLevels

    def scaling(self, velocity: Array, share: float) -> float:
        """Return the greatest 0 ≤ s ≤ 1 at which ``s`` times a velocity keeps every pair's separation.

        Args:
            velocity: (n,) [rad/s].
            share: The greatest share of its limit that any joint has in it.
        """
        return greatest_scaling(self.closing.at(velocity), share, self.by_level, self.levels)


class Separated(Struct, frozen=True, kw_only=True, eq=False):
    """What the protective separation says of one tick.

    Attributes:
        table: The p pairs.
        links: Names by ``table.link``.
        closing_speed: (p,) v_r as measured [m/s], negative in retreat.
        max_closing_speed: (p,) at which S_p is the distance [m/s]; 0 is a protective stop.
        shares: (p,) σ: the share of all joint speeds that is safe in any direction.
        scaling: The least σ; 1 without pairs.
        limiting: The pair that leaves the least; ``None`` without pairs.
        limit: What limits commands.
        level: The stopping level of the measured joint velocity.
        reactions: T_r by source.
        intrusion: C [m].
        robot_uncertainty: Z_r [m].
        red_scaling: σ below which the zone is red.
    """

    table: PairTable
    links: tuple[str, ...]
    closing_speed: Array
    max_closing_speed: Array
    shares: Array
    scaling: float
    limiting: int | None
    limit: Limit
    level: int
    reactions: Mapping[str, ReactionTime]
    intrusion: float
    robot_uncertainty: float
    red_scaling: float

    def __len__(self) -> int:
        return len(self.shares)

    @property
    def zone(self) -> Zone:
        """The zone of this tick by its separation alone."""
        return zone_of(self.scaling, self.red_scaling)

    @property
    def reaction(self) -> ReactionTime | None:
        """T_r of the limiting pair; the longest without pairs, ``None`` where no source is fresh."""
        if self.limiting is not None:
            return self.reactions[self.source(self.limiting)]
        return max(self.reactions.values(), key=lambda time: time.total, default=None)

    @property
    def stopping_time(self) -> float:
        """T_s [s] at the measured joint velocity."""
        return float(self.limit.levels.times[self.level])

    def source(self, pair: int) -> str:
        """Return ``ranges`` or ``obstacles``."""
        return "ranges" if self.table.obstacle[pair] < 0 else "obstacles"

    def link(self, pair: int) -> str:
        """Return a pair's link."""
        return self.links[int(self.table.link[pair])]

    def obstacle(self, pair: int) -> str | None:
        """Return the id of a pair's obstacle; ``None`` for what the rings see."""
        index = int(self.table.obstacle[pair])
        return None if index < 0 else self.table.ids[index]

    def terms(self, pair: int) -> SeparationTerms:
        """Return the terms of S_p at the measured closing speed."""
        levels = self.limit.levels
        law = SeparationLaw(
            human_speed=float(self.table.human_speed[pair]),
            reaction_time=float(self.table.reaction_time[pair]),
            stopping_time=self.stopping_time,
            stopping_gain=float(levels.gains[self.level]),
            intrusion=self.intrusion,
            human_uncertainty=float(self.table.uncertainty[pair]),
            robot_uncertainty=self.robot_uncertainty,
        )
        return law.terms(float(self.closing_speed[pair]))

    def limit_of(self, pair: int) -> Limit:
        """Return what one pair alone limits, in arrays of its own."""
        return Limit(
            closing=self.limit.closing.pair(pair),
            by_level=self.limit.by_level[pair : pair + 1].copy(),
            levels=self.limit.levels,
        )


def joined(tables: Sequence[PairTable], joints: int) -> PairTable:
    """Return the pairs of none, one or two tables of a robot with so many joints."""
    if not tables:
        none, vectors, indices = np.empty(0), np.empty((0, 3)), np.empty(0, dtype=np.intp)
        return PairTable(
            ids=(),
            link=indices,
            obstacle=indices,
            distance=none,
            exact=np.empty(0, dtype=np.bool_),
            point_on_link=vectors,
            point_on_obstacle=vectors,
            normal=vectors,
            human_speed=none,
            uncertainty=none,
            reaction_time=none,
            closing=Closing.directed(np.empty((0, joints))),
        )
    return tables[0] if len(tables) == 1 else tables[0].followed_by(tables[1])
