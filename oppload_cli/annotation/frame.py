"""An annotated frame: its layout, the boxes in the picture, and the strip of curves below."""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass
from itertools import groupby, pairwise
from typing import TYPE_CHECKING, NamedTuple

import cv2
import numpy as np

from oppload_cli.models.registry import detector_named
from oppload_cli.palette import FAINT, INK, bgr, ink_of, ink_on
from oppload_cli.video.writers import LONGEST_SIDE, colour_size

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

    from oppload_cli.detection.places import Detection
    from oppload_cli.results.record import FrameRecord
    from oppload_cli.video.frames import InputFacts
    from oppload_cli.video.writers import Bgr


_Paint = tuple[int, int, int]  # blue, green, red

DARK, _DIM, _WHITE = bgr(INK), bgr(FAINT), (255, 255, 255)
_CAPITAL = 0.7  # height of a capital letter over that of the line
_WINDOW_S = 5.0  # the time that the strip shows
_DECADES = 4  # that the plot shows
_FINE = 4  # binary digits of a fraction of a pixel, in OpenCV's coordinates
_FURTHEST = 20_000  # px; points farther away from the plot are moved to this distance


class _Scale(NamedTuple):
    top: float  # decades from a ratio of 1 to the upper edge
    levels: dict[int, str]  # names of horizontal lines, by the decade of the line


_OVER_THRESHOLD = _Scale(2.5, {0: "threshold", 1: "10 x", 2: "100 x"})
_OVER_LARGEST = _Scale(0.5, {0: "largest", -1: "1/10", -2: "1/100", -3: "1/1000"})


class _Area(NamedTuple):
    x: int
    y: int
    width: int
    height: int

    @property
    def slices(self) -> tuple[slice, slice]:
        """Rows and columns: the indices of the area in an array."""
        return slice(self.y, self.y + self.height), slice(self.x, self.x + self.width)


