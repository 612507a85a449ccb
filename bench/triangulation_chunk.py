"""One chunk of the sweep: scenes of one shape, their truth, their readings, and what every estimator says."""

from __future__ import annotations

import threading
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from ssm_service.errors import SsmError
from ssm_service.model import ClosestPair, DistanceModel, Obstacle, Robot
from ssm_service.perception import scan, sphere_readings

from .sweep import Arrays
from .triangulation_estimators import ESTIMATORS, Estimators
from .triangulation_noise import NOISES, with_noise
from .triangulation_person import reaching
from .triangulation_scenes import RADIUS_M, SHAPES, Draws, Floats, ball_centres, draw, moved, solids
from .triangulation_truth import LinkTruth

CHUNK = {"sphere": 1000, "forearm": 100, "hand": 100, "person": 20}
"""Scenes of one chunk, 0.1 s of work or little more."""

_local = threading.local()


@dataclass(frozen=True, slots=True, kw_only=True)
class Settings:
    """What a chunk depends on, beside its shape and its number.

    Attributes:
        robot: Name or path of the robot file; its first ring is the one that is measured.
        seed: Of everything drawn.
        noises: Of ``NOISES``, those that are measured.
        estimators: Of ``ESTIMATORS``, likewise.
        arm_every: The whole arm's distance is measured for one ball scene in so many; 0 for none at all.
    """

    robot: str
    seed: int
    noises: tuple[str, ...] = tuple(NOISES)
    estimators: tuple[str, ...] = ESTIMATORS
    arm_every: int = 1

    def to_builtins(self) -> dict[str, Any]:
        """Return JSON values."""
        return {name: list(v) if isinstance(v, tuple) else v for name, v in asdict(self).items()}


@dataclass(frozen=True, slots=True, kw_only=True)
class Task:
    """One chunk: what ``work`` is given.

    Attributes:
        settings: Of the sweep.
        shape: Of ``SHAPES``.
        index: Its number among the chunks of its shape.
        count: Number of scenes.
    """

    settings: Settings
    shape: str
    index: int
    count: int


