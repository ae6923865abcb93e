"""The strip below the picture: time, alarm, and the response curves."""

from __future__ import annotations

import math
from itertools import groupby, pairwise
from typing import TYPE_CHECKING

import cv2
import numpy as np

from oppload_cli.annotation.text import width_of, write
from oppload_cli.palette import COLOURS, FAINT, INK, NAMES, bgr

if TYPE_CHECKING:
    from oppload_cli.annotation.history import History, Point
    from oppload_cli.annotation.layout import Layout
    from oppload_cli.results.record import FrameRecord
    from oppload_cli.video.colour import Bgr

    Paint = tuple[int, int, int]  # blue, green, red

PAPER, GRID, WHITE = (255, 255, 255), (225, 225, 225), (255, 255, 255)
DARK, DIM = bgr(INK), bgr(FAINT)
BELOW, ABOVE = 1.5, 2.5  # decades of the threshold that the plot shows
LEVELS = {0: "threshold", 1: "10 x", 2: "100 x"}
SHADE = 0.25  # opacity of the ground where an alarm is on
FINE = 4  # binary digits of a fraction of a pixel


def draw_ground(canvas: Bgr, layout: Layout) -> None:
    """Draw what is the same in every frame: the strip's paper and the names of its levels.

    Parameters
    ----------
    canvas : ndarray of uint8, shape (height, width, 3)
        An empty frame; drawn on.
    layout : Layout
        Where the strip is in it.
    """
    canvas[layout.header.y :] = PAPER
    for level, name in LEVELS.items():
        row = layout.plot.y + round(level_row(10.0**level, layout))
        x = layout.plot.x - layout.text // 2 - width_of(name, layout.text)
        write(canvas, name, (x, row), layout.text, DARK if level == 0 else DIM)


def draw_strip(canvas: Bgr, layout: Layout, history: History, record: FrameRecord) -> None:
    """Draw the strip of one frame on its ground.

    The curves are logarithmic, 1/30 to 300 times the alarm's threshold. The ground is
    shaded in a model's colour where its alarm is on, in OppLoD's where both are.

    Parameters
    ----------
    canvas : ndarray of uint8, shape (height, width, 3)
        The annotated frame; drawn on.
    layout : Layout
        Where the strip is in it.
    history : History
        Has this frame too.
    record : FrameRecord
        The frame.
    """
    _header(canvas, layout, record)
    plot = canvas[layout.plot.slices]
    for name, points in reversed(history.points.items()):
        _shade(plot, layout, history, list(points), bgr(COLOURS[name]))
    _grid(plot, layout, history)
    for name, points in reversed(history.points.items()):
        _curve(plot, layout, history, list(points), bgr(COLOURS[name]))
    alarming = _alarming(record)
    edge = bgr(COLOURS[alarming[0]]) if alarming else DIM
    canvas[layout.header.y : layout.header.y + layout.line] = edge


def level_row(ratio: float, layout: Layout) -> float:
    """Return where a ratio stands in the plot.

    Parameters
    ----------
    ratio : float
        Response over threshold, at least 0.
    layout : Layout
        Gives the plot's size.

    Returns
    -------
    float
        Row of the plot; what is beyond its range is put at its edge.
    """
    level = max(-BELOW, min(ABOVE, math.log10(ratio))) if ratio > 0 else -BELOW
    margin = 2 * layout.line  # for half of a dot
    return margin + (layout.plot.height - 1 - 2 * margin) * (ABOVE - level) / (ABOVE + BELOW)


def column_of(time_s: float, layout: Layout, history: History) -> float:
    """Return where a time stands in the plot.

    Parameters
    ----------
    time_s : float
        Presentation time in seconds.
    layout : Layout
        Gives the plot's size.
    history : History
        Gives the part of the video that it shows.

    Returns
    -------
    float
        Column of the plot.
    """
    whole = layout.plot.width - 1 - 2 * layout.line
    return whole * (time_s - history.start_s) / history.window_s


def _alarming(record: FrameRecord) -> list[str]:
    return [name for name in COLOURS if record.alarms.get(name, False)]


def _header(canvas: Bgr, layout: Layout, record: FrameRecord) -> None:
    text, area = layout.text, layout.header
    middle = area.y + layout.line + (area.height - layout.line) // 2
    clock = f"{record.time_s:.2f} s"
    write(canvas, clock, (area.x, middle), text, DARK, bold=True)
    after = area.x + max(width_of(clock, text, bold=True), 4 * text) + text
    frame = f"frame {record.frame}"
    write(canvas, frame, (after, middle), text, DARK)
    after += max(width_of(frame, text), 5 * text) + text
    alarming = _alarming(record)
    if alarming:
        _sign(canvas, "ALARM", (after, middle), text, bgr(COLOURS[alarming[0]]))
    x = area.x + area.width
    for name in reversed(list(record.responses)):
        x -= width_of(NAMES[name], text, bold=True) + text
        paint = bgr(COLOURS[name])
        if name in alarming:
            _sign(canvas, NAMES[name], (x, middle), text, paint)
        else:
            write(canvas, NAMES[name], (x + text // 2, middle), text, paint, bold=True)
        x -= text // 2


def _sign(canvas: Bgr, word: str, at: tuple[int, int], text: int, paint: Paint) -> None:
    """Write a word in white on a ground of a colour."""
    x, middle = at
    half = round(0.75 * text)
    wide = width_of(word, text, bold=True) + text
    canvas[middle - half : middle + half, x : x + wide] = paint
    write(canvas, word, (x + text // 2, middle), text, WHITE, bold=True)


def _grid(plot: Bgr, layout: Layout, history: History) -> None:
    """Draw a line per level, and a tick per second at the foot."""
    for level in LEVELS:
        row, line = round(level_row(10.0**level, layout)), layout.line if level == 0 else 1
        plot[row - line // 2 : row - line // 2 + line] = DARK if level == 0 else GRID
    plot[-1] = DIM
    second = math.ceil(history.start_s)
    while (column := round(column_of(second, layout, history))) < layout.plot.width:
        plot[-layout.text // 3 :, column : column + 1] = DIM
        second += 1


def _shade(plot: Bgr, layout: Layout, history: History, points: list[Point], paint: Paint) -> None:
    tint = np.rint((1 - SHADE) * np.array(PAPER) + SHADE * np.array(paint)).astype(np.uint8)
    for point, following in pairwise([*points, *points[-1:]]):
        if point.alarm:
            first = math.floor(column_of(point.time_s, layout, history))
            last = math.ceil(column_of(following.time_s, layout, history))
            plot[:, max(0, first) : max(0, last + 1)] = tint


def _curve(plot: Bgr, layout: Layout, history: History, points: list[Point], paint: Paint) -> None:
    for known, group in groupby(points, key=lambda each: each.ratio is not None):
        if not known:
            continue
        places = [
            (column_of(each.time_s, layout, history), level_row(each.ratio or 0.0, layout))
            for each in group
        ]
        fine = np.rint(np.array(places) * (1 << FINE)).astype(np.int32)
        cv2.polylines(plot, [fine], False, paint, layout.line, cv2.LINE_AA, FINE)
    if points and points[-1].ratio is not None:
        x, y = fine[-1].tolist()
        cv2.circle(plot, (x, y), 2 * layout.line << FINE, paint, -1, cv2.LINE_AA, FINE)
