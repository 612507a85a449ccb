"""The figures of ``bench.kang2022``, after the paper's 9 to 14."""

from __future__ import annotations

import itertools
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from .kang2022_run import Run
from .kang2022_scene import FREE, PLANTS, Array, robot, scene
from .kang2022_table import CONVENTIONAL, IDEAL, PROPOSED, REAL, ZONES, limits, zone_of

Runs = Mapping[tuple[str, bool, str], Run]

_COLOURS = ("tab:green", "gold", "tab:red")
_JOINTS = ("tab:blue", "tab:orange", "tab:purple")
_LINKS = ("shoulder_link", "upper_arm_link", "forearm_link", "wrist_1_link")
_MARK_S, _FRAME_S = 4.0, 3.0


def draw_all(folder: Path, found: Runs) -> None:
    """Write all figures into ``folder``: joints, paths, frames and speeds by zone."""
    _joints(folder / "kang2022_joints.png", found)
    _paths(folder / "kang2022_paths.png", found)
    _frames(folder / "kang2022_frames.png", found)
    _speeds(folder / "kang2022_speeds.png", found)


def _figure(width: float, height: float) -> Any:
    from matplotlib.figure import Figure

    return Figure(figsize=(width, height), layout="constrained")


def _joints(path: Path, found: Runs) -> None:
    """Angles and speeds over time, the zones behind them (Fig. 9 c, 10 c, 11 c, 12 c)."""
    shown = _figure(11.0, 10.0)
    keys = [(FREE, True), PROPOSED, CONVENTIONAL]
    every = shown.subplots(len(keys), 2, squeeze=False)
    for i, key in enumerate(keys):
        for j, plant in enumerate(PLANTS):
            _joints_of(every[i, j], found[(*key, plant)])
    for axes in every[:2, 0]:
        axes.legend(loc="lower right", fontsize=7, ncols=2)
    shown.suptitle("Joint angles (solid) and speeds (dashed); zones by the ring's readings", fontsize=10)
    shown.savefig(path, dpi=130)


def _joints_of(axes: Any, run: Run) -> None:
    record = run.record
    _shade(axes, record.time, zone_of(record.sensed))
    beside = axes.twinx()
    for index, colour in enumerate(_JOINTS):
        axes.plot(record.time, record.joints[:, index], color=colour, label=f"angle {index + 1}")
        beside.plot(record.time, record.speeds[:, index], "--", color=colour, linewidth=0.8)
    seen = np.isfinite(record.sensed).nonzero()[0]
    if len(seen):
        axes.axvline(record.time[seen[0]], color="deeppink", linestyle=":", label="first echo")
    ended = "not reached" if run.arrived_s is None else f"{run.arrived_s:.2f} s"
    axes.set_title(f"{run.case.name}, {run.case.plant}: {ended}", fontsize=9)
    axes.set(xlabel="time [s]", ylabel="angle [rad]", xlim=(0.0, record.time[-1]))
    beside.set(ylabel="speed [rad/s]", ylim=(-0.8, 0.8))


def _shade(axes: Any, time: Array, zones: Array) -> None:
    edges = [0, *(np.diff(zones).nonzero()[0] + 1).tolist(), len(zones) - 1]
    for a, b in itertools.pairwise(edges):
        axes.axvspan(time[a], time[b], color=_COLOURS[zones[a]], alpha=0.15, linewidth=0)


def _paths(path: Path, found: Runs) -> None:
    """Paths of the end effector in space, from above and from the side (Fig. 9 d, 10 d, 13)."""
    shown = _figure(14.0, 8.0)
    lines = [
        ([(FREE, True)], "no obstacle"),
        ([PROPOSED, CONVENTIONAL], "with the ball"),
    ]
    for i, (keys, title) in enumerate(lines):
        space = shown.add_subplot(2, 3, 3 * i + 1, projection="3d")
        views = [shown.add_subplot(2, 3, 3 * i + 2 + j) for j in range(2)]
        for number, key in enumerate(keys):
            for plant in PLANTS:
                _path_of(space, views, found[(*key, plant)], number)
        if i:
            _ball(space, views)
        space.set_title(title, fontsize=9)
        space.set(xlabel="x [m]", ylabel="y [m]", xlim=(0.0, 0.45), zlim=(0.2, 0.65))
        for axes, name in zip(views, ("x", "z"), strict=True):
            middle = {"x": 0.2, "z": 0.45}[name]
            axes.set(xlabel="y [m]", ylabel=f"{name} [m]", aspect="equal")
            axes.set(xlim=(-0.34, 0.34), ylim=(middle - 0.2, middle + 0.2))
            axes.grid(alpha=0.3)
        views[0].legend(fontsize=7, loc="upper center")
    shown.savefig(path, dpi=130)


