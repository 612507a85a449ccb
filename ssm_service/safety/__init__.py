"""From distances and ages to zones: what is unknown is never clear."""

from .machine import ZoneMachine
from .sources import SourceState, SourceStatus, classify, forces_stop
from .zones import Zone, ZoneProfile

__all__ = ["SourceState", "SourceStatus", "Zone", "ZoneMachine", "ZoneProfile", "classify", "forces_stop"]
