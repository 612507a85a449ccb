"""Colours of the zones, on the terminal and on paper; told apart by lightness too, not by hue alone."""

from __future__ import annotations

from typing import Final

from ..safety import Zone

BADGE: Final = {
    Zone.GREEN: "bold white on #00805f",
    Zone.YELLOW: "bold black on #f0c808",
    Zone.RED: "bold white on #d1340b",
    Zone.STOP: "bold white on #6a1b6e",
}
"""Style of a zone's name on a terminal."""

INK: Final = {
    Zone.GREEN: "#00a37a",
    Zone.YELLOW: "#f0c808",
    Zone.RED: "#e8501f",
    Zone.STOP: "#a03ca6",
}
"""Style of things drawn in a zone's colour on a terminal."""

BAND: Final = {
    Zone.GREEN: "#e3f4ee",
    Zone.YELLOW: "#fdeeb0",
    Zone.RED: "#f6b79b",
    Zone.STOP: "#b79ac0",
}
"""Background of a zone in a figure, the more severe the darker."""

LINES: Final = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#56b4e9", "#000000", "#e69f00", "#7f7f7f")
"""Colours of lines in figures, after Okabe and Ito: safe for the colour-blind."""
