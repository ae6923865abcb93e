"""Where everything stands in an annotated frame."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

from oppload_cli.video.colour import LONGEST_SIDE, colour_size

if TYPE_CHECKING:
    from oppload_cli.video.frames import InputFacts

SHORT_SIDE = 400  # px; a smaller picture is enlarged by a whole number
LEAST_WIDTH = 540  # px; what the text needs
LEAST_TEXT = 16  # px, of a capital letter's line


class Area(NamedTuple):
    """A part of the annotated frame, in its pixels.

    Attributes
    ----------
    x, y, width, height : int
        Left top corner and size.
    """

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
        Of the whole frame; both even.
    picture : Area
        The source's picture.
    header : Area
        Time, alarm and the models' names, below the picture.
    plot : Area
        The response curves, below the header.
    scale_x, scale_y : float
        Annotated pixels per source pixel.
    text : int
        Height of a line of text.
    line : int
        Thickness of a line.
    """

    width: int
    height: int
    picture: Area
    header: Area
    plot: Area
    scale_x: float
    scale_y: float
    text: int
    line: int


def layout_of(facts: InputFacts) -> Layout:
    """Return the layout for an input.

    Parameters
    ----------
    facts : InputFacts
        Gives the displayed size.

    Returns
    -------
    Layout
        The text grows with the picture, from 16 px.
    """
    width, height = colour_size(facts)
    times = enlargement(width, height)
    width, height = width * times, height * times
    across = _even(max(width, LEAST_WIDTH))
    text = max(LEAST_TEXT, round(min(across / 56, height / 32)))
    header, plot, gap = 2 * text, 6 * text, text // 2
    gutter = round(5.5 * text)  # for the names of the levels
    return Layout(
        across,
        _even(height + header + plot + gap),
        Area((across - width) // 2, 0, width, height),
        Area(gap, height, across - 2 * gap, header),
        Area(gutter, height + header, across - gutter - gap, plot),
        width / facts.width,
        height / facts.height,
        text,
        max(2, round(text / 8)),
    )


def enlargement(width: int, height: int) -> int:
    """Return how many times a picture is enlarged, so that text fits on it.

    Parameters
    ----------
    width, height : int
        Of the picture, in pixels.

    Returns
    -------
    int
        From 1; no side becomes longer than 1920 px.
    """
    wanted = math.ceil(SHORT_SIDE / min(width, height))
    return max(1, min(wanted, LONGEST_SIDE // max(width, height)))


def _even(number: int) -> int:
    return number + number % 2
