"""The colours that figures and annotated videos have in common.

Those of the detectors stand with each detector.
"""

from __future__ import annotations

# For text and main lines, and for lines in the background.
INK, FAINT = "#222222", "#999999"


def bgr(colour: str) -> tuple[int, int, int]:
    """Return a colour as OpenCV has it.

    Parameters
    ----------
    colour : str
        ``#RRGGBB``.

    Returns
    -------
    tuple of int
        Blue, green and red, 0 to 255.
    """
    red, green, blue = bytes.fromhex(colour.removeprefix("#"))
    return blue, green, red
