"""The command ``ssm``: parsing and printing; what it does lies in the rooms below."""

from __future__ import annotations

import os
import sys

__all__ = ["main"]


def main() -> None:
    """Run the command line and end the process with its exit status."""
    from .app import run_app

    status: object = 0
    try:
        run_app()
    except SystemExit as end:
        status = end.code
    _end_now_if_a_session_lingers(status)
    sys.exit(status)  # type: ignore[arg-type]


def _end_now_if_a_session_lingers(status: object) -> None:
    session = sys.modules.get("ssm_service.wire.session")
    if session is not None and session.still_closing():
        sys.stdout.flush()
        sys.stderr.flush()
        os._exit(status if isinstance(status, int) else int(status is not None))
