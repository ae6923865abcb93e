"""The colours that figures and annotated videos share; each detector's class has its colour."""

from __future__ import annotations

# The colours of text and main lines, and of lines in the background.
INK, FAINT = "#222222", "#999999"


def bgr(colour: str) -> tuple[int, int, int]:
    """Return blue, green and red, 0 to 255, of a colour ``#RRGGBB``: OpenCV's order."""
    red, green, blue = bytes.fromhex(colour.removeprefix("#"))
    return blue, green, red
