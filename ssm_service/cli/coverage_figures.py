"""The folder of ``ssm coverage``: its numbers, and three figures for each link."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from ..errors import ConfigError
from .figures import DPI, STYLE, WIDTH_IN, prepare
from .palette import LINES

if TYPE_CHECKING:
    from ..model import Robot
    from ..perception.coverage import LinkCoverage, SurfaceMap

NUMBERS: Final = "coverage.json"
SEEN: Final = ("#d1340b", "#f0c808", "#7fc8a9", "#00805f")
"""Colours of places that are seen by no, one, two, more sensors."""


def write_report(
    folder: Path, robot: Robot, covered: Sequence[LinkCoverage], report: dict[str, Any], distance: float
) -> list[str]:
    """Write numbers and figures; return the figures' names.

    Raises:
        ConfigError: The folder cannot be made or written to.
    """
    import msgspec

    names = [f"{kind}-{item.link.name}.png" for item in covered for kind in ("polar", "surface", "unseen")]
    try:
        folder.mkdir(parents=True, exist_ok=True)
        (folder / NUMBERS).unlink(missing_ok=True)  # a rerun that fails must not look like the run before it
        _figures(folder, robot, covered, distance)
        data = msgspec.json.format(msgspec.json.encode({**report, "figures": names}), indent=2)
        (folder / NUMBERS).write_bytes(data + b"\n")
    except OSError as error:
        allowed = f"a folder to write to ({error.strerror})"
        raise ConfigError("--out", "", str(folder), allowed) from error
    return names


def _figures(folder: Path, robot: Robot, covered: Sequence[LinkCoverage], distance: float) -> None:
    prepare()
    import matplotlib.pyplot as plt

    from ..perception.coverage import surface_map

    with plt.style.context(["default", STYLE]):
        for item in covered:
            surface = surface_map(item.link, item.clear.radius, distance)
            drawings: dict[str, Callable[[], Any]] = {
                "polar": lambda item=item: _polar(robot, item, distance),  # type: ignore[misc]
                "surface": lambda item=item, surface=surface: _surface(item, surface, distance),  # type: ignore[misc]
                "unseen": lambda item=item, surface=surface: _unseen(item, surface),  # type: ignore[misc]
            }
            for kind, drawing in drawings.items():
                figure = drawing()
                figure.savefig(folder / f"{kind}-{item.link.name}.png", dpi=DPI)
                plt.close(figure)


def _polar(robot: Robot, item: LinkCoverage, distance: float) -> Any:
    import matplotlib.pyplot as plt
    from matplotlib.colors import ListedColormap
    from matplotlib.patches import Patch

    from ..perception.coverage import main_ring, polar_map

    array = next(array for array in robot.sensor_arrays if array.link == item.link.name)
    ring, transform = main_ring(array)
    seen = polar_map(item.link, ring, transform, item.clear.radius, max(distance, 0.5))
    figure = plt.figure(figsize=(WIDTH_IN, 7.0))
    axes: Any = figure.add_subplot(projection="polar")
    counts = np.minimum(seen.counts, 3)
    axes.pcolormesh(
        seen.bearings, seen.gaps, counts, cmap=ListedColormap(SEEN), vmin=-0.5, vmax=3.5, rasterized=True
    )
    axes.plot(seen.bearings, np.full(len(seen.bearings), distance), color="#222222", linewidth=1.0)
    axes.set_rorigin(-(ring.radius + item.clear.radius))
    axes.set_title(
        f"{item.link.name}: who sees balls of {1e3 * item.clear.radius:g} mm in the plane of ring {ring.name}"
    )
    axes.set_rlabel_position(90.0)
    words = "unseen", "seen by one sensor", "by two", "by more"
    handles = [Patch(facecolor=colour, label=word) for colour, word in zip(SEEN, words, strict=True)]
    axes.legend(handles=handles, loc="upper left", bbox_to_anchor=(1.05, 1.0))
    axes.set_xlabel(f"bearing from sensor 1, gap from the ring [m]; the line is at {distance:g} m")
    return figure


def _surface(item: LinkCoverage, surface: SurfaceMap, distance: float) -> Any:
    import matplotlib.pyplot as plt
    from matplotlib.colors import ListedColormap

    figure, axes = plt.subplots(figsize=(WIDTH_IN, 5.4))
    rows = np.arange(len(surface.places))
    bearings = np.degrees(surface.bearings)
    shown = np.where(np.isfinite(surface.gaps), surface.gaps, distance)
    colours = plt.get_cmap("inferno_r")(np.linspace(0.85, 0.1, 256))
    image = axes.pcolormesh(
        bearings,
        rows,
        shown,
        cmap=ListedColormap(colours[::-1][::-1]),
        vmin=0.0,
        vmax=distance,
        rasterized=True,
    )
    bar = figure.colorbar(image, ax=axes)
    bar.set_label(f"least gap of an unseen ball [m]; {distance:g}: none")
    _place_ticks(axes.yaxis, surface)
    axes.set(xlabel="bearing about the link's long axis [°]", xticks=range(0, 361, 45))
    axes.set_title(
        f"{item.link.name}, unrolled: how near a ball of {1e3 * item.clear.radius:g} mm comes unseen"
    )
    return figure


def _unseen(item: LinkCoverage, surface: SurfaceMap) -> Any:
    import matplotlib.pyplot as plt

    figure, axes = plt.subplots(figsize=(WIDTH_IN, 4.4))
    rows = np.arange(len(surface.places))
    worst = 1e3 * surface.largest.max(axis=1)
    axes.plot(rows, worst, color=LINES[1], linewidth=2.0, label="worst bearing")
    axes.plot(
        rows, 1e3 * np.median(surface.largest, axis=1), color=LINES[0], linewidth=1.4, label="median bearing"
    )
    radius = 1e3 * item.clear.radius
    axes.axhline(radius, color="#333333", linewidth=0.8, linestyle=(0, (4, 3)))
    axes.annotate(f"{radius:g} mm", (1.0, radius), xycoords=("axes fraction", "data"), xytext=(4, 0),
                  textcoords="offset points", va="center", fontsize=9)  # fmt: skip
    axes.set_ylim(0.0, 1.3 * max(float(worst.max()), radius))
    axes.set_xlim(0, len(rows) - 1)
    _place_ticks(axes.xaxis, surface)
    axes.set(ylabel="radius [mm]")
    axes.set_title(f"{item.link.name}: largest ball that touches it unseen; a larger one cannot")
    axes.grid(axis="y", color="#e3e3e3", linewidth=0.8)
    axes.legend(loc="upper right", ncols=2)
    return figure


def _place_ticks(axis: Any, surface: SurfaceMap) -> None:
    """Label the map's rows: the ends as half spheres by elevation, between them places along the link."""
    side = np.flatnonzero(surface.elevations == 0.0)
    first, last = int(side[0]), int(side[-1])
    ticks, labels = [0, first // 2], ["end", "−45°"]
    for row in np.linspace(first, last, 5).round().astype(int).tolist():
        ticks.append(row)
        labels.append(f"{surface.places[row]:.2f} m")
    end = len(surface.places) - 1
    ticks += [last + (end - last) // 2, end]
    labels += ["45°", "end"]
    axis.set_ticks(ticks, labels=labels)
    axis.set_label_text("along the link's long axis; its ends as half spheres, by elevation")
