"""The parts of an annotated frame, the colours in it, and the text on it."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

import cv2

from oppload_cli import palette
from oppload_cli.models.registry import detector_named
from oppload_cli.palette import bgr
from oppload_cli.video.colour import LONGEST_SIDE, colour_size

if TYPE_CHECKING:
    from oppload_cli.video.colour import Bgr
    from oppload_cli.video.frames import InputFacts


Paint = tuple[int, int, int]  # blue, green, red

DARK, DIM, WHITE = bgr(palette.INK), bgr(palette.FAINT), (255, 255, 255)
SHORT_SIDE = 400  # px; a smaller picture is enlarged by an integer
LEAST_WIDTH = 540  # px; the text needs it
LEAST_TEXT = 16  # px, of a line
LIGHT, BOLD = cv2.FONT_HERSHEY_SIMPLEX, cv2.FONT_HERSHEY_DUPLEX
CAPITAL = 0.7  # height of a capital letter, of the line's


def paint_of(name: str) -> Paint:
    """Return the colour of a detector as OpenCV has it."""
    return bgr(detector_named(name).colour)


class _Area(NamedTuple):
    """A rectangle of the annotated frame: its left top corner and its size, in pixels."""

    x: int
    y: int
    width: int
    height: int

    @property
    def slices(self) -> tuple[slice, slice]:
        """Rows and columns, to cut it out of an array."""
        return slice(self.y, self.y + self.height), slice(self.x, self.x + self.width)


@dataclass(frozen=True)
class Layout:
    """The measures of an annotated video, all in its own pixels.

    Attributes
    ----------
    width, height : int
        Of the annotated frame; both even.
    picture : _Area
        The source's picture.
    header : _Area
        Time, alarm and the detectors' labels, below the picture.
    plot : _Area
        The response curves, below the header; the numbers of the time axis are below them.
    scale_x, scale_y : float
        Annotated pixels per source pixel.
    text : int
        Height of a line of text.
    line : int
        Thickness of a line.
    """

    width: int
    height: int
    picture: _Area
    header: _Area
    plot: _Area
    scale_x: float
    scale_y: float
    text: int
    line: int


def layout_of(facts: InputFacts) -> Layout:
    """Return the layout for an input; the text grows with the picture, from 16 px."""
    width, height = colour_size(facts)
    times = math.ceil(SHORT_SIDE / min(width, height))
    times = max(1, min(times, LONGEST_SIDE // max(width, height)))
    width, height = width * times, height * times
    across = _even(max(width, LEAST_WIDTH))
    text = max(LEAST_TEXT, round(min(across / 56, height / 32)))
    header, plot, gap = 2 * text, 6 * text, text // 2
    numbers = round(1.4 * text)  # of the time axis
    gutter = round(5.5 * text)  # for the names of the levels
    return Layout(
        across,
        _even(height + header + plot + numbers),
        _Area((across - width) // 2, 0, width, height),
        _Area(gap, height, across - 2 * gap, header),
        _Area(gutter, height + header, across - gutter - gap, plot),
        width / facts.width,
        height / facts.height,
        text,
        max(2, round(text / 8)),
    )


def _even(number: int) -> int:
    return number + number % 2


def width_of(text: str, size: int, *, bold: bool = False) -> int:
    """Return the width in pixels of an ASCII text in lines of a height in pixels."""
    (width, _), _ = cv2.getTextSize(text, *_font(size, bold), 1)
    return int(width)


def write(
    picture: Bgr, text: str, at: tuple[int, int], size: int, paint: Paint, *, bold: bool = False
) -> None:
    """Write a line of text.

    Parameters
    ----------
    picture : ndarray of uint8, shape (height, width, 3)
        Drawn on.
    text : str
        ASCII only: the font has no other letters.
    at : tuple of int
        Column of its left end, and row of the middle of its capital letters.
    size : int
        Height of the line in pixels.
    paint : tuple of int
        Colour of the letters.
    bold : bool
        Whether it is bold.
    """
    foot = at[1] + round(CAPITAL * size / 2)
    cv2.putText(picture, text, (at[0], foot), *_font(size, bold), paint, 1, cv2.LINE_AA)


def _font(size: int, bold: bool) -> tuple[int, float]:
    """Return OpenCV's font, and the scale that gives capital letters their height."""
    font = BOLD if bold else LIGHT
    (_, height), _ = cv2.getTextSize("H", font, 1.0, 1)
    return font, CAPITAL * size / height
