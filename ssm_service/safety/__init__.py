"""From distances and ages to zones: what is unknown is never clear."""

from .machine import ZoneMachine
from .separation import WALKING_SPEED_M_S, SeparationLaw, SeparationTerms
from .sources import SourceState, SourceStatus, classify, forces_stop
from .zones import Zone, ZoneProfile

__all__ = [
    "WALKING_SPEED_M_S",
    "SeparationLaw",
    "SeparationTerms",
    "SourceState",
    "SourceStatus",
    "Zone",
    "ZoneMachine",
    "ZoneProfile",
    "classify",
    "forces_stop",
]