def tasks(settings: Settings, scenes: dict[str, int]) -> list[Task]:
    """Return the chunks that make up so many scenes of each shape."""
    return [
        Task(settings=settings, shape=shape, index=i, count=min(CHUNK[shape], count - i * CHUNK[shape]))
        for shape, count in scenes.items()
        for i in range(-(-count // CHUNK[shape]))
    ]


def work(task: Task) -> Arrays:
    """Do one chunk; nothing but the task decides what comes out.

    Returns:
        For each scene: ``gap``, ``bearing``, ``axial`` [m, rad], the least distance from the link, ``link``,
        and from the arm, ``arm`` (NaN where not measured), the bearing ``towards`` the obstacle's nearest
        point, and for each noise ``NOISE.echoes`` and each estimator's ``NOISE.ESTIMATOR`` and
        ``NOISE.ESTIMATOR.bearing``.
    """
    bench = _bench(task.settings.robot)
    place = (SHAPES.index(task.shape), task.index)
    streams = np.random.SeedSequence(task.settings.seed, spawn_key=place).spawn(1 + len(NOISES))
    generators = [np.random.default_rng(stream) for stream in streams]
    draws = draw(bench.robot, task.count, generators[0])
    if task.shape == "sphere":
        found, readings = bench.balls(draws, task.settings.arm_every)
    else:
        found, readings = bench.bodies(task.shape, draws, task.settings.arm_every)
    for noise, generator in zip(NOISES, generators[1:], strict=True):
        if noise in task.settings.noises:
            heard = with_noise(noise, readings, bench.ring, generator)
            found[f"{noise}.echoes"] = np.isfinite(heard).sum(axis=1)
            for name, (distances, bearings) in bench.estimators.of(
                heard, noise, task.settings.estimators
            ).items():
                found[f"{noise}.{name}"] = distances
                if bearings is not None:
                    found[f"{noise}.{name}.bearing"] = bearings
    return found


class Bench:
    """What a worker builds once: robot, ring, distances, estimators.

    Args:
        name: Name or path of the robot file.
    """

    def __init__(self, name: str) -> None:
        self.robot = Robot.load(name)
        self.array = self.robot.sensor_arrays[0]
        self.ring = self.array.rings[0]
        self.estimators = Estimators(self.robot, self.array)
        self._T_link_ring = self.estimators.transform_ring_to_link
        self._link = LinkTruth(self.robot, self.array.link)
        self._distances = DistanceModel(self.robot)

    def balls(self, draws: Draws, arm_every: int) -> tuple[Arrays, Floats]:
        """Return the truth of ball scenes and the ideal readings, (n, sensors) [m]."""
        T = self._T_link_ring
        in_ring = ball_centres(draws, self.ring.radius)
        centres = in_ring @ T[:3, :3].T + T[:3, 3]
        distances, points = self._link.balls(centres, RADIUS_M)
        arm = np.full(len(centres), np.nan)
        if arm_every:
            for i in range(0, len(centres), arm_every):
                T_base_link = self.robot.link_transforms(draws.positions[i])[self.array.link]
                x, y, z = (T_base_link[:3, :3] @ centres[i] + T_base_link[:3, 3]).tolist()
                ball = Obstacle(id="ball", shape="sphere", size=(RADIUS_M,), position=(x, y, z))
                self._distances.set_obstacles([ball])
                arm[i] = self._nearest(draws.positions[i], None).distance
        T_sensors = self.ring.transform_sensors_to_ring
        from_sensors = np.einsum(
            "nsi,sij->nsj", in_ring[:, np.newaxis] - T_sensors[:, :3, 3], T_sensors[:, :3, :3]
        )
        readings = sphere_readings(from_sensors, RADIUS_M, self.ring.half_angle)
        readings = np.maximum(np.where(readings > self.ring.range_max, np.inf, readings), self.ring.range_min)
        truth = self._truth(distances, arm, (points - T[:3, 3]) @ T[:3, :3])
        return {"gap": draws.gap, "bearing": draws.bearing, "axial": draws.axial, **truth}, readings

    def bodies(self, shape: str, draws: Draws, arm_every: int) -> tuple[Arrays, Floats]:
        """Return the truth of scenes with other shapes and the ideal readings, (n, sensors) [m]."""
        count = len(draws.gap)
        ready = solids(shape, draws, self.ring.radius) if shape != "person" else []
        distances, arm, points = np.empty(count), np.full(count, np.nan), np.empty((count, 3))
        readings = np.empty((count, self.ring.count))
        for i, position in enumerate(draws.positions):
            T_base_ring = self.robot.link_transforms(position)[self.array.link] @ self._T_link_ring
            if ready:
                obstacles = [moved(ready[i], T_base_ring)]
            else:
                obstacles = reaching(draws, i, self._distances, self.array.link, T_base_ring[:3, 3])
            self._distances.set_obstacles(obstacles)
            pair = self._nearest(position, self.array.link)
            distances[i] = pair.distance
            points[i] = (pair.point_on_obstacle - T_base_ring[:3, 3]) @ T_base_ring[:3, :3]
            if arm_every:
                arm[i] = self._nearest(position, None).distance
            readings[i] = scan(
                obstacles,
                T_base_ring @ self.ring.transform_sensors_to_ring,
                self.ring.half_angle,
                self.ring.range_max,
                self.ring.range_min,
            )
        truth = self._truth(distances, arm, points)
        if shape == "person":
            place = {"gap": distances, "bearing": truth["towards"], "axial": points[:, 2]}
        else:
            place = {"gap": draws.gap, "bearing": draws.bearing, "axial": draws.axial}
        return {**place, **truth}, readings

    def _nearest(self, position: Floats, link: str | None) -> ClosestPair:
        pair = self._distances.nearest(position, link)
        if pair is None:
            raise SsmError("no obstacle was set")
        return pair

    @staticmethod
    def _truth(link: Floats, arm: Floats, points: Floats) -> Arrays:
        return {"link": link, "arm": arm, "towards": np.arctan2(points[:, 1], points[:, 0])}


def _bench(name: str) -> Bench:
    """Return this thread's own: Coal's and Pinocchio's working memory is not to be shared."""
    kept: dict[str, Bench] = _local.__dict__.setdefault("kept", {})
    if name not in kept:
        kept[name] = Bench(name)
    return kept[name]