@dataclass(frozen=True)
class Layout:
    """The sizes in an annotated video, in pixels of the annotated video."""

    width: int  # of the annotated frame; an even number
    height: int  # an even number
    picture: _Area
    header: _Area  # below the picture: time, alarm and the detectors' labels
    plot: _Area  # below the header: the curves; below it are the numbers of the time axis
    scale_x: float  # annotated pixels per source pixel
    scale_y: float
    text: int  # height of a line of text
    line: int  # thickness of a line

    @classmethod
    def of(cls, facts: InputFacts) -> Layout:
        """Return the layout for an input; the size of the text grows with that of the picture."""
        width, height = colour_size(facts)
        magnification = math.ceil(400 / min(width, height))  # small pictures are enlarged
        magnification = max(1, min(magnification, LONGEST_SIDE // max(width, height)))
        width, height = width * magnification, height * magnification
        full_width = _even(max(width, 540))  # so that the text fits
        text = max(16, round(min(full_width / 56, height / 32)))
        header, plot, gap = 2 * text, 6 * text, text // 2
        axis_numbers = round(1.4 * text)  # of the time axis
        gutter = round(5.5 * text)  # for the names of the levels
        return cls(
            full_width,
            _even(height + header + plot + axis_numbers),
            _Area((full_width - width) // 2, 0, width, height),
            _Area(gap, height, full_width - 2 * gap, header),
            _Area(gutter, height + header, full_width - gutter - gap, plot),
            width / facts.width,
            height / facts.height,
            text,
            max(2, round(text / 8)),
        )

    def level_row(self, ratio: float, scale: _Scale = _OVER_THRESHOLD) -> float:
        """Return the row of the plot for a ratio, cut to the range of the scale."""
        below = min(_DECADES, max(0.0, scale.top - math.log10(ratio))) if ratio > 0 else _DECADES
        margin = 2 * self.line  # the radius of the dot at the latest point
        return margin + (self.plot.height - 1 - 2 * margin) * below / _DECADES


def _even(number: int) -> int:
    return number + number % 2


def _width_of(text: str, size: int, *, bold: bool = False) -> int:
    """Return the width in pixels of an ASCII text; `size` is the height of a line in pixels."""
    (width, _), _ = cv2.getTextSize(text, *_font(size, bold), 1)
    return int(width)


def _write(
    picture: Bgr, text: str, at: tuple[int, int], size: int, paint: _Paint, *, bold: bool = False
) -> None:
    """Write a line of ASCII text; `size` is the height of the line in pixels.

    `at` is the column of its left end, and the row of the middle of its capital letters.
    """
    foot = at[1] + round(_CAPITAL * size / 2)
    cv2.putText(picture, text, (at[0], foot), *_font(size, bold), paint, 1, cv2.LINE_AA)


def _font(size: int, bold: bool) -> tuple[int, float]:
    """Return OpenCV's font and its scale for lines of a height of `size` pixels."""
    font = cv2.FONT_HERSHEY_DUPLEX if bold else cv2.FONT_HERSHEY_SIMPLEX
    (_, height), _ = cv2.getTextSize("H", font, 1.0, 1)
    return font, _CAPITAL * size / height


class _Point(NamedTuple):
    time_s: float
    # The response over the alarm's threshold or, if alarms are off, over the largest response so
    # far. None during warm-up, and if the threshold is 0.
    ratio: float | None
    alarm: bool


class Strip:
    """The strip below the picture: it keeps the curves of the latest seconds, and draws them.

    The scale is logarithmic, from 1/30 to 300 times the alarm's threshold. If the alarms are off,
    it is from 1/3000 to 3 times the largest response so far. While an alarm is on, the ground is
    shaded, and the curve of the alarm's detector is thicker.

    Parameters
    ----------
    layout : Layout
        The sizes in the annotated video.
    detectors : sequence of str
        The detectors with a curve.
    duration_s : float, optional
        The duration of the video: the time axis of a short video has this length.
    """

    def __init__(
        self, layout: Layout, detectors: Sequence[str], duration_s: float | None = None
    ) -> None:
        self._layout = layout
        self.points: dict[str, deque[_Point]] = {  # in the order of the frames
            # The times of a damaged file may not advance.
            name: deque(maxlen=1 << 16)
            for name in detectors
        }
        self.window_s = max(0.1, min(_WINDOW_S, duration_s or _WINDOW_S))
        self.scale = _OVER_THRESHOLD
        self._largest = dict.fromkeys(detectors, 0.0)
        self._first_s: float | None = None
        self._now_s = 0.0
        self._repeats = 0

    def add(self, record: FrameRecord) -> None:
        """Take the record of the next frame without drawing it.

        Detectors do not see repeats, so that up to five repeats in a row give no point.
        """
        self._first_s = record.time_s if self._first_s is None else self._first_s
        self._now_s = record.time_s
        self._repeats = self._repeats + 1 if record.repeat else 0
        if all(math.isinf(said.threshold) for said in record.detectors.values()):
            self.scale = _OVER_LARGEST
        if not 0 < self._repeats <= 5:  # more are a scene at rest
            for name, points in self.points.items():
                response, threshold = record[name].response, record[name].threshold
                ratio = None
                over_largest = self.scale is _OVER_LARGEST
                if response is not None and (over_largest or 0 < threshold < math.inf):
                    base = self._largest_of(name, response) if over_largest else threshold
                    ratio = response / base
                points.append(_Point(record.time_s, ratio, record[name].alarm))
        for points in self.points.values():
            # One point before the left edge remains, so that the curve begins at the edge.
            while len(points) > 1 and points[1].time_s < self.start_s:
                points.popleft()

    def _largest_of(self, name: str, response: float) -> float:
        """Return the largest response so far; if it is new, divide the earlier points by it too."""
        largest = self._largest[name]
        if response > largest:
            points = self.points[name]
            for index, point in enumerate(points):
                if point.ratio is not None:
                    points[index] = point._replace(ratio=point.ratio * largest / response)
            self._largest[name] = response
        return self._largest[name] or 1.0

    @property
    def start_s(self) -> float:
        """Time at the left edge of the plot; it changes only when the plot is full."""
        return max(self._first_s or 0.0, self._now_s - self.window_s)

    def column_of(self, time_s: float) -> float:
        """Return the column of the plot for a presentation time."""
        width = self._layout.plot.width - 1 - 2 * self._layout.line
        return width * (time_s - self.start_s) / self.window_s

    def draw(self, canvas: Bgr, record: FrameRecord) -> None:
        """Take the record of the next frame, and draw the strip below the frame's picture."""
        self.add(record)
        layout = self._layout
        canvas[layout.header.y :] = _WHITE
        alarming = [name for name, said in record.detectors.items() if said.alarm]
        _header(canvas, layout, record, alarming)
        plot = canvas[layout.plot.slices]
        for points in self.points.values():
            self._shade(plot, list(points))
        _grid(canvas, layout, self.scale)
        self._ticks(canvas)
        for name, points in reversed(self.points.items()):
            self._curve(plot, list(points), bgr(detector_named(name).colour))
        edge, line = (DARK, 2 * layout.line) if alarming else (_DIM, layout.line)
        canvas[layout.header.y : layout.header.y + line] = edge

    def _ticks(self, canvas: Bgr) -> None:
        """Draw the ticks of the time axis, each with its number in seconds."""
        plot, text = self._layout.plot, self._layout.text
        step = _tick_step(self.window_s)
        digits = max(0, -math.floor(math.log10(step)))
        number = math.ceil(self.start_s / step - 1e-9)
        while (column := round(self.column_of(number * step))) < plot.width:
            x, foot = plot.x + column, plot.y + plot.height
            canvas[foot - text // 3 : foot, x : x + 1] = _DIM
            label = f"{number * step:.{digits}f} s"
            width = _width_of(label, text)
            label_x = min(x - width // 2, self._layout.width - width - 1)
            _write(canvas, label, (label_x, foot + round(0.7 * text)), text, _DIM)
            number += 1

    def _shade(self, plot: Bgr, points: list[_Point]) -> None:
        for point, following in pairwise([*points, *points[-1:]]):
            if point.alarm:
                first = math.floor(self.column_of(point.time_s))
                last = math.ceil(self.column_of(following.time_s))
                plot[:, max(0, first) : max(0, last + 1)] = 236  # light grey

    def _curve(self, plot: Bgr, points: list[_Point], paint: _Paint) -> None:
        """Draw lines between the ratios, thick in an alarm, and a dot at the latest point."""
        layout = self._layout
        for has_ratio, group in groupby(points, key=lambda point: point.ratio is not None):
            if not has_ratio:
                continue
            stretch = list(group)
            columns = [self.column_of(point.time_s) for point in stretch]
            rows = [layout.level_row(point.ratio or 0.0, self.scale) for point in stretch]
            # In a damaged file, times may jump far away, and OpenCV's coordinates are integers.
            clipped = np.clip(np.column_stack([columns, rows]), -_FURTHEST, _FURTHEST)
            path = np.rint(clipped * (1 << _FINE)).astype(np.int32)
            cv2.polylines(plot, [path], False, paint, layout.line, cv2.LINE_AA, _FINE)
            thick = [path[i : i + 2] for i, point in enumerate(stretch[:-1]) if point.alarm]
            cv2.polylines(plot, thick, False, paint, 2 * layout.line, cv2.LINE_AA, _FINE)
        if points and points[-1].ratio is not None:
            x, y = path[-1].tolist()
            cv2.circle(plot, (x, y), 2 * layout.line << _FINE, paint, -1, cv2.LINE_AA, _FINE)


def _header(canvas: Bgr, layout: Layout, record: FrameRecord, alarming: Sequence[str]) -> None:
    text, area = layout.text, layout.header
    middle = area.y + layout.line + (area.height - layout.line) // 2
    clock, frame = f"{record.time_s:.2f} s", f"frame {record.frame}"
    _write(canvas, clock, (area.x, middle), text, DARK, bold=True)
    left = area.x + max(_width_of(clock, text, bold=True), 4 * text) + text
    _write(canvas, frame, (left, middle), text, DARK)
    left += max(_width_of(frame, text), 5 * text) + text
    if alarming:
        _sign(canvas, "ALARM", (left, middle), text, INK)
    left += _width_of("ALARM", text, bold=True) + 2 * text
    right = area.x + area.width
    labelled = _fitting(list(record.detectors), alarming, right - left, text)
    omitted = len(record.detectors) - len(labelled)
    if omitted:
        more = f"+{omitted}"
        right -= _width_of(more, text) + text // 2
        _write(canvas, more, (right, middle), text, _DIM)
        right -= text // 2
    for name in reversed(labelled):
        label, colour = detector_named(name).label, detector_named(name).colour
        right -= _width_of(label, text, bold=True) + text
        if name in alarming:
            _sign(canvas, label, (right, middle), text, colour)
        else:
            ink = bgr(ink_of(colour))
            _write(canvas, label, (right + text // 2, middle), text, ink, bold=True)
        right -= text // 2


def _fitting(names: list[str], alarming: Sequence[str], room: int, text: int) -> list[str]:
    """Return the detectors whose labels fit into `room` pixels; those with an alarm come first."""
    widths = {
        name: _width_of(detector_named(name).label, text, bold=True) + text + text // 2
        for name in names
    }
    if sum(widths.values()) <= room:
        return names
    room -= _width_of(f"+{len(names)}", text) + text
    kept: set[str] = set()
    for name in sorted(names, key=lambda name: name not in alarming):
        if widths[name] > room:
            break
        room -= widths[name]
        kept.add(name)
    return [name for name in names if name in kept]


def _sign(canvas: Bgr, word: str, at: tuple[int, int], text: int, colour: str) -> None:
    """Write a word on a coloured ground."""
    x, middle = at
    half = round(0.75 * text)
    width = _width_of(word, text, bold=True) + text
    canvas[middle - half : middle + half, x : x + width] = bgr(colour)
    _write(canvas, word, (x + text // 2, middle), text, bgr(ink_on(colour)), bold=True)


def _grid(canvas: Bgr, layout: Layout, scale: _Scale) -> None:
    """Draw the horizontal lines with their names, and the line of the time axis."""
    plot = canvas[layout.plot.slices]
    for level, name in scale.levels.items():
        row, line = round(layout.level_row(10.0**level, scale)), layout.line if level == 0 else 1
        plot[row - line // 2 : row - line // 2 + line] = DARK if level == 0 else 215  # light grey
        x = layout.plot.x - layout.text // 2 - _width_of(name, layout.text)
        ink = DARK if level == 0 else _DIM
        _write(canvas, name, (x, layout.plot.y + row), layout.text, ink)
    plot[-1] = _DIM


def _tick_step(window_s: float) -> float:
    """Return the seconds between numbers of a time axis: 1, 2 or 5 times a power of ten."""
    least = window_s / 6  # at most six numbers
    power = 10.0 ** math.floor(math.log10(least))
    return next(step * power for step in (1, 2, 5, 10) if step * power >= least)


def draw_detections(
    canvas: Bgr, layout: Layout, detections: Iterable[Detection], colour: str
) -> None:
    """Draw the box of each detection in a colour, with the object's number above it.

    The lines lie just inside the edges of the box. While the object causes an alarm, they are twice
    as thick, and the label has the word ALARM. The first detection is drawn last, over the others.
    """
    picture, paint = canvas[layout.picture.slices], bgr(colour)
    scale_x, scale_y = layout.scale_x, layout.scale_y
    for detection in reversed(list(detections)):
        box = detection.box
        left, top = round(box.x * scale_x), round(box.y * scale_y)
        right = max(round((box.x + box.width) * scale_x), left + 1)
        bottom = max(round((box.y + box.height) * scale_y), top + 1)
        line = (2 if detection.alarm else 1) * layout.line
        # A dark rim makes the box visible on any picture.
        _draw_edges(picture, (left - 1, top - 1, right + 1, bottom + 1), line + 2, DARK)
        _draw_edges(picture, (left, top, right, bottom), line, paint)
        centre = round(detection.centre_x * scale_x), round(detection.centre_y * scale_y)
        for ink, width in ((DARK, layout.line + 2), (paint, layout.line)):
            cv2.drawMarker(picture, centre, ink, cv2.MARKER_CROSS, layout.text, width)
        _label(picture, (left, top), layout, detection, colour)


def _fill(picture: Bgr, edges: tuple[int, int, int, int], paint: _Paint) -> None:
    """Fill the columns from `left` up to `right`, without it, and the rows likewise."""
    left, top, right, bottom = (max(0, edge) for edge in edges)
    picture[top:bottom, left:right] = paint


def _draw_edges(picture: Bgr, edges: tuple[int, int, int, int], line: int, paint: _Paint) -> None:
    left, top, right, bottom = edges
    _fill(picture, (left, top, right, min(top + line, bottom)), paint)
    _fill(picture, (left, max(bottom - line, top), right, bottom), paint)
    _fill(picture, (left, top, min(left + line, right), bottom), paint)
    _fill(picture, (max(right - line, left), top, right, bottom), paint)


def _label(
    picture: Bgr, corner: tuple[int, int], layout: Layout, detection: Detection, colour: str
) -> None:
    """Write the label above the box, or inside the box if there is no room above it.

    In an alarm, the ground of the label has the detector's colour.
    """
    label = f"ALARM #{detection.identity}" if detection.alarm else f"#{detection.identity}"
    seconds = detection.time_to_contact_s
    if seconds is not None:  # an estimate, which is not more precise than these digits
        label += f"  contact in {seconds:.{1 if seconds >= 1 else 2}f} s"
    left, top = corner
    ground = bgr(colour) if detection.alarm else _WHITE
    ink = bgr(ink_on(colour) if detection.alarm else ink_of(colour))
    height = round(1.5 * layout.text)
    width = _width_of(label, layout.text, bold=True) + layout.text
    y = top - height if top >= height else max(0, top)
    x = max(0, min(left, picture.shape[1] - width))
    _fill(picture, (x, y, x + width, y + height), ground)
    origin = (x + layout.text // 2, y + height // 2)
    _write(picture, label, origin, layout.text, ink, bold=True)
