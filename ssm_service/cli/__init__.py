"""The command ``ssm``: parsing and printing; what it does lies in the rooms below."""

from __future__ import annotations

__all__ = ["main"]


def main() -> None:
    """Run the command line and end the process with its exit status."""
    from .app import run_app

    run_app()
