"""A Zenoh router from one configuration file: ``python docker/router.py KEYS/router/zenoh.json5``.

It refuses to listen beyond this machine without mutual TLS unless told ``--insecure``. The official
``zenohd --config FILE`` reads the same file (not tried here), without that refusal.
"""

from __future__ import annotations

import json
import signal
import sys

import zenoh

LOCAL = ("127.0.0.1:", "localhost:", "[::1]:")
INSECURE = "--insecure"
ENDING = {signal.SIGINT, signal.SIGTERM}


def main() -> int:
    """Route until SIGINT or SIGTERM; return the exit status."""
    files = [word for word in sys.argv[1:] if word != INSECURE]
    if len(files) != 1:
        return _refuse(f"one argument is needed, a Zenoh configuration file; before it, perhaps {INSECURE}")
    (file,) = files
    # Blocked before Zenoh starts its threads, so that `sigwait` below is the one place where they arrive.
    signal.pthread_sigmask(signal.SIG_BLOCK, ENDING)
    try:
        config = zenoh.Config.from_file(file)
    except (zenoh.ZError, OSError, ValueError) as error:
        return _refuse(f"{file}: {error}")
    if json.loads(config.get_json("mode")) != "router":
        return _refuse(f'{file}: mode must be "router"')
    weak = _open_to_all(config)
    if weak and INSECURE not in sys.argv:
        return _refuse(f"{file}: {weak[0]}; make keys with `ssm keys init`, or say {INSECURE}")
    for one in weak:
        _log(f"insecure: {one}: whoever reaches it can send inputs and read all")
    try:
        with zenoh.open(config):
            _log(f"routing at {', '.join(json.loads(config.get_json('listen/endpoints')))}")
            signal.sigwait(ENDING)
    except zenoh.ZError as error:
        _log(f"router: {error}")
        return 1
    _log("ended")
    return 0


def _open_to_all(config: zenoh.Config) -> list[str]:
    """Return where it listens beyond this machine and asks for no certificate; `ssm run` looks closer."""
    asks = json.loads(config.get_json("transport/link/tls/enable_mtls")) is True
    found = json.loads(config.get_json("listen/endpoints"))
    endpoints = found.get("router", []) if isinstance(found, dict) else found
    return [
        f"listens at {endpoint} without mutual TLS"
        for endpoint in ([endpoints] if isinstance(endpoints, str) else endpoints)
        if not endpoint.partition("/")[2].startswith(LOCAL)
        and not (asks and endpoint.startswith(("tls/", "quic/")) and "enable_mtls" not in endpoint)
    ]


def _refuse(text: str) -> int:
    _log(f"router: {text}")
    return 2


def _log(text: str) -> None:
    sys.stderr.write(f"{text}\n")
    sys.stderr.flush()


if __name__ == "__main__":
    sys.exit(main())
