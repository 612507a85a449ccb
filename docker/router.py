"""A Zenoh router from one configuration file: ``python docker/router.py docker/zenoh/router.json5``.

The official ``zenohd --config FILE`` reads the same file (not tried here); this script needs nothing but the
Python wheel that the service has anyway.
"""

from __future__ import annotations

import json
import signal
import sys

import zenoh

ENDING = {signal.SIGINT, signal.SIGTERM}


def main() -> int:
    """Route until SIGINT or SIGTERM; return the exit status."""
    if len(sys.argv) != 2:
        return _refuse("one argument is needed, a Zenoh configuration file")
    file = sys.argv[1]
    # Blocked before Zenoh starts its threads, so that `sigwait` below is the one place where they arrive.
    signal.pthread_sigmask(signal.SIG_BLOCK, ENDING)
    try:
        config = zenoh.Config.from_file(file)
    except (zenoh.ZError, OSError, ValueError) as error:
        return _refuse(f"{file}: {error}")
    if json.loads(config.get_json("mode")) != "router":
        return _refuse(f'{file}: mode must be "router"')
    try:
        with zenoh.open(config):
            _log(f"routing at {', '.join(json.loads(config.get_json('listen/endpoints')))}")
            signal.sigwait(ENDING)
    except zenoh.ZError as error:
        _log(f"router: {error}")
        return 1
    _log("ended")
    return 0


def _refuse(text: str) -> int:
    _log(f"router: {text}")
    return 2


def _log(text: str) -> None:
    sys.stderr.write(f"{text}\n")
    sys.stderr.flush()


if __name__ == "__main__":
    sys.exit(main())
