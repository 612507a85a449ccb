"""Exact distance from the robot's links to the obstacles, by Coal."""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import lru_cache
from typing import Final

import numpy as np
from msgspec import Struct
from numpy.typing import ArrayLike, NDArray

from ..errors import InputError, listed
from .exact import ExactTier, Measured
from .hulls import Part, build_parts
from .pairs import Pairs
from .robot import Robot
from .scene import Scene
from .shapes import Obstacle
from .witness import Vector, Witness

_SLACK_M: Final = 5e-6  # GJK's hull distances exceed the mesh's by up to 1.7 µm


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
        self._in_pieces = [parts[-1].last > parts[0].first + 1 for parts in self._parts_of_link]
        self._scene = Scene(robot, self._parts)
        self._exact = ExactTier(self._scene)
        self._witness = Witness(self._scene)
        self._ids: tuple[str, ...] = ()
        self._bounds: NDArray[np.float64] = np.empty((0, 0))
        self._hulls: NDArray[np.float64] = np.empty((0, 0))
        self._beside: dict[str, NDArray[np.bool_]] = {}

    @property
    def obstacle_ids(self) -> tuple[str, ...]:
        """Ids of the obstacles, in the order in which they were set."""
        return self._ids

    def set_obstacles(self, obstacles: Sequence[Obstacle]) -> None:
        """Replace all obstacles. Whatever is not in the new sequence is gone."""
        self._ids = tuple([obstacle.id for obstacle in obstacles])
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
        found = self._least(_Search(self._scene, bounds))
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
        found = self._least(_Search(self._scene, np.where(others, math.inf, self._bounds)))
        return found.distance if found else None

    def nearest_of(self, pairs: Pairs) -> ClosestPair | None:
        """Return the nearest pair of all, exactly, from what ``pairs`` measured; there it is refined by this.

        Args:
            pairs: What ``pairs`` returned last.
        """
        if not self._ids:
            return None
        self._bounds = self._hulls
        found = self._least(_Known(self._hulls))
        if found is None:
            return None
        rows = ((pairs.link == found.part.link_index) & (pairs.obstacle == found.obstacle)).nonzero()[0]
        nearest = self._closest_pair(found)
        for row in rows.tolist():
            vectors = nearest.point_on_link, nearest.point_on_obstacle, nearest.normal
            _write(pairs, row, found.distance, vectors)
        return nearest

    def _least(self, search: _Search | _Known) -> Measured | None:
        first = search.nearest_hull()
        best = self._measure(first, search, math.inf)
        limit = best.distance if best else math.inf
        seen = {self._pair_of(first)}
        for bound, index in search.hulls_below(limit + _SLACK_M):
            if bound - _SLACK_M >= limit:
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
        bounds: NDArray[np.float64] = np.minimum.reduceat(pieces, self._first_of_link, axis=1).T - _SLACK_M
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
        balls = self._scene.place(q).ravel() - _SLACK_M
        # not above or at it, so that what is no number is looked at
        near = (~(balls - _SLACK_M >= clearance)).nonzero()[0]
        for index in near[np.argsort(balls[near])].tolist():
            if not self._scene.measure(*divmod(index, self._scene.piece_count)) - _SLACK_M >= clearance:
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
        hulls = self._scene.compute(q) if self._ids else []
        pairs = []
        count = self._scene.piece_count
        for link in range(len(self._parts_of_link)):
            for obstacle in range(len(self._ids)):
                start = obstacle * count
                nearest = self._exact_pair(link, obstacle, hulls[start : start + count])
                pairs.append(self._closest_pair(nearest))
        return pairs

    def pairs(self, position: ArrayLike, within: float = math.inf, *, located: bool = True) -> Pairs:
        """Return every monitored link with every obstacle by the hull pieces, in one call of Pinocchio.

        Args:
            position: (n,) [rad or m].
            within: Pairs that are not nearer than this are left out [m].
            located: Whether points and normals are wanted of all pairs. They cost most; without, ``locate``
                gives those of some.

        Raises:
            InputError: ``wrong_length`` or ``not_finite``.
        """
        q = self._robot.pinocchio_configuration(position)
        obstacles, count = len(self._ids), self._scene.piece_count
        pieces = np.array(self._scene.compute(q) if obstacles else []).reshape(obstacles, count)
        self._hulls = pieces
        if obstacles:
            distance = (np.minimum.reduceat(pieces, self._first_of_link, axis=1).T - _SLACK_M).ravel()
        else:
            distance = np.empty(0)
        link, obstacle = _indices(len(self._parts_of_link), obstacles)
        if within < math.inf:
            near = (~(distance >= within)).nonzero()[0]  # what is no number stays in
            link, obstacle, distance = link[near], obstacle[near], distance[near]
        nowhere = np.full((3, len(distance), 3), math.nan)
        found = Pairs(
            links=self._robot.monitored_links,
            obstacles=self._ids,
            link=link,
            obstacle=obstacle,
            distance=distance,
            exact=np.zeros(len(distance), dtype=np.bool_),
            point_on_link=nowhere[0],
            point_on_obstacle=nowhere[1],
            normal=nowhere[2],
            located=np.zeros(len(distance), dtype=np.bool_),
        )
        if located:
            self.locate(found, np.arange(len(distance)))
            found.located = None
        return found

    def locate(self, pairs: Pairs, rows: NDArray[np.intp]) -> None:
        """Give some pairs their points and normals.

        Args:
            pairs: What ``pairs`` returned last; they are rewritten in place.
            rows: (k,) which of them; those that have them already keep them.
        """
        if pairs.located is None:
            return
        rows = rows[~pairs.located[rows]]
        if not len(rows):
            return
        links, obstacles, first = (
            pairs.link[rows].tolist(),
            pairs.obstacle[rows].tolist(),
            self._first_of_link,
        )
        pieces = [
            self._nearest_piece(link, obstacle) if self._in_pieces[link] else first[link]
            for link, obstacle in zip(links, obstacles, strict=True)
        ]
        found = self._witness.of_hulls(pieces, obstacles)
        pairs.point_on_link[rows], pairs.point_on_obstacle[rows], pairs.normal[rows] = found
        pairs.located[rows] = True

    def refine(self, pairs: Pairs, rows: Sequence[int]) -> None:
        """Measure some pairs to the links' triangles.

        Args:
            pairs: What ``pairs`` returned last; they are rewritten in place.
            rows: Which of them.
        """
        for row in rows:
            link, obstacle = int(pairs.link[row]), int(pairs.obstacle[row])
            measured = self._exact_pair(link, obstacle, self._hulls[obstacle].tolist())
            _write(pairs, row, measured.distance, self._witness.of(measured))

    def _nearest_piece(self, link: int, obstacle: int) -> int:
        """Return the hull piece of a link that is nearest to an obstacle, as ``pairs`` measured last."""
        first, last = self._first_of_link[link], self._parts_of_link[link][-1].last
        return first + int(self._hulls[obstacle, first:last].argmin())

    def _exact_pair(self, link: int, obstacle: int, hulls: list[float]) -> Measured:
        """Measure a link against an obstacle, given the distances of all hull pieces to it [m]."""
        measured = [
            self._exact.measure(part, obstacle, hulls[part.first : part.last])
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

    def _measure(self, index: int, search: _Search | _Known, limit: float) -> Measured | None:
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
    if pairs.located is not None:
        pairs.located[row] = True


class _Known:
    """Hull distances that are measured already, as ``_Search`` gives them.

    Args:
        hulls: (n_obstacles, n_pieces) [m].
    """

    def __init__(self, hulls: NDArray[np.float64]) -> None:
        self._hulls = hulls

    def nearest_hull(self) -> int:
        """Return the index of the least hull distance."""
        return int(self._hulls.argmin())

    def hulls_below(self, limit: float) -> list[tuple[float, int]]:
        """Return all hull distances below a limit [m] with their indices, in rising order."""
        flat = self._hulls.ravel()
        near = (flat < limit).nonzero()[0]
        return sorted(zip(flat[near].tolist(), near.tolist(), strict=True))

    def of_part(self, index: int, part: Part) -> list[float]:
        """Return the hull distances of all of a part's pieces to the obstacle of ``index`` [m]."""
        found: list[float] = self._hulls[index // self._hulls.shape[1], part.first : part.last].tolist()
        return found


class _Search:
    """Hull distances measured only where the balls' bounds say that they could matter.

    Indices speak of obstacle and piece, ``obstacle * piece_count + piece``, as in ``Scene.compute``.
    """

    def __init__(self, scene: Scene, bounds: NDArray[np.float64]) -> None:
        self._scene = scene
        self._count = scene.piece_count
        self._bounds = bounds.ravel() - _SLACK_M  # rounding, with plenty of room
        self._hulls: dict[int, float] = {}

    def nearest_hull(self) -> int:
        """Return the index of the least hull distance."""
        best = int(self._bounds.argmin())
        least = self._hull(best)
        for bound, index in self._below(least):
            if bound >= least:
                break
            hull = self._hull(index)
            if hull < least:
                best, least = index, hull
        return best

    def hulls_below(self, limit: float) -> list[tuple[float, int]]:
        """Return all hull distances below a limit [m] with their indices, in rising order."""
        return sorted([(hull, i) for _, i in self._below(limit) if (hull := self._hull(i)) < limit])

    def of_part(self, index: int, part: Part) -> list[float]:
        """Return the hull distances of all of a part's pieces to the obstacle of ``index`` [m]."""
        start = index - index % self._count
        return [self._hull(start + piece) for piece in range(part.first, part.last)]

    def _below(self, limit: float) -> list[tuple[float, int]]:
        near = (self._bounds < limit).nonzero()[0].tolist()
        return sorted([(float(self._bounds[index]), index) for index in near])

    def _hull(self, index: int) -> float:
        hull = self._hulls.get(index)
        if hull is None:
            hull = self._hulls[index] = self._scene.measure(*divmod(index, self._count))
        return hull
