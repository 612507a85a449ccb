"""From readings to estimates: the reading model, the simulated sensors' errors, the estimators."""

from .estimators import Estimate, RingEstimates, estimate
from .noise import SimulatedSensorModel
from .reading import cone_reading, scan, sphere_readings

__all__ = [
    "Estimate",
    "RingEstimates",
    "SimulatedSensorModel",
    "cone_reading",
    "estimate",
    "scan",
    "sphere_readings",
]
