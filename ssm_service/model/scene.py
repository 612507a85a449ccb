"""Hull pieces and obstacles in one geometry model, so that one call measures all of them."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Final

import coal
import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from .hulls import Part
from .robot import Robot
from .shapes import Obstacle

_FIRST_CAPACITY: Final = {"sphere": 16, "capsule": 16, "cylinder": 4, "box": 4}
_FAILED: Final = 1e300


@dataclass(slots=True, kw_only=True, eq=False)
class Slot:
    """Preallocated room for one obstacle of a given shape; rewritten in place.

    Attributes:
        shape: The obstacle's shape.
        solid: Coal's shape in the geometry model.
        placement: Its pose in the geometry model, obstacle to base.
        core: What the exact tier measures to: a sphere's centre, a capsule's segment, else the solid.
        radius: What the exact tier subtracts from the distance to the core [m].
        transform_core: Coal's pose, obstacle to base.
        pairs: Indices of this slot's collision pairs, one for each hull piece.
        results: Coal's results for ``pairs``, alive and rewritten by each computation.
        size: The size now written.
        active: Whether the pairs are computed.
    """

    shape: str
    solid: Any
    placement: Any
    core: Any
    radius: float
    transform_core: Any
    pairs: range
    results: list[Any]
    size: tuple[float, ...]
    active: bool


class Scene:
    """The hull pieces of all parts against as many obstacles as there are now.

    Attributes:
        parts: The links' geometries.
        piece_count: Number of hull pieces of all parts.
        results: Coal's results, for each obstacle the pieces in their order: piece ``k`` and obstacle ``j``
            at ``j * piece_count + k``.
        result: Coal's result of the last ``measure``.
        piece_radii: (n_pieces,) of a ball round each hull piece [m].
    """

    def __init__(self, robot: Robot, parts: tuple[Part, ...]) -> None:
        self.parts = parts
        self.piece_count = sum(len(part.pieces) for part in parts)
        self._slots: list[Slot] = []
        self._obstacles: tuple[Obstacle, ...] = ()
        self._written: list[bool] = []
        self.results: list[Any] = []
        self._model = robot.model
        self._data = robot.model.createData()
        self._capacity = dict(_FIRST_CAPACITY)
        self._shapes: tuple[str, ...] = ()
        balls = [_ball(piece) for part in parts for piece in part.pieces]
        self._ball_in_piece = [centre for centre, _ in balls]
        self._pieces = [piece for part in parts for piece in part.pieces]
        self.piece_radii = np.array([radius for _, radius in balls])
        self._centres = np.empty((0, 1, 3))
        self._reach = np.empty((0, len(self._pieces)))
        self._placed: tuple[bytes, NDArray[np.float64]] | None = None
        self._request, self.result = coal.DistanceRequest(), coal.DistanceResult()
        self._build()

    def set_obstacles(self, obstacles: Sequence[Obstacle]) -> None:
        """Take the obstacles. Only a change of the sequence of shapes costs more than a few microseconds.

        Coal learns a size and a pose when it is first asked about the obstacle (``slot``): most obstacles
        are too far away for that.
        """
        shapes = tuple([obstacle.shape for obstacle in obstacles])
        if shapes != self._shapes:
            self._allot(shapes)
        self._obstacles = tuple(obstacles)
        self._written = [False] * len(shapes)
        self._centres = np.array([obstacle.position for obstacle in obstacles]).reshape(-1, 1, 3)
        radii = np.array([_ball_radius(obstacle) for obstacle in obstacles])
        self._reach = radii[:, np.newaxis] + self.piece_radii
        self._placed = None

    def slot(self, index: int) -> Slot:
        """Return an obstacle's slot, with its size and pose written."""
        slot = self._slots[index]
        if not self._written[index]:
            self._written[index] = True
            obstacle = self._obstacles[index]
            if slot.size != obstacle.size:
                _write_size(slot, obstacle.size)
            centre = np.array(obstacle.position)
            slot.placement.translation = centre
            slot.transform_core.setTranslation(centre)
            if slot.shape != "sphere":
                rotation = obstacle.rotation()
                slot.placement.rotation = rotation
                slot.transform_core.setRotation(rotation)
        return slot

    def compute(self, q: NDArray[np.float64]) -> list[float]:
        """Compute the signed distances of all pieces to all obstacles.

        Returns:
            In the order of ``results`` [m]; ``-inf`` where Coal failed, so that failure is never far.
        """
        for index in range(len(self._slots)):
            self.slot(index)
        self._placed = None
        pin.computeDistances(self._model, self._data, self._geometry, self._geometry_data, q)
        distances = [result.min_distance for result in self.results]
        if not abs(sum(distances)) < _FAILED:  # one sum finds NaN, inf and Coal's 1.8e308
            distances = [d if abs(d) < _FAILED else -math.inf for d in distances]
        return distances

    def place(self, q: NDArray[np.float64]) -> NDArray[np.float64]:
        """Place everything without measuring it, and bound each distance by balls round piece and obstacle.

        Returns:
            (n_obstacles, n_pieces) [m], never above the distance of the hull piece; not to be changed. What
            stands as it stood at the last call is not placed again.
        """
        key = q.tobytes()
        if self._placed is None or self._placed[0] != key:
            pin.updateGeometryPlacements(self._model, self._data, self._geometry, self._geometry_data, q)
            apart = self._centres - self.piece_centres()
            bounds = np.sqrt(np.einsum("ijk,ijk->ij", apart, apart)) - self._reach
            self._placed = key, bounds
        return self._placed[1]

    def measure(self, obstacle: int, piece: int) -> float:
        """Return the signed distance of one hull piece to one obstacle [m]; ``-inf`` where Coal failed.

        ``result`` then has the points.
        """
        slot = self.slot(obstacle)
        self.result.clear()
        distance = coal.distance(
            self._pieces[piece],
            self._transform_of_piece(piece),
            slot.solid,
            slot.transform_core,
            self._request,
            self.result,
        )
        return float(distance) if abs(distance) < _FAILED else -math.inf

    def hull_normal(self, obstacle: int, piece: int) -> NDArray[np.float64]:
        """Return Coal's normal from a hull piece to an obstacle, (3,), base frame."""
        self.measure(obstacle, piece)
        return np.array(self.result.normal)

    def piece_centres(self) -> NDArray[np.float64]:
        """Return the middles of the balls round all hull pieces, (n_pieces, 3) [m], as last placed."""
        return np.array(self._ball_centres)

    def centre_of(self, piece: int) -> NDArray[np.float64]:
        """Return the middle of the ball round a hull piece, (3,), base frame, as of the last computation."""
        return np.array(self._ball_centres[piece])

    def placement_of(self, part: Part) -> Any:
        """Return the pose of a part's geometry in the base frame, as of the last computation."""
        return self._geometry_data.oMg[part.first]

    def transform_of(self, part: Part) -> Any:
        """Return Coal's pose of a part, link to base, as of the last computation; not to be kept."""
        return self._transform_of_piece(part.first)

    def _transform_of_piece(self, piece: int) -> Any:
        transform, rotation, translation = self._poses[piece]
        transform.setTransform(rotation, translation)
        return transform

    def _allot(self, shapes: tuple[str, ...]) -> None:
        """Give each obstacle a slot of its shape, and switch the pairs of the other slots off."""
        grown = False
        for shape in set(shapes):
            while self._capacity[shape] < shapes.count(shape):
                self._capacity[shape] *= 2
                grown = True
        if grown:
            self._build()
        free = {shape: iter(slots) for shape, slots in self._all_slots.items()}
        self._slots = [next(free[shape]) for shape in shapes]
        in_use = {id(slot) for slot in self._slots}
        for slots in self._all_slots.values():
            for slot in slots:
                self._switch(slot, id(slot) in in_use)
        self.results = [result for slot in self._slots for result in slot.results]
        self._shapes = shapes

    def _switch(self, slot: Slot, active: bool) -> None:
        if slot.active == active:
            return
        change = (
            self._geometry_data.activateCollisionPair
            if active
            else self._geometry_data.deactivateCollisionPair
        )
        for pair in slot.pairs:
            change(pair)
        slot.active = active

    def _build(self) -> None:
        """Build the geometry model for the present capacity, with every pair switched off."""
        self._geometry = pin.GeometryModel()
        for part in self.parts:
            source = part.source
            for piece in part.pieces:
                self._add(
                    f"{source.name}/{self._geometry.ngeoms}",
                    source.parentJoint,
                    source.parentFrame,
                    source.placement,
                    piece,
                )
        kinds = [shape for shape, count in self._capacity.items() for _ in range(count)]
        for shape in kinds:
            self._add(f"{shape}/{self._geometry.ngeoms}", 0, 0, pin.SE3.Identity(), _solid(shape))
        first_ball = self._geometry.ngeoms
        self._add_balls()
        pairs = pin.StdVec_CollisionPair()
        for j in range(len(kinds)):
            for piece in range(self.piece_count):
                pairs.append(pin.CollisionPair(piece, self.piece_count + j))
        self._geometry.collisionPairs.extend(pairs)
        self._geometry_data = pin.GeometryData(self._geometry)
        # Pinocchio's own memory, seen as arrays: each placement rewrites it.
        placements = self._geometry_data.oMg
        self._ball_centres = [placements[first_ball + i].translation for i in range(self.piece_count)]
        self._poses = [
            (coal.Transform3s(), placements[i].rotation, placements[i].translation)
            for i in range(self.piece_count)
        ]
        self._all_slots: dict[str, list[Slot]] = {shape: [] for shape in self._capacity}
        for j, shape in enumerate(kinds):
            self._all_slots[shape].append(self._slot(shape, j))
        self._slots, self.results, self._shapes = [], [], ()
        self._placed = None
        self._obstacles, self._written = (), []
        for slots in self._all_slots.values():
            for slot in slots:
                self._switch(slot, False)

    def _add_balls(self) -> None:
        """Add a point in the middle of each piece, so that Pinocchio places it with the rest."""
        sources = [part.source for part in self.parts for _ in part.pieces]
        for source, centre in zip(sources, self._ball_in_piece, strict=True):
            placement = source.placement * pin.SE3(np.eye(3), centre)
            name = f"{source.name}/{self._geometry.ngeoms}"
            self._add(name, source.parentJoint, source.parentFrame, placement, coal.Sphere(1.0))

    def _add(self, name: str, joint: int, frame: int, placement: Any, shape: Any) -> None:
        self._geometry.addGeometryObject(pin.GeometryObject(name, joint, frame, placement, shape))

    def _slot(self, shape: str, index: int) -> Slot:
        item = self._geometry.geometryObjects[self.piece_count + index]
        pairs = range(index * self.piece_count, (index + 1) * self.piece_count)
        return Slot(
            shape=shape,
            solid=item.geometry,
            placement=item.placement,
            core=_core(shape, item.geometry),
            radius=0.0,
            transform_core=coal.Transform3s(),
            pairs=pairs,
            results=[self._geometry_data.distanceResults[pair] for pair in pairs],
            size=(),
            active=True,
        )


