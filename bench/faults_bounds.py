"""How long a fault may last before the consumer stops, computed from the configuration."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from ssm_service.config import load_robot_config
from ssm_service.monitor import default_valid_for

POLL_S = 0.002
"""From one look of the consumer at its channels to the next, at most [s]."""

SWING_RAD_S = 0.1
"""How fast the arm is commanded to and fro [rad/s]."""

FORMULAS = """\
Bounds, with T = `reaction.transport_s` (a way through the chaos process and one hop, either direction), V = \
`valid_for`, P = the period, τ = the source's `timeout_s`, p = 2 ms between two looks of the consumer:
'refused' (a message that must not be believed took the place of a good one): 2T + 2V + p. The last tick \
that cannot know it begins within T; it is published within V of its beginning, or as a stop; it arrives \
within T and holds for V.
'stale' (nothing good comes in): τ + T + 2V + p. The age counts from before the last good arrival; the \
last tick below τ is published within V, arrives within T and holds for V.
'watchdog' (nothing good comes out): T + V + p. What was on its way arrives within T and holds for V.
'frozen': one period of the ring more than `frozen_scans`, then as 'refused'.
'implausible', for joints that do not follow, with W = `follow_window_s`, L = `follow_delay_s`, \
δ = `joint_tolerance_rad`, u = 0.1 rad/s commanded to and fro: 3W/2 + 2L + 3(δ/u + τ)/2, then as 'refused'. \
W + L until enough is known, and, where the arm has just turned, L + W/2 until every window is past the turn.
'paused' (the consumer itself stood still): T + p, T for the system to let it run again. What it held has \
expired, and is proved anew before anything else is held.
'starved' (nobody runs): the length of the starvation, then as 'refused', T of it for the system to let \
the consumer run again.\
"""


@dataclass(frozen=True, slots=True, kw_only=True)
class Bounds:
    """Bounds in ms.

    Attributes:
        transport_s: T.
        valid_for_s: V.
        timeout_s: τ, by source.
        ring_period_s: Of the slowest ring.
        frozen_scans: As configured; likewise the others.
        window_s: W.
        delay_s: L.
        tolerance_rad: δ.
    """

    transport_s: float
    valid_for_s: float
    timeout_s: dict[str, float]
    ring_period_s: float
    frozen_scans: int
    window_s: float
    delay_s: float
    tolerance_rad: float

    @classmethod
    def of(cls, robot: Path, rate_hz: float) -> Bounds:
        """Return the bounds of a robot file at a rate."""
        file = load_robot_config(robot).file
        names = ("joints", "ranges", "obstacles", "target")
        return cls(
            transport_s=file.reaction.transport_s,
            valid_for_s=default_valid_for(1.0 / rate_hz),
            ring_period_s=max(ring.period_s for ring in file.rings),
            frozen_scans=file.plausibility.frozen_scans or 0,
            window_s=file.plausibility.follow_window_s or 0.0,
            delay_s=file.plausibility.follow_delay_s,
            tolerance_rad=file.plausibility.joint_tolerance_rad,
            timeout_s={name: getattr(file.sources, name).timeout_s for name in names},
        )

    def refused_ms(self) -> float:
        """See ``FORMULAS``."""
        return 1e3 * (2 * self.transport_s + 2 * self.valid_for_s + POLL_S)

    def stale_ms(self, source: str) -> float:
        """See ``FORMULAS``."""
        return 1e3 * (self.timeout_s[source] + self.transport_s + 2 * self.valid_for_s + POLL_S)

    def watchdog_ms(self) -> float:
        """See ``FORMULAS``."""
        return 1e3 * (self.transport_s + self.valid_for_s + POLL_S)

    def frozen_ms(self) -> float:
        """See ``FORMULAS``."""
        return 1e3 * (self.frozen_scans + 1) * self.ring_period_s + self.refused_ms()

    def implausible_ms(self) -> float:
        """See ``FORMULAS``."""
        slack_s = self.tolerance_rad / SWING_RAD_S + self.timeout_s["joints"]
        seconds = 1.5 * self.window_s + 2.0 * self.delay_s + 1.5 * slack_s
        return 1e3 * seconds + self.refused_ms()

    def paused_ms(self) -> float:
        """See ``FORMULAS``."""
        return 1e3 * (self.transport_s + POLL_S)

    def starved_ms(self, seconds: float) -> float:
        """See ``FORMULAS``."""
        return 1e3 * seconds + self.refused_ms()
