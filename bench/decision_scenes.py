"""Robot files, postures and obstacles for ``bench.decision``, and what the slow decision sees of them."""

from __future__ import annotations

import math
import sys
from pathlib import Path
from typing import Any

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests" / "oracle"))

from slow_decision import SlowMonitor
from slow_geometry import SlowArm

_ROOT = Path(__file__).resolve().parents[1]

STOPPING = """
[stopping.shoulder_pan_joint]
speed_rad_s = 3.194
time_s = 0.159
distance_rad = 0.18
[[stopping.shoulder_pan_joint.slower]]
speed_rad_s = 0.5
time_s = 0.05
distance_rad = 0.012
[[stopping.shoulder_pan_joint.slower]]
speed_rad_s = 1.1
time_s = 0.09
distance_rad = 0.05
[stopping.shoulder_lift_joint]
speed_rad_s = 3.194
time_s = 0.154
distance_rad = 0.20
slower = [{ speed_rad_s = 0.7, time_s = 0.06, distance_rad = 0.03 }]
[stopping.elbow_joint]
speed_rad_s = 3.3
time_s = 0.092
distance_rad = 0.15
"""

SOURCES = """
[sources]
joints = {{ required = true, timeout_s = 0.1, integrity = "none" }}
ranges = {{ required = {ranges}, timeout_s = 0.4, integrity = "none" }}
obstacles = {{ required = {obstacles}, timeout_s = 0.25, period_s = 0.02, integrity = "none" }}
target = {{ required = false, timeout_s = 0.5, integrity = "none" }}
"""

STEPS = """red = { distance_m = 0.1775, joint_speed_rad_s = 0.18, speed_scaling = 0.25 }
yellow = { distance_m = 0.355, joint_speed_rad_s = 0.24, speed_scaling = 0.5 }
"""

ISO = """
human_speed_m_s = 0.25
human_speed_floor_m_s = 0.1
intrusion_m = 0.02
human_uncertainty_m = 0.03
robot_uncertainty_m = 0.01
red_scaling = 0.25
"""

PROFILES = (
    "[profiles.steps]\nuncovered = 'off'\nrecovery_ticks = 12\ndisagree_margin_m = 0.1\n" + STEPS,
    "[profiles.doubting]\nuncovered = 'yellow'\nrecovery_ticks = 5\ndisagree_margin_m = 0.05\n"
    "disagree_zone = 'stop'\n" + STEPS,
    "[profiles.iso]\nuncovered = 'off'\nrecovery_ticks = 8\n[profiles.iso.separation]" + ISO,
    "[profiles.tracked]\nuncovered = 'off'\nrecovery_ticks = 6\n"
    "[profiles.tracked.separation]\ntracked_velocity = true" + ISO,
    "[profiles.both]\nuncovered = 'red'\nrecovery_ticks = 10\ndisagree_margin_m = 0.2\n" + STEPS
    + "[profiles.both.separation]" + ISO,
)  # fmt: skip

VARIANTS = tuple(
    (required, profile)
    for profile in ("steps", "doubting", "iso", "tracked", "both")
    for required in ("ranges", "obstacles")
)
"""The source that is required beside the joints, and the profile."""


def write_robot(folder: Path, required: str) -> Path:
    """Write the UR3 with these profiles; ``required`` is the source of perception that must be there."""
    text = (_ROOT / "robots" / "ur3.toml").read_text(encoding="utf-8")
    top, _, rest = text.partition("[joints.locked]")
    body = "[joints.locked]" + rest.partition("[stopping]")[0].partition("# Category 0")[0]
    top = top.replace('default_profile = "kang2022"', 'default_profile = "steps"')
    sources = SOURCES.format(
        **{name: "true" if name == required else "false" for name in ("ranges", "obstacles")}
    )
    limits = "\n[limits]\nacceleration_rad_s2 = 4.0\nposition_margin_rad = 0.02\n"
    limits += "[reaction]\nrobot_s = 0.05\ntransport_s = 0.02\n"
    file = folder / f"{required}.toml"
    file.write_text("\n".join([top, body, STOPPING, limits, sources, *PROFILES]), encoding="utf-8")
    return file


