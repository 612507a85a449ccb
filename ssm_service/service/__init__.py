"""A clock and a network round the monitor."""

from .loop import Beat, FixedRateLoop
from .options import MAX_RATE_HZ, MIN_RATE_HZ, ServiceOptions
from .service import Service, run_service

__all__ = ["MAX_RATE_HZ", "MIN_RATE_HZ", "Beat", "FixedRateLoop", "Service", "ServiceOptions", "run_service"]
