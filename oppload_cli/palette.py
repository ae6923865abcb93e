"""The colours that figures and annotated videos share; each detector's class has its colour."""

from __future__ import annotations

# The colours of text and main lines, and of lines in the background.
INK, FAINT = "#222222", "#999999"
_WHITE = "#ffffff"
_LEAST_CONTRAST = 2.9  # of letters to their ground


def bgr(colour: str) -> tuple[int, int, int]:
    """Return blue, green and red, 0 to 255, of a colour ``#RRGGBB``: OpenCV's order."""
    red, green, blue = bytes.fromhex(colour.removeprefix("#"))
    return blue, green, red


def ink_on(colour: str) -> str:
    """Return the colour of letters on a ground: white, or dark if white could not be read on it."""
    return _WHITE if _contrast_to_white(colour) >= _LEAST_CONTRAST else INK


def ink_of(colour: str) -> str:
    """Return a colour for letters on white: darker than `colour` if it could not be read."""
    while _contrast_to_white(colour) < _LEAST_CONTRAST:
        darker = (round(0.95 * value) for value in bytes.fromhex(colour.removeprefix("#")))
        colour = f"#{bytes(darker).hex()}"
    return colour


def _contrast_to_white(colour: str) -> float:
    """Return the contrast of a colour to white, as WCAG defines it."""
    blue, green, red = (((value / 255 + 0.055) / 1.055) ** 2.4 for value in bgr(colour))
    return float(1.05 / (0.2126 * red + 0.7152 * green + 0.0722 * blue + 0.05))