def _path_of(space: Any, views: Any, run: Run, number: int) -> None:
    record, real = run.record, run.case.plant == REAL
    style = {"color": f"C{2 * number + real}", "linestyle": "--" if real else "-", "linewidth": 1.4}
    x, y, z = record.place.T
    marks = [int(np.searchsorted(record.time, t)) for t in np.arange(0.0, record.time[-1], _MARK_S)]
    space.plot(x, y, z, **style)
    space.plot(x[marks], y[marks], z[marks], "o", color=style["color"], markersize=3)
    seen = np.isfinite(record.sensed).nonzero()[0]
    for axes, across in zip(views, (x, z), strict=True):
        axes.plot(y, across, label=f"{run.case.name}, {run.case.plant}", **style)
        axes.plot(y[marks], across[marks], "o", color=style["color"], markersize=3)
        axes.plot(y[seen[:1]], across[seen[:1]], "*", color=style["color"], markersize=9)


def _ball(space: Any, views: Any) -> None:
    from matplotlib.patches import Circle

    told = scene()
    (x, y, z), radius = told.ball_m, told.ball_radius_m
    u, v = np.meshgrid(np.linspace(0.0, 2.0 * np.pi, 24), np.linspace(0.0, np.pi, 12))
    space.plot_surface(
        x + radius * np.cos(u) * np.sin(v),
        y + radius * np.sin(u) * np.sin(v),
        z + radius * np.cos(v),
        color="0.6",
        alpha=0.7,
    )
    for axes, across in zip(views, (x, z), strict=False):
        axes.add_patch(Circle((y, across), radius, color="0.7"))


def _frames(path: Path, found: Runs) -> None:
    """The arm every three seconds, as the line through its joints (Fig. 9 b, 10 b)."""
    shown = _figure(12.0, 4.6)
    for index, key in enumerate([(FREE, True), PROPOSED, CONVENTIONAL]):
        run = found[(*key, IDEAL)]
        axes = shown.add_subplot(1, 3, index + 1, projection="3d")
        last = run.record.time[-1]
        for time_s in [*np.arange(0.0, last, _FRAME_S), last]:
            points = _arm(run.record.joints[int(np.searchsorted(run.record.time, time_s))])
            share = time_s / last
            axes.plot(*points.T, "-o", color=(share, 0.2, 1.0 - share), linewidth=2, markersize=3)
        axes.plot(*run.record.place.T, color="black", linewidth=1)
        if key[0] != FREE:
            _ball(axes, ())
        axes.set(xlabel="x [m]", ylabel="y [m]", zlabel="z [m]", title=run.case.name)
        axes.set(xlim=(-0.3, 0.3), ylim=(-0.3, 0.3), zlim=(0.0, 0.6))
        axes.view_init(elev=22.0, azim=20.0)
    shown.suptitle(f"The arm every {_FRAME_S:g} s, from blue to red", fontsize=10)
    shown.savefig(path, dpi=130)


def _arm(joints: Array) -> Array:
    """Return the joints' places, (5, 3) [m], base first."""
    arm = robot(IDEAL)
    position = arm.rest_position.copy()
    position[arm.free] = joints
    transforms = arm.link_transforms(position)
    return np.array([np.zeros(3), *(transforms[link][:3, 3] for link in _LINKS)])


def _speeds(path: Path, found: Runs) -> None:
    """Mean and greatest joint speed by zone (Fig. 14)."""
    shown = _figure(9.0, 4.2)
    edge = limits()
    for axes, plant in zip(shown.subplots(1, 2, sharey=True), PLANTS, strict=True):
        for offset, (key, colour) in enumerate(((CONVENTIONAL, "tab:blue"), (PROPOSED, "tab:red"))):
            record = found[(*key, plant)].record
            speeds, zones = np.abs(record.speeds), zone_of(record.sensed)
            for zone in (2, 1, 0):
                inside = speeds[zones == zone]
                if not len(inside):
                    continue
                place = (2 - zone) + 0.3 * (offset - 0.5)
                axes.bar(place, inside.mean(), 0.28, color=colour)
                axes.plot([place], [inside.max()], "v", color=colour, markeredgecolor="black")
        for zone in (1, 2):
            axes.hlines(edge[zone], 1.6 - zone, 2.4 - zone, color="black", linestyle="--")
        axes.set_xticks(range(3), [ZONES[2 - i] for i in range(3)])
        axes.set(title=plant, ylabel="joint speed [rad/s]")
    axes.plot([], [], "s", color="tab:blue", label="conventional, no speed limits")
    axes.plot([], [], "s", color="tab:red", label="3-D, SSM")
    axes.plot([], [], "kv", label="greatest")
    axes.plot([], [], "k--", label="the zone's limit")
    shown.legend(fontsize=8, loc="outside lower center", ncols=4)
    shown.savefig(path, dpi=130)
