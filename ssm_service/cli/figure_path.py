"""The end effector's path in space, with the arm and what moved round it."""

from __future__ import annotations

from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from ..model import Robot
from ..safety import Zone
from ..wire.messages import ObstacleEntry
from .figure_shapes import draw_shape
from .palette import LINES
from .recording import JointRow, Recording

INK: Final = {Zone.GREEN: "#009e73", Zone.YELLOW: "#d9a900", Zone.RED: "#d1340b", Zone.STOP: "#6a1b6e"}
"""Colours of the path, darker than the bands so that they stand on white."""

STEP_S: Final = 0.04
"""Distance in time of the path's points [s]."""

MARGIN_M: Final = 0.12
"""What is shown round the arm and the obstacles beside it [m]."""

BESIDE_M: Final = 0.45
"""An obstacle whose centre is farther from the arm's surroundings than this is left out [m]."""


def draw_path(recording: Recording, robot: Robot) -> Any:
    """Return a figure with the path coloured by zone; arm and obstacles where they were nearest."""
    import matplotlib.pyplot as plt

    figure = plt.figure(figsize=(9.6, 7.0), layout="none")
    axes = figure.add_axes((-0.02, -0.03, 0.86, 1.02), projection="3d")
    handles: list[Any] = []
    moment = _nearest_moment(recording)
    if recording.joints:
        handles += _draw_end_effector(axes, recording, robot)
        row = _at(recording.joints, moment)
        arm = _skeleton(robot, row.position)
        axes.plot(*arm.T, "-o", color="#666666", linewidth=4.0, markersize=6, alpha=0.75, zorder=2)
        handles.append(_line("#666666", f"arm at {moment:.1f} s", marker="o"))
        _show_around(axes, recording, robot, moment)
    handles += _draw_obstacles(axes, recording, moment)
    axes.set(xlabel="x [m]", ylabel="y [m]", zlabel="z [m]")
    axes.view_init(elev=22.0, azim=-38.0)
    for axis in (axes.xaxis, axes.yaxis, axes.zaxis):
        axis.set_pane_color((0.97, 0.97, 0.97, 1.0))
        axis.set_major_locator(plt.MaxNLocator(5))
    figure.text(0.02, 0.955, "Path of the end effector in the base frame", fontsize=12, fontweight="bold")
    near = any(row.exact is not None for row in recording.decisions)
    words = "arm and obstacles when they were nearest" if near else "arm at the end; no obstacle was tracked"
    figure.text(0.02, 0.925, f"{words}, at {moment:.1f} s" if near else words, color="#555555")
    figure.legend(handles=handles, loc="upper right", bbox_to_anchor=(0.99, 0.97))
    return figure


def _nearest_moment(recording: Recording) -> float:
    """Return when the exact distance was least [s]; the end where there was none."""
    seen = [(row.exact, row.t) for row in recording.decisions if row.exact is not None]
    return min(seen)[1] if seen else recording.seconds


def _at(rows: list[JointRow], moment: float) -> JointRow:
    return min(rows, key=lambda row: abs(row.t - moment))


def _draw_end_effector(axes: Any, recording: Recording, robot: Robot) -> list[Any]:
    from mpl_toolkits.mplot3d.art3d import Line3DCollection

    times, path = _end_effector(recording, robot)
    zones = _zones_at(recording, times)
    handles = []
    for zone in sorted(set(zones)):
        pieces = [path[i : i + 2] for i in range(len(path) - 1) if zones[i] is zone]
        if pieces:
            axes.add_collection3d(Line3DCollection(pieces, colors=INK[zone], linewidths=2.8, zorder=5))
            handles.append(_line(INK[zone], f"end effector, {zone.word}", linewidth=2.8))
    return handles


def _end_effector(recording: Recording, robot: Robot) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return times (k,) [s] and positions (k, 3) [m], base frame."""
    times: list[float] = []
    path = []
    for row in recording.joints:
        if not times or row.t - times[-1] >= STEP_S:
            times.append(row.t)
            path.append(robot.kinematics(row.position).transform_end_effector_to_base[:3, 3])
    return np.array(times), np.array(path)


def _zones_at(recording: Recording, times: NDArray[np.float64]) -> list[Zone]:
    arrivals = np.array([row.t for row in recording.decisions])
    places = np.clip(np.searchsorted(arrivals, times, side="right") - 1, 0, None)
    return [recording.decisions[place].zone for place in places]


def _skeleton(robot: Robot, position: tuple[float, ...]) -> NDArray[np.float64]:
    """Return the origins of the links, from the base on, (k, 3) [m]."""
    points = [transform[:3, 3] for transform in robot.link_transforms(position).values()]
    distinct = [points[0]]
    for point in points[1:]:
        if np.linalg.norm(point - distinct[-1]) > 1e-6:
            distinct.append(point)
    return np.array(distinct)


def _show_around(axes: Any, recording: Recording, robot: Robot, moment: float) -> None:
    """Fit the axes to where the arm was and to the obstacles that were beside it, with a margin."""
    rows = recording.joints[:: max(len(recording.joints) // 20, 1)]
    points = np.concatenate([_skeleton(robot, row.position) for row in rows])
    lower, upper = points.min(axis=0), points.max(axis=0)
    for entry in _obstacles_at(recording, moment):
        centre = np.array(entry.position)
        if (np.maximum(lower - centre, centre - upper) < BESIDE_M).all():
            points = np.concatenate([points, centre[None]])
    lower, upper = points.min(axis=0) - MARGIN_M, points.max(axis=0) + MARGIN_M
    axes.set(xlim=(lower[0], upper[0]), ylim=(lower[1], upper[1]), zlim=(max(lower[2], -0.05), upper[2]))
    limits = np.array([axes.get_xlim(), axes.get_ylim(), axes.get_zlim()])
    axes.set_box_aspect(np.ptp(limits, axis=1), zoom=0.9)


def _draw_obstacles(axes: Any, recording: Recording, moment: float) -> list[Any]:
    """Draw tracks and, at one moment, the shapes; what lies outside the axes is left out."""
    limits = np.array([axes.get_xlim(), axes.get_ylim(), axes.get_zlim()])
    tracks: dict[str, list[tuple[float, ...]]] = {}
    for row in recording.obstacles:
        for entry in row.obstacles:
            tracks.setdefault(entry.id, []).append(entry.position)
    colours = dict(zip(tracks, LINES * (1 + len(tracks) // len(LINES)), strict=False))
    handles = []
    for name, track in tracks.items():
        points = np.array(track)
        outside = ((points < limits[:, 0]) | (points > limits[:, 1])).any(axis=1)
        points[outside] = np.nan
        if not outside.all():
            axes.plot(*points.T, color=colours[name], linewidth=1.4, linestyle=":", zorder=3)
            handles.append(_line(colours[name], name, linestyle=":", marker="o", markersize=7, alpha=0.7))
    for entry in _obstacles_at(recording, moment):
        if ((entry.position >= limits[:, 0]) & (entry.position <= limits[:, 1])).all():
            draw_shape(axes, entry, colours[entry.id])
    return handles


def _obstacles_at(recording: Recording, moment: float) -> tuple[ObstacleEntry, ...]:
    nearest = min(recording.obstacles, key=lambda row: abs(row.t - moment), default=None)
    return () if nearest is None else nearest.obstacles


def _line(colour: str, label: str, **style: Any) -> Any:
    from matplotlib.lines import Line2D

    return Line2D([], [], color=colour, label=label, **style)
