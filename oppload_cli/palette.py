"""The colours and names of the models, in figures and in annotated videos alike."""

from __future__ import annotations

# Okabe and Ito's palette: told apart by the colour-blind, and in grey by their lightness.
COLOURS = {"opplod": "#D55E00", "dlgmd": "#0072B2"}
NAMES = {"opplod": "OppLoD", "dlgmd": "D-LGMD"}
INK, FAINT, CALM = "#222222", "#999999", "#56B4E9"


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
