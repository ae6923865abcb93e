"""The colours that figures and annotated videos have in common.

Those of the detectors stand with each detector.
"""

from __future__ import annotations

# Okabe and Ito's palette, as for the detectors: told apart by the colour-blind, and in grey.
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
