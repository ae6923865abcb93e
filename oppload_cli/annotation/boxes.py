"""A box around each looming object."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import cv2

from oppload_cli.annotation.layout import DARK, WHITE, width_of, write

if TYPE_CHECKING:
    from collections.abc import Iterable

    from oppload_cli.annotation.layout import Layout, Paint
    from oppload_cli.detection.places import Detection
    from oppload_cli.video.colour import Bgr


def draw_detections(
    canvas: Bgr, layout: Layout, detections: Iterable[Detection], paint: Paint
) -> None:
    """Draw a box around each object, with its number above it.

    While its object causes an alarm, a box has lines of twice the thickness and the word ALARM
    on its label. The lines are just inside its edges.

    Parameters
    ----------
    canvas : ndarray of uint8, shape (height, width, 3)
        The annotated frame; drawn on.
    layout : Layout
        Of the frame.
    detections : iterable of Detection
        The first is drawn last, so that nothing covers it.
    paint : tuple of int
        Blue, green and red of the detector that found them.
    """
    picture = canvas[layout.picture.slices]
    for detection in reversed(list(detections)):
        _draw(picture, layout, detection, paint)


def label_of(detection: Detection) -> str:
    """Return the text beside a box, such as ``#3`` or ``ALARM #3  contact in 0.84 s``."""
    name = f"ALARM #{detection.identity}" if detection.alarm else f"#{detection.identity}"
    seconds = detection.time_to_contact_s
    if seconds is None:
        return name
    # More digits would promise more than the estimate holds.
    return f"{name}  contact in {seconds:.{1 if seconds >= 1 else 2}f} s"


def _draw(picture: Bgr, layout: Layout, detection: Detection, paint: Paint) -> None:
    line = (2 if detection.alarm else 1) * layout.line
    edges = _edges(detection, layout)
    # A dark rim makes the box visible on any picture.
    _frame(picture, edges.grown(1), line + 2, DARK)
    _frame(picture, edges, line, paint)
    x, y = round(detection.centre_x * layout.scale_x), round(detection.centre_y * layout.scale_y)
    for colour, line in ((DARK, layout.line + 2), (paint, layout.line)):
        cv2.drawMarker(picture, (x, y), colour, cv2.MARKER_CROSS, layout.text, line)
    _label(picture, edges, layout, detection, paint)


class _Edges(NamedTuple):
    """A rectangle: the pixels from left and top up to right and bottom, without these two."""

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


def _label(picture: Bgr, edges: _Edges, layout: Layout, detection: Detection, paint: Paint) -> None:
    """Write above the box, or inside it at the top edge; on the detector's colour in an alarm."""
    label = label_of(detection)
    ground, ink = (paint, WHITE) if detection.alarm else (WHITE, paint)
    high = round(1.5 * layout.text)
    wide = width_of(label, layout.text, bold=True) + layout.text
    y = edges.top - high if edges.top >= high else max(0, edges.top)
    x = max(0, min(edges.left, picture.shape[1] - wide))
    _fill(picture, (x, y, x + wide, y + high), ground)
    at = (x + layout.text // 2, y + high // 2)
    write(picture, label, at, layout.text, ink, bold=True)
