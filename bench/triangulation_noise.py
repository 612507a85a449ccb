"""How the readings of the benchmark err: not at all, by rounding, within the maker's accuracy, by silence."""

from __future__ import annotations

import math

import numpy as np

from ssm_service.config import SimulatedSensorConfig
from ssm_service.model import Ring
from ssm_service.perception import SimulatedSensorModel

from .triangulation_scenes import Floats

NOISES = {
    "none": "ideal readings",
    "1 mm": "rounded to 1 mm",
    "±6 cm": "uniform within ± the maker's accuracy, 6 cm",
    "drop-outs": "each echo lost with 10 %, else ideal",
}
ROUNDING_M, DROPPED = 0.001, 0.1

_MODELS = {
    "1 mm": SimulatedSensorConfig(resolution_m=ROUNDING_M),
    "drop-outs": SimulatedSensorConfig(dropout_probability=DROPPED),
}


def greatest_error(noise: str, accuracy: float) -> float:
    """Return how far an echo may be from the truth [m], for a device of ``accuracy`` [m]."""
    return {"none": 0.0, "1 mm": 0.5 * ROUNDING_M, "±6 cm": accuracy, "drop-outs": 0.0}[noise]


def with_noise(noise: str, readings: Floats, ring: Ring, rng: np.random.Generator) -> Floats:
    """Return readings that err, (n, sensors) [m].

    Args:
        noise: Of ``NOISES``.
        readings: Ideal, (n, sensors) [m], ``inf`` for no echo.
        ring: Says range and accuracy.
        rng: Used for this alone.
    """
    if noise == "none":
        return readings
    if noise == "±6 cm":
        erring = readings + rng.uniform(-ring.accuracy, ring.accuracy, readings.shape)
        erring = np.where(erring > ring.range_max, math.inf, erring)
        clamped: Floats = np.maximum(erring, ring.range_min)
        return clamped
    model = SimulatedSensorModel(config=_MODELS[noise], range_max=ring.range_max)
    return np.maximum(model.apply(readings.ravel(), rng).reshape(readings.shape), ring.range_min)
