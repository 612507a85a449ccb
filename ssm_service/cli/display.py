"""A picture on a terminal that is redrawn by itself."""

from __future__ import annotations

from collections.abc import Callable
from types import TracebackType
from typing import Final

from rich.console import Console, ConsoleDimensions, RenderableType
from rich.live import Live

FRAMES_PER_SECOND: Final = 8


class Display:
    """Shows a state on a terminal, from a thread of its own; does nothing where there is no terminal.

    Args:
        draw: Makes the picture for a terminal of a size.
        quiet: Show nothing in any case.
        stderr: Whether it goes there, as beside a result that goes to stdout.
    """

    def __init__(
        self,
        draw: Callable[[ConsoleDimensions], RenderableType],
        *,
        quiet: bool = False,
        stderr: bool = True,
    ) -> None:
        self.console = Console(stderr=stderr)
        self.shown = self.console.is_terminal and not quiet
        self._live = Live(
            get_renderable=lambda: draw(self.console.size),
            console=self.console,
            refresh_per_second=FRAMES_PER_SECOND,
            transient=False,
            redirect_stdout=False,
            redirect_stderr=False,
        )

    def __enter__(self) -> Display:
        if self.shown:
            self._live.start(refresh=True)
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self.shown:
            self._live.stop()
