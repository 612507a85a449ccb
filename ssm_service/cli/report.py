"""The folder of a demo's report: either whole, or nothing of ours in it."""

from __future__ import annotations

import contextlib
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING, Any, Final, Self

from ..errors import ConfigError
from .words import FIGURES

if TYPE_CHECKING:
    from ..model import Robot
    from .recording import Recording

SUMMARY: Final = "summary.json"


class ReportFolder:
    """Made on entering, without what an earlier run left there; removed on leaving if nothing was written.

    Args:
        path: Where it is.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self._made: list[Path] = []

    def __enter__(self) -> Self:
        """Make the folder.

        Raises:
            ConfigError: It cannot be made or written to.
        """
        self._made = [folder for folder in (self.path, *self.path.parents) if not folder.exists()]
        try:
            self.path.mkdir(parents=True, exist_ok=True)
            for name in (SUMMARY, *FIGURES):  # a rerun that fails must not look like the run before it
                (self.path / name).unlink(missing_ok=True)
        except OSError as error:
            self._remove()
            allowed = f"a folder to write to ({error.strerror})"
            raise ConfigError("--out", "", str(self.path), allowed) from error
        except BaseException:  # Ctrl-C does not wait until we are done
            self._remove()
            raise
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if not (self.path / SUMMARY).exists():
            self._remove()

    def write(self, summary: dict[str, Any], recording: Recording, robot: Robot) -> None:
        """Write figures and summary; the summary is told the figures' names."""
        import msgspec

        from .figures import write_figures

        summary["figures"] = write_figures(self.path, recording, robot)
        data = msgspec.json.format(msgspec.json.encode(summary), indent=2)
        (self.path / SUMMARY).write_bytes(data + b"\n")

    def _remove(self) -> None:
        """Remove our figures and the folders that we made, unless somebody else has put something there."""
        with contextlib.suppress(OSError):
            for name in FIGURES:
                (self.path / name).unlink(missing_ok=True)
            for folder in self._made:
                if folder.exists():
                    folder.rmdir()
