"""A clock and a network round the monitor."""

from .loop import Beat, FixedRateLoop
from .options import MAX_RATE_HZ, MIN_RATE_HZ, ServiceOptions
from .run import run_service
from .service import Service

__all__ = ["MAX_RATE_HZ", "MIN_RATE_HZ", "Beat", "FixedRateLoop", "Service", "ServiceOptions", "run_service"]
