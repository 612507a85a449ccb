"""Exact distance from the robot's links to the obstacles, by Coal."""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import lru_cache
from typing import overload

import numpy as np
from msgspec import Struct
from numpy.typing import ArrayLike, NDArray

from ..errors import InputError, listed
from .closing import greatest_speeds
from .exact import ExactTier, Measured
from .hulls import build_parts
from .pairs import Pairs
from .robot import Robot
from .scene import Scene
from .search import SLACK_M, Known, Search
from .shapes import Obstacle
from .witness import Vector, Witness, coal_vectors


class ClosestPair(Struct, frozen=True, kw_only=True, eq=False):
    """The nearest points of a link and an obstacle; all vectors in the base frame.

    Attributes:
        link: Name of the link.
        obstacle: Id of the obstacle.
        distance: Signed distance [m]; negative in penetration.
        point_on_link: (3,) [m].
        point_on_obstacle: (3,) [m].
        normal: (3,) unit, from the obstacle to the link in every case, also in penetration.
    """

    link: str
    obstacle: str
    distance: float
    point_on_link: NDArray[np.float64]
    point_on_obstacle: NDArray[np.float64]
    normal: NDArray[np.float64]


class DistanceModel:
    """Distances between a robot's monitored links and a changing set of obstacles.

    Every link's mesh lies in a few convex pieces, whose distance is never too large. One call of Pinocchio
    measures all of them against all obstacles, where all are asked for. The nearest pair needs few of them:
    balls round pieces and obstacles bound all pairs in one expression, hull pieces are measured in rising
    order of these, and pairs to the triangles in rising order of the hulls', each until the next bound
    reaches the best distance found.

    In penetration beyond what the mesh can tell (an obstacle's centre inside a hull piece, or its core
    through the surface) distance, points and normal are those of the deepest hull piece, which is never
    less severe. Not for use by several threads at once.
    """

    def __init__(self, robot: Robot) -> None:
        """Build the hull pieces.

        Raises:
            ConfigError: A mesh has no usable convex hull.
        """
        self._robot = robot
        self._parts = build_parts(robot)
        self._part_of_piece = [part for part in self._parts for _ in part.pieces]
        self._parts_of_link = [[p for p in self._parts if p.link == link] for link in robot.monitored_links]
        self._first_of_link = [parts[0].first for parts in self._parts_of_link]
        self._link_of_piece = np.array([part.link_index for part in self._part_of_piece], dtype=np.intp)
        self._in_pieces = [parts[-1].last > parts[0].first + 1 for parts in self._parts_of_link]
        self._scene = Scene(robot, self._parts)
        self._exact = ExactTier(self._scene)
        self._witness = Witness(self._scene)
        self._ids: tuple[str, ...] = ()
        self.set_obstacles(())
        self._bounds: NDArray[np.float64] = np.empty((0, 0))
        self._hulls: Known | Search = Known(np.empty((0, 0)))
        self._beside: dict[str, NDArray[np.bool_]] = {}

    @property
    def obstacle_ids(self) -> tuple[str, ...]:
        """Ids of the obstacles, in the order in which they were set."""
        return self._ids

    def set_obstacles(self, obstacles: Sequence[Obstacle]) -> None:
        """Replace all obstacles. Whatever is not in the new sequence is gone."""
        self._ids = tuple([obstacle.id for obstacle in obstacles])
        none, nothing = np.empty(0, dtype=np.intp), np.empty((0, 3))
        self._nowhere = self._pairs(none, none, np.empty(0), (nothing, nothing, nothing))
        self._scene.set_obstacles(obstacles)

    def nearest(self, position: ArrayLike, link: str | None = None) -> ClosestPair | None:
        """Return the nearest pair of all, or of one link, exactly; None where there is no obstacle.

        Args:
            position: (n,) [rad or m].
            link: Only this monitored link counts, where given.

        Raises:
            InputError: ``wrong_length``, ``not_finite`` or ``unknown_link``.
        """
        q = self._robot.pinocchio_configuration(position)
        others = None if link is None else self._pieces_beside(link)
        if not self._ids:
            return None
        bounds = self._bounds = self._scene.place(q)
        if others is not None:
            bounds = np.where(others, math.inf, bounds)
        found = self._least(Search(self._scene, bounds))
        return self._closest_pair(found) if found else None

    def distance_from(self, link: str) -> float | None:
        """Return the exact distance [m] of a link's nearest obstacle, as the last ``nearest`` put the arm.

        Args:
            link: A monitored link.

        Returns:
            None where there is no obstacle.

        Raises:
            InputError: ``unknown_link``.
        """
        others = self._pieces_beside(link)
        if not self._ids:
            return None
        found = self._least(Search(self._scene, np.where(others, math.inf, self._bounds)))
        return found.distance if found else None

    def nearest_of(self, pairs: Pairs) -> ClosestPair | None:
        """Return the nearest pair of all, exactly, from what ``pairs`` measured; there it is refined by this.

        Args:
            pairs: What ``pairs`` returned last.
        """
        if not self._ids:
            return None
        found = self._least(self._hulls)
        if found is None:
            return None
        rows = ((pairs.link == found.part.link_index) & (pairs.obstacle == found.obstacle)).nonzero()[0]
        nearest = self._closest_pair(found)
        for row in rows.tolist():
            vectors = nearest.point_on_link, nearest.point_on_obstacle, nearest.normal
            _write(pairs, row, found.distance, vectors)
        return nearest

    def _least(self, search: Search | Known) -> Measured | None:
        first = search.nearest_hull()
        best = self._measure(first, search, math.inf)
        limit = best.distance if best else math.inf
        seen = {self._pair_of(first)}
        for bound, index in search.hulls_below(limit + SLACK_M):
            if bound - SLACK_M >= limit:
                break
            pair = self._pair_of(index)
            if pair not in seen:
                seen.add(pair)
                better = self._measure(index, search, limit)
                if better is not None:
                    best, limit = better, better.distance
        return best

    def bounds(self, position: ArrayLike) -> NDArray[np.float64]:
        """Return lower bounds of the exact distances, by hull pieces alone.

        Args:
            position: (n,) [rad or m].

        Returns:
            (n_links, n_obstacles) [m]; -inf where Coal failed.

        Raises:
            InputError: ``wrong_length`` or ``not_finite``.
        """
        q = self._robot.pinocchio_configuration(position)
        if not self._ids:
            return np.empty((len(self._parts_of_link), 0))
        pieces = np.array(self._scene.compute(q)).reshape(len(self._ids), self._scene.piece_count)
        bounds: NDArray[np.float64] = np.minimum.reduceat(pieces, self._first_of_link, axis=1).T - SLACK_M
        return bounds

    def keeps(self, position: ArrayLike, clearance: float) -> bool:
        """Return whether every bound of ``bounds`` is at least ``clearance`` [m].

        Only hull pieces whose ball is nearer than that are measured, until one is too near.

        Args:
            position: (n,) [rad or m].
            clearance: [m].

        Raises:
            InputError: ``wrong_length`` or ``not_finite``.
        """
        q = self._robot.pinocchio_configuration(position)
        if not self._ids:
            return True
        balls = self._scene.place(q).ravel() - SLACK_M
        # not above or at it, so that what is no number is looked at
        near = (~(balls - SLACK_M >= clearance)).nonzero()[0]
        for index in near[np.argsort(balls[near])].tolist():
            if not self._scene.measure(*divmod(index, self._scene.piece_count)) - SLACK_M >= clearance:
                return False
        return True

    def all_pairs(self, position: ArrayLike) -> list[ClosestPair]:
        """Return the exact distance of every monitored link (outer) to every obstacle (inner).

        Args:
            position: (n,) [rad or m].

        Raises:
            InputError: ``wrong_length`` or ``not_finite``.
        """
        q = self._robot.pinocchio_configuration(position)
        hulls = np.array(self._scene.compute(q) if self._ids else []).reshape(-1, self._scene.piece_count)
        known = Known(hulls)
        return [
            self._closest_pair(self._exact_pair(link, obstacle, known))
            for link in range(len(self._parts_of_link))
            for obstacle in range(len(self._ids))
        ]

    def pairs(self, position: ArrayLike) -> Pairs:
        """Return every monitored link with every obstacle by the hull pieces, in one call of Pinocchio.

        Args:
            position: (n,) [rad or m].

        Raises:
            InputError: ``wrong_length`` or ``not_finite``.
        """
        q = self._robot.pinocchio_configuration(position)
        obstacles, count = len(self._ids), self._scene.piece_count
        pieces = np.array(self._scene.compute(q) if obstacles else []).reshape(obstacles, count)
        self._bounds, self._hulls = pieces, Known(pieces)
        link, obstacle = _indices(len(self._parts_of_link), obstacles)
        distance = np.empty(0)
        if obstacles:
            distance = (np.minimum.reduceat(pieces, self._first_of_link, axis=1).T - SLACK_M).ravel()
        places = zip(link.tolist(), obstacle.tolist(), strict=True)
        nearest = [self._nearest_piece(i, pieces[j]) for i, j in places]
        return self._pairs(link, obstacle, distance, self._witness.of_hulls(nearest, obstacle.tolist()))

    @overload
    def below(self, position: ArrayLike, limits: NDArray[np.float64]) -> Pairs: ...

    @overload
    def below(self, position: ArrayLike, limits: NDArray[np.float64], *, most: int) -> Pairs | None: ...

    def below(
        self, position: ArrayLike, limits: NDArray[np.float64], *, most: int | None = None
    ) -> Pairs | None:
        """Return the links and obstacles that are nearer by the hull pieces than a limit of their own.

        Only what the balls round pieces and obstacles do not rule out is measured.

        Args:
            position: (n,) [rad or m].
            limits: (n_links, n_obstacles) [m].
            most: Hull pieces that may be measured for it.

        Returns:
            None where more than ``most`` would have to be measured.

        Raises:
            InputError: ``wrong_length`` or ``not_finite``.
        """
        q = self._robot.pinocchio_configuration(position)
        if not self._ids:
            return self._nowhere
        scene, of_piece, allowed = self._scene, self._link_of_piece, limits.T
        balls = self._bounds = scene.place(q)
        self._hulls = Search(scene, balls)
        # Not at or above it, so that what is no number is looked at.
        near = (~(balls - SLACK_M >= allowed[:, of_piece])).nonzero()
        if not len(near[0]):
            return self._nowhere
        if most is not None and len(near[0]) > most:
            return None
        found: dict[tuple[int, int], tuple[float, int, tuple[Vector, Vector, Vector]]] = {}
        for obstacle, piece in zip(near[0].tolist(), near[1].tolist(), strict=True):
            distance = scene.measure(obstacle, piece) - SLACK_M
            pair = int(of_piece[piece]), obstacle
            if not (distance >= allowed[obstacle, pair[0]] or (pair in found and distance >= found[pair][0])):
                found[pair] = distance, piece, coal_vectors(scene.result)
        rows = sorted(found)
        link, obstacles = np.array(rows, dtype=np.intp).reshape(-1, 2).T
        pieces = [found[row][1] for row in rows]
        vectors = self._witness.sound(pieces, obstacles.tolist(), [found[row][2] for row in rows])
        return self._pairs(link, obstacles, np.array([found[row][0] for row in rows]), vectors)

    def link_speeds(
        self, position: ArrayLike, spatial: NDArray[np.float64], moved: NDArray[np.bool_], velocity: ArrayLike
    ) -> NDArray[np.float64]:
        """Return a speed that no point of each monitored link exceeds, (n_links,) [m/s].

        Args:
            position: (n,) [rad or m].
            spatial: (6, n), ``Kinematics.spatial_jacobian`` there.
            moved: (n_links, n) which joints move each link, from ``moved_by``.
            velocity: (n,) of the joints [rad/s].

        Raises:
            InputError: ``wrong_length`` or ``not_finite``, of the position.
        """
        self._scene.place(self._robot.pinocchio_configuration(position))
        centres, radii = self._scene.piece_centres(), self._scene.piece_radii
        moving = moved[self._link_of_piece] * np.asarray(velocity)
        speeds: NDArray[np.float64] = np.maximum.reduceat(
            greatest_speeds(spatial, moving, centres, radii), self._first_of_link
        )
        return speeds

    def refine(self, pairs: Pairs, rows: Sequence[int]) -> None:
        """Measure some pairs to the links' triangles.

        Args:
            pairs: What ``pairs`` or ``below`` returned last; they are rewritten in place.
            rows: Which of them.
        """
        for row in rows:
            measured = self._exact_pair(int(pairs.link[row]), int(pairs.obstacle[row]), self._hulls)
            _write(pairs, row, measured.distance, self._witness.of(measured))

    def _pairs(
        self,
        link: NDArray[np.intp],
        obstacle: NDArray[np.intp],
        distance: NDArray[np.float64],
        vectors: tuple[Vector, Vector, Vector],
    ) -> Pairs:
        return Pairs(
            links=self._robot.monitored_links,
            obstacles=self._ids,
            link=link,
            obstacle=obstacle,
            distance=distance,
            exact=np.zeros(len(distance), dtype=np.bool_),
            point_on_link=vectors[0],
            point_on_obstacle=vectors[1],
            normal=vectors[2],
        )

    def _nearest_piece(self, link: int, pieces: NDArray[np.float64]) -> int:
        """Return the hull piece of a link that is nearest to an obstacle.

        Args:
            link: Its index.
            pieces: (n_pieces,) distances of all pieces to the obstacle [m].
        """
        first = self._first_of_link[link]
        if not self._in_pieces[link]:
            return first
        return first + int(pieces[first : self._parts_of_link[link][-1].last].argmin())

    def _exact_pair(self, link: int, obstacle: int, hulls: Known | Search) -> Measured:
        """Measure a link against an obstacle, given what measures hull pieces."""
        start = obstacle * self._scene.piece_count
        measured = [
            self._exact.measure(part, obstacle, hulls.of_part(start, part))
            for part in self._parts_of_link[link]
        ]
        return min([m for m in measured if m is not None], key=lambda m: m.distance)

    def _pieces_beside(self, link: str) -> NDArray[np.bool_]:
        """Return which pieces are not those of ``link``, (n_pieces,)."""
        beside = self._beside.get(link)
        if beside is None:
            if link not in self._robot.monitored_links:
                allowed = f"a monitored link: {listed(self._robot.monitored_links)}"
                raise InputError("unknown_link", "link", link, allowed)
            beside = self._beside[link] = np.array([part.link != link for part in self._part_of_piece])
        return beside

    def _pair_of(self, index: int) -> tuple[int, int]:
        """Return the first piece of the part, and the obstacle, that an index into the hulls speaks of."""
        obstacle, piece = divmod(index, self._scene.piece_count)
        return self._part_of_piece[piece].first, obstacle

    def _measure(self, index: int, search: Search | Known, limit: float) -> Measured | None:
        obstacle, piece = divmod(index, self._scene.piece_count)
        part = self._part_of_piece[piece]
        return self._exact.measure(part, obstacle, search.of_part(index, part), limit)

    def _closest_pair(self, measured: Measured) -> ClosestPair:
        link_point, obstacle_point, normal = self._witness.of(measured)
        for vector in (link_point, obstacle_point, normal):
            vector.flags.writeable = False
        return ClosestPair(
            link=measured.part.link,
            obstacle=self._ids[measured.obstacle],
            distance=measured.distance,
            point_on_link=link_point,
            point_on_obstacle=obstacle_point,
            normal=normal,
        )


@lru_cache(maxsize=64)
def _indices(links: int, obstacles: int) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Return link and obstacle of each pair, read-only."""
    link, obstacle = np.indices((links, obstacles)).reshape(2, -1)
    link.flags.writeable = obstacle.flags.writeable = False
    return link, obstacle


def _write(pairs: Pairs, row: int, distance: float, vectors: tuple[Vector, Vector, Vector]) -> None:
    """Write an exact pair: points on link and obstacle and the normal."""
    pairs.distance[row], pairs.exact[row] = distance, True
    pairs.point_on_link[row], pairs.point_on_obstacle[row], pairs.normal[row] = vectors