class Scenes:
    """A few postures without own echoes, a few sets of obstacles, and what each pair of them looks like.

    Args:
        arm: The slow arm.
        seed: Of what is drawn.
        count: How many postures, and how many sets of obstacles.
    """

    def __init__(self, arm: SlowArm, seed: int, count: int) -> None:
        self.arm = arm
        rng = np.random.default_rng(seed)
        self.positions: list[list[float]] = []
        while len(self.positions) < count:
            position = [*rng.uniform([-3.0, -2.6, -1.6], [3.0, -0.4, 1.6]).tolist(), 0.0, 0.0, 0.0]
            if rng.random() < 0.3:  # close to the end of the first joint's travel
                position[0] = float(rng.choice([arm.lower[0] + 0.03, arm.upper[0] - 0.025]))
            if not arm.sees_itself(position):
                self.positions.append(position)
        self.obstacles = [self._set(rng, number) for number in range(count)]
        self._seen: dict[tuple[int, int | None], dict[str, Any]] = {}

    def _set(self, rng: np.random.Generator, number: int) -> list[dict[str, Any]]:
        found = []
        for index in range(int(rng.choice([0, 1, 1, 2, 3])) if number else 0):
            near = rng.uniform(0.35, rng.choice([0.8, 1.5, 2.5]))
            direction = rng.normal(size=3)
            direction[2] = abs(direction[2])
            place = near * direction / np.linalg.norm(direction) + [0.0, 0.0, 0.1]
            quaternion = rng.normal(size=4)
            ball = rng.random() < 0.6
            length = [] if ball else [float(rng.uniform(0.1, 0.4))]
            velocity = None if rng.random() < 0.3 else rng.normal(scale=0.3, size=3).tolist()
            found.append(
                {
                    "id": f"o{index}",
                    "shape": "sphere" if ball else "capsule",
                    "size": [float(rng.uniform(0.05, 0.12)), *length],
                    "position": place.tolist(),
                    "quaternion_xyzw": (quaternion / np.linalg.norm(quaternion)).tolist(),
                    "velocity": velocity,
                }
            )
        return found

    def of(self, position: int, obstacles: int | None) -> dict[str, Any]:
        """Return what a posture looks like among a set of obstacles; ``None``: without any."""
        key = position, obstacles
        if key not in self._seen:
            q = self.positions[position]
            if obstacles is None:
                sensors = [{"link": s["link"], "ring": s["ring"]} for s in self.arm.sensors(q)]
                self._seen[key] = {
                    "pairs": [],
                    "sensors": sensors,
                    "echoes": [self.arm.echo(q, index) for index in range(len(sensors))],
                    "corners": {link: self.arm.corners(q, link) for link in {s["link"] for s in sensors}},
                }
            else:
                pairs = self.arm.pairs(q, self.obstacles[obstacles])
                self._seen[key] = {**self.of(position, None), "pairs": pairs}
        return self._seen[key]


def slow_monitor(arm: SlowArm, profile: str, period_s: float) -> SlowMonitor:
    """Return the slow implementation of one profile."""
    return SlowMonitor(arm.file, arm.names, arm.free, arm.fastest, arm.lower, arm.upper, profile, period_s)


def near_an_edge(decision: dict[str, Any], slow: SlowMonitor) -> bool:
    """Tell whether a decision is so near to an edge that two exact distances may fall on either side."""
    if any(abs(pair["spare"]) < 1e-4 for pair in decision["pairs"]):
        return True
    if slow.separation is not None:
        ratio = min([pair["ratio"] for pair in decision["pairs"]], default=math.inf)
        if abs(ratio - 1.0) < 1e-3 or abs(ratio - slow.separation["red_scaling"]) < 1e-3:
            return True
    edges = [slow.profile[name]["distance_m"] for name in ("red", "yellow") if name in slow.profile]
    # A reading at an edge is exactly there: only what is tracked is measured twice.
    return any(abs(decision["tracked"] - edge) < 2e-5 for edge in [*edges, 0.0])
