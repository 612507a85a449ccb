"""The figures of [Neri2023] as we find them: joint angles, speeds and errors, and frames of the motion."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from ssm_service.motion import link_segments

from .neri2023_run import CASES, LOG_S, Piece, Track, robot, scenario

MODES = {1: "I", 2: "II", 3: "III"}
FRAMES_S = (0.0, 2.0, 3.0, 5.0)
"""When the paper shows its frames."""

VIEW_Y = (-0.62, 0.62)
VIEW_Z = (0.85, 1.95)
FRAME_INCHES = 3.4


def draw(path: Path, tracks: Mapping[Piece, Track]) -> None:
    """Draw joints over time into ``path``, and the frames beside it."""
    draw_joints(path, tracks)
    draw_frames(path.with_name(f"{path.stem}-frames.png"), tracks)


def draw_joints(path: Path, tracks: Mapping[Piece, Track]) -> None:
    """Draw angles, speeds and errors, ideal and real, one line of axes for each case and mode.

    Case 1 is the same in all modes and drawn once.
    """
    from matplotlib.figure import Figure
    from matplotlib.lines import Line2D

    shown = [(c, m) for c in CASES for m in MODES if Piece(case=c, mode=m, loop="real") in tracks]
    shown = [(c, m) for c, m in shown if c > 1 or m == 1]
    figure = Figure(figsize=(14.0, 2.5 * len(shown) + 0.8), layout="constrained")
    grid = figure.subplots(len(shown), 3, squeeze=False, sharex=True)
    colours = [f"C{joint}" for joint in range(6)]
    for (case, mode), axes in zip(shown, grid, strict=True):
        ideal, real = (tracks[Piece(case=case, mode=mode, loop=loop)] for loop in ("ideal", "real"))
        for joint, colour in enumerate(colours):
            for track, style in ((ideal, "-"), (real, "--")):
                axes[0].plot(track.time, track.joints[:, joint], style, color=colour, linewidth=1.0)
                axes[1].plot(track.time, track.speeds[:, joint], style, color=colour, linewidth=1.0)
            error = np.abs(ideal.joints - real.joints)[:, joint]
            axes[2].plot(ideal.time, error, color=colour, linewidth=1.0)
        axes[0].set_ylabel(f"case {case}, mode {MODES[mode]}\nangle [rad]")
        axes[1].set_ylabel("speed [rad/s]")
        axes[2].set_ylabel("|ideal − real| [rad]")
        for one in axes:
            one.axvline(scenario().deadline_s, color="0.7", linewidth=0.8)
    for one in grid[-1]:
        one.set_xlabel("time [s]")
    handles = [
        *(Line2D([], [], color=colour, label=f"joint {joint + 1}") for joint, colour in enumerate(colours)),
        Line2D([], [], color="0.3", label="ideal"),
        Line2D([], [], color="0.3", linestyle="--", label="real"),
    ]
    figure.legend(handles=handles, loc="outside upper center", ncols=8)
    figure.savefig(path, dpi=120)


def draw_frames(path: Path, tracks: Mapping[Piece, Track]) -> None:
    """Draw the real arm in mode I from the front (y to the right, z up), with its way so far."""
    from matplotlib.figure import Figure

    cases = [case for case in CASES if Piece(case=case, mode=1, loop="real") in tracks]
    high = FRAME_INCHES * (VIEW_Z[1] - VIEW_Z[0]) / (VIEW_Y[1] - VIEW_Y[0])
    figure = Figure(
        figsize=(len(FRAMES_S) * (FRAME_INCHES + 0.3), len(cases) * (high + 0.4)), layout="constrained"
    )
    grid = figure.subplots(len(cases), len(FRAMES_S), squeeze=False, sharex=True, sharey=True)
    for case, line in zip(cases, grid, strict=True):
        track = tracks[Piece(case=case, mode=1, loop="real")]
        for time_s, axes in zip(FRAMES_S, line, strict=True):
            index = min(round(time_s / LOG_S), len(track.time) - 1)
            _draw_arm(axes, track.joints[index])
            _draw_scene(axes, case, track, index)
            axes.set_title(f"case {case}, mode I, t = {time_s:g} s", fontsize=9)
    for axes in grid[-1]:
        axes.set_xlabel("y [m]")
    for line in grid:
        line[0].set_ylabel("z [m]")
    figure.savefig(path, dpi=120)


def _draw_arm(axes: Any, joints: Any) -> None:
    """Draw each shape's axis, as thick as the shape."""
    arm = robot()
    segments, poses = link_segments(arm), arm.link_transforms(joints)
    points_per_metre = 72.0 * FRAME_INCHES / (VIEW_Y[1] - VIEW_Y[0])
    for link, proximal, distal, radius in zip(
        segments.links, segments.proximal, segments.distal, segments.radius, strict=True
    ):
        ends = np.array([poses[link][:3] @ [*end, 1.0] for end in (proximal, distal)])
        axes.plot(
            ends[:, 1],
            ends[:, 2],
            color="0.35" if link == "tool" else "0.65",
            linewidth=2.0 * radius * points_per_metre * 0.9,
            solid_capstyle="butt" if link in {"tool", "base_link", "wrist_3_link"} else "round",
        )


def _draw_scene(axes: Any, case: int, track: Track, index: int) -> None:
    """Draw the plan, the way of the tool's end so far, and the sphere with the radius of influence."""
    from matplotlib.patches import Circle

    if case != 3:
        ends = np.array([scenario().line.start_m, scenario().line.goal_m])
        axes.plot(ends[:, 1], ends[:, 2], color="C0", linewidth=0.8, linestyle=":")
    axes.plot(track.place[: index + 1, 1], track.place[: index + 1, 2], color="C0", linewidth=1.2)
    if np.isfinite(track.centre[index]).all():
        centre = (float(track.centre[index, 1]), float(track.centre[index, 2]))
        axes.add_patch(Circle(centre, scenario().sphere.radius_m, color="C3"))
        radius = scenario().table1["radius_min_m"]
        axes.add_patch(Circle(centre, radius, fill=False, color="C3", linewidth=0.6, linestyle="--"))
    axes.set_xlim(*VIEW_Y)
    axes.set_ylim(*VIEW_Z)
    axes.set_aspect("equal")
