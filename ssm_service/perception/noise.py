"""How simulated sensors err: bias, noise, resolution and lost echoes, seeded and off by default."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..config import SimulatedSensorConfig
from ..errors import InputError
from ..model.rings import Ring


@dataclass(frozen=True, slots=True, kw_only=True)
class SimulatedSensorModel:
    """Turns ideal readings into those of a device that errs. Latency is the simulation's business.

    Attributes:
        config: The errors.
        range_max: Greatest distance that the device reports [m].
    """

    config: SimulatedSensorConfig
    range_max: float

    def __post_init__(self) -> None:
        if not 0.0 < self.range_max < math.inf:
            raise InputError("out_of_range", "range_max", self.range_max, "above 0 and finite")

    @classmethod
    def of_ring(cls, ring: Ring) -> SimulatedSensorModel:
        """Return the errors that the robot file gives to ``ring``'s simulated sensors."""
        return cls(config=ring.simulated, range_max=ring.range_max)

    def apply(self, ranges: NDArray[np.float64], generator: np.random.Generator) -> NDArray[np.float64]:
        """Return one scan with errors, (m,) [m], ``inf`` for no echo; ``ranges`` is left as it is.

        In this order: bias and noise; no echo beyond ``range_max``; rounding to the resolution; clamping to
        [0, ``range_max``]; drop-out. Silence stays silence: an error never makes an echo. The
        generator advances by the same amount at every call, whatever the settings and the readings, so that
        two runs with one seed differ in nothing but what was changed.

        Args:
            ranges: (m,) ideal readings [m], ``inf`` for no echo.
            generator: Source of randomness, owned by the caller.

        Raises:
            InputError: ``wrong_length``, ``not_finite`` (NaN) or ``out_of_range`` (negative) readings.
        """
        ideal = _checked(ranges)
        noise = generator.standard_normal(len(ideal))
        chance = generator.random(len(ideal))
        config = self.config
        erring = ideal + (config.bias_m + config.noise_std_m * noise)
        silent = (erring > self.range_max) | (chance < config.dropout_probability)
        if config.resolution_m > 0.0:
            erring = np.round(erring / config.resolution_m) * config.resolution_m
        return np.where(silent, math.inf, np.clip(erring, 0.0, self.range_max))


def _checked(ranges: NDArray[np.float64]) -> NDArray[np.float64]:
    ranges = np.asarray(ranges, dtype=np.float64)
    if ranges.ndim != 1:
        raise InputError("wrong_length", "ranges", ranges.shape, "one reading per sensor")
    if np.isnan(ranges).any():
        raise InputError("not_finite", "ranges", ranges.tolist(), "numbers, or inf for no echo")
    if (ranges < 0.0).any():
        raise InputError("out_of_range", "ranges", ranges.tolist(), "0 or more, or inf for no echo")
    return ranges
