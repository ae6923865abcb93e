"""A box around each looming object."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import cv2

from oppload_cli.annotation.text import width_of, write
from oppload_cli.palette import CALM, COLOURS, INK, bgr

if TYPE_CHECKING:
    from collections.abc import Iterable

    from oppload_cli.annotation.layout import Layout
    from oppload_cli.results.record import Detection
    from oppload_cli.video.colour import Bgr

    Paint = tuple[int, int, int]

ALARM_PAINT, CALM_PAINT = bgr(COLOURS["opplod"]), bgr(CALM)
DARK, WHITE = bgr(INK), (255, 255, 255)
CORNER = 0.2  # length of the thick corners, of the shorter side
MOST_CORNER = 1.5  # lines of text


def draw_detections(canvas: Bgr, layout: Layout, detections: Iterable[Detection]) -> None:
    """Draw a box with thick corners around each object, with its number above it.

    Boxes are vermillion while they cause an alarm, and blue else; the lines lie just
    inside the box's edges.

    Parameters
    ----------
    canvas : ndarray of uint8, shape (height, width, 3)
        The annotated frame; drawn on.
    layout : Layout
        Where the picture is in it.
    detections : iterable of Detection
        The first is drawn last, so that nothing covers it.
    """
    picture = canvas[layout.picture.slices]
    for detection in reversed(list(detections)):
        _draw(picture, layout, detection)


def label_of(detection: Detection) -> str:
    """Return what is written beside a box.

    Parameters
    ----------
    detection : Detection
        The object.

    Returns
    -------
    str
        ``#3`` or ``#3  contact in 0.84 s``.
    """
    left = detection.time_to_contact_s
    if left is None:
        return f"#{detection.identity}"
    # As many digits as may mean something.
    return f"#{detection.identity}  contact in {left:.{1 if left >= 1 else 2}f} s"


def _draw(picture: Bgr, layout: Layout, detection: Detection) -> None:
    paint = ALARM_PAINT if detection.alarm else CALM_PAINT
    edges = _edges(detection, layout)
    # A dark rim, so that it shows on any picture.
    _frame(picture, edges.grown(1), layout.line + 2, DARK)
    _corners(picture, edges, layout, paint)
    _frame(picture, edges, layout.line, paint)
    x, y = round(detection.centre_x * layout.scale_x), round(detection.centre_y * layout.scale_y)
    for colour, line in ((DARK, layout.line + 2), (paint, layout.line)):
        cv2.drawMarker(picture, (x, y), colour, cv2.MARKER_CROSS, layout.text, line)
    _label(picture, edges, layout, label_of(detection), paint)


class _Edges(NamedTuple):
    """A rectangle: the pixels from left and top up to right and bottom, these not included."""

    left: int
    top: int
    right: int
    bottom: int

    def grown(self, by: int) -> _Edges:
        return _Edges(self.left - by, self.top - by, self.right + by, self.bottom + by)


def _edges(detection: Detection, layout: Layout) -> _Edges:
    box, x, y = detection.box, layout.scale_x, layout.scale_y
    left, top = round(box.x * x), round(box.y * y)
    right, bottom = round((box.x + box.width) * x), round((box.y + box.height) * y)
    return _Edges(left, top, max(right, left + 1), max(bottom, top + 1))


def _fill(picture: Bgr, edges: tuple[int, int, int, int], paint: Paint) -> None:
    left, top, right, bottom = (max(0, each) for each in edges)
    picture[top:bottom, left:right] = paint


def _frame(picture: Bgr, edges: _Edges, line: int, paint: Paint) -> None:
    left, top, right, bottom = edges
    _fill(picture, (left, top, right, min(top + line, bottom)), paint)
    _fill(picture, (left, max(bottom - line, top), right, bottom), paint)
    _fill(picture, (left, top, min(left + line, right), bottom), paint)
    _fill(picture, (max(right - line, left), top, right, bottom), paint)


def _corners(picture: Bgr, edges: _Edges, layout: Layout, paint: Paint) -> None:
    """Draw the corners twice as thick as the lines, inwards."""
    left, top, right, bottom = edges
    shorter = min(right - left, bottom - top)
    long, thick = round(min(CORNER * shorter, MOST_CORNER * layout.text)), 2 * layout.line
    for x in (left, right - long):
        for y in (top, bottom - thick):
            _fill(picture, (x, y, x + long, y + thick), paint)
    for x in (left, right - thick):
        for y in (top, bottom - long):
            _fill(picture, (x, y, x + thick, y + long), paint)


def _label(picture: Bgr, edges: _Edges, layout: Layout, label: str, paint: Paint) -> None:
    """Write on a ground of the box's colour: above it, or inside where there is no room."""
    high = round(1.5 * layout.text)
    wide = width_of(label, layout.text, bold=True) + layout.text
    y = edges.top - high if edges.top >= high else max(0, edges.top)
    x = max(0, min(edges.left, picture.shape[1] - wide))
    _fill(picture, (x, y, x + wide, y + high), paint)
    ink = WHITE if paint == ALARM_PAINT else DARK
    at = (x + layout.text // 2, y + high // 2)
    write(picture, label, at, layout.text, ink, bold=True)
