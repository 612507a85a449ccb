"""From readings to estimates: the reading model, the simulated sensors' errors, the estimators."""

from .batch import ArrayScan
from .bound import Bound, LowerBound
from .estimators import Estimate, RingEstimates, estimate
from .fit import Fit, FitWeights, SphereFit
from .noise import SimulatedSensorModel
from .own_links import OwnEchoes, OwnLinks
from .reading import cone_reading, scan, sphere_readings

__all__ = [
    "ArrayScan",
    "Bound",
    "Estimate",
    "Fit",
    "FitWeights",
    "LowerBound",
    "OwnEchoes",
    "OwnLinks",
    "RingEstimates",
    "SimulatedSensorModel",
    "SphereFit",
    "cone_reading",
    "estimate",
    "scan",
    "sphere_readings",
]
