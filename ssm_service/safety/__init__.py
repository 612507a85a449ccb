"""From distances and ages to zones: what is unknown is never clear."""

from .closing import Closing
from .held import Least, LeastHeld
from .machine import ZoneMachine
from .reaction import ReactionTime
from .separation import WALKING_SPEED_M_S, SeparationLaw, SeparationTerms
from .sources import SourceState, SourceStatus, classify, forces_stop
from .speeds import admissible_shares, greatest_scaling, level_speeds, max_closing_speeds, zone_of
from .stopping import StoppingLevels
from .zones import Zone, ZoneProfile

__all__ = [
    "WALKING_SPEED_M_S",
    "Closing",
    "Least",
    "LeastHeld",
    "ReactionTime",
    "SeparationLaw",
    "SeparationTerms",
    "SourceState",
    "SourceStatus",
    "StoppingLevels",
    "Zone",
    "ZoneMachine",
    "ZoneProfile",
    "admissible_shares",
    "classify",
    "forces_stop",
    "greatest_scaling",
    "level_speeds",
    "max_closing_speeds",
    "zone_of",
]
