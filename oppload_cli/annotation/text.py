"""Text on pictures."""

from __future__ import annotations

from typing import TYPE_CHECKING

import cv2

if TYPE_CHECKING:
    from oppload_cli.video.colour import Bgr

    Paint = tuple[int, int, int]  # blue, green, red

LIGHT, BOLD = cv2.FONT_HERSHEY_SIMPLEX, cv2.FONT_HERSHEY_DUPLEX
CAPITAL = 0.7  # height of a capital letter, of the line's


def width_of(text: str, size: int, *, bold: bool = False) -> int:
    """Return how wide a text becomes.

    Parameters
    ----------
    text : str
        ASCII only: more is not in the font.
    size : int
        Height of the line in pixels.
    bold : bool
        Whether it is bold.

    Returns
    -------
    int
        In pixels.
    """
    (width, _), _ = cv2.getTextSize(text, _font(bold), _scale(size, bold), 1)
    return int(width)


def write(
    picture: Bgr, text: str, at: tuple[int, int], size: int, paint: Paint, *, bold: bool = False
) -> None:
    """Write a line of text.

    Parameters
    ----------
    picture : ndarray of uint8, shape (height, width, 3)
        What to write on.
    text : str
        ASCII only.
    at : tuple of int
        Column of its left end, and row of the middle of its capital letters.
    size : int
        Height of the line in pixels.
    paint : tuple of int
        Blue, green and red.
    bold : bool
        Whether it is bold.
    """
    foot = at[1] + round(CAPITAL * size / 2)
    font, scale = _font(bold), _scale(size, bold)
    cv2.putText(picture, text, (at[0], foot), font, scale, paint, 1, cv2.LINE_AA)


def _font(bold: bool) -> int:
    return BOLD if bold else LIGHT


def _scale(size: int, bold: bool) -> float:
    """Return OpenCV's scale that gives capital letters their height."""
    (_, height), _ = cv2.getTextSize("H", _font(bold), 1.0, 1)
    return CAPITAL * size / height
