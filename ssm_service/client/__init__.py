"""A watchdog round the network: queries, and a stream that stops by itself."""

from .client import Client
from .connection import Connection
from .followed import Followed
from .follower import Follower
from .watchdog import Watchdog

__all__ = ["Client", "Connection", "Followed", "Follower", "Watchdog"]
