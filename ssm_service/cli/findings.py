"""What ``ssm check`` finds: one line each, by how much it matters."""

from __future__ import annotations

from typing import Any, Literal, NamedTuple

Level = Literal["fault", "weak", "note", "ok"]


class Finding(NamedTuple):
    """One thing about a file.

    Attributes:
        level: ``fault``: it does not work, or not as it says. ``weak``: it works, and one should know where
            it is thin. ``note``: worth knowing. ``ok``: looked at and found in order.
        key: The key or part of the file that it is about; empty for the file as a whole.
        text: What was found and what follows from it.
    """

    level: Level
    key: str
    text: str


class Report(NamedTuple):
    """All findings about one file.

    Attributes:
        file: The file.
        kind: ``robot`` or ``zenoh``.
        findings: In the order in which they were found.
    """

    file: str
    kind: Literal["robot", "zenoh"]
    findings: list[Finding]

    def count(self, level: Level) -> int:
        """Return how many findings have a level."""
        return sum(finding.level == level for finding in self.findings)

    def to_builtins(self) -> dict[str, Any]:
        """Return the report as plain values."""
        return {
            "file": self.file,
            "kind": self.kind,
            "faults": self.count("fault"),
            "weak": self.count("weak"),
            "findings": [finding._asdict() for finding in self.findings],
        }