def _ball(piece: Any) -> tuple[NDArray[np.float64], float]:
    """Return centre, (3,), and radius of a ball round a convex piece [m], in the piece's frame."""
    if isinstance(piece, coal.ConvexBase):
        points = np.array(piece.points())
        centre = (points.min(axis=0) + points.max(axis=0)) / 2.0
        return centre, float(np.linalg.norm(points - centre, axis=1).max())
    piece.computeLocalAABB()
    return np.array(piece.aabb_center), float(piece.aabb_radius)


def _ball_radius(obstacle: Obstacle) -> float:
    """Return the radius of a ball round an obstacle, about its position [m]."""
    if obstacle.shape == "sphere":
        return obstacle.size[0]
    if obstacle.shape == "capsule":
        return obstacle.size[0] + 0.5 * obstacle.size[1]
    if obstacle.shape == "cylinder":
        return math.hypot(obstacle.size[0], 0.5 * obstacle.size[1])
    return 0.5 * math.hypot(*obstacle.size)


def _solid(shape: str) -> Any:
    if shape == "sphere":
        return coal.Sphere(1.0)
    if shape == "capsule":
        return coal.Capsule(1.0, 1.0)
    if shape == "cylinder":
        return coal.Cylinder(1.0, 1.0)
    return coal.Box(1.0, 1.0, 1.0)


def _core(shape: str, solid: Any) -> Any:
    if shape == "sphere":
        return coal.Sphere(0.0)
    if shape == "capsule":
        return coal.Capsule(0.0, 1.0)
    return solid


def _write_size(slot: Slot, size: tuple[float, ...]) -> None:
    if slot.shape == "box":
        slot.solid.halfSide = np.array(size) / 2.0
    else:
        slot.solid.radius = size[0]
        if slot.shape != "sphere":
            slot.solid.halfLength = size[1] / 2.0
        if slot.shape == "capsule":
            slot.core.halfLength = size[1] / 2.0
    slot.radius = size[0] if slot.shape in ("sphere", "capsule") else 0.0
    slot.size = size
