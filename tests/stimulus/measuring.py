"""Small stimuli, and shapes measured in their frames, to compare them with the ground truth."""

from __future__ import annotations

import dataclasses
import math
from typing import TYPE_CHECKING, Any

import cv2
import numpy as np

from oppload_cli.stimulus import (
    Display,
    Effects,
    Object,
    Protocol,
    Renderer,
    Timing,
    frame_truth,
)
from oppload_cli.stimulus.geometry import Projection
from oppload_cli.stimulus.kinematics import pose_of
from oppload_cli.stimulus.objects import SIZED

if TYPE_CHECKING:
    from collections.abc import Iterable

    from numpy.typing import NDArray

    Floats = NDArray[np.float64]

# below this many pixels a thresholded shape has no measurable size
LEAST_PX = 4.0
# full pixels would round both sides of an upright square the same way, up to a pixel in all
FINE = 4


def made(
    *objects: Object, seconds: float = 1.0, display: dict[str, Any] | None = None, **tables: Any
) -> Protocol:
    """Return a stimulus of 200 x 180 px at 5 px/deg, unless `display` says otherwise."""
    usual = {} if display and "field_of_view_deg" in display else {"pixels_per_degree": 5}
    screen = Display(**{"width": 200, "height": 180, **usual, **(display or {})})
    values = {"timing": Timing(motion_s=seconds), **tables}
    return Protocol(display=screen, objects=objects, **values)


def worst_errors(protocol: Protocol, frames: Iterable[int]) -> tuple[float, float, int]:
    """Return the largest error of size and of centre in pixels, and the number of measurements."""
    size_error = centre_error = 0.0
    count = 0
    for obj in protocol.objects:
        if obj.kind not in SIZED:
            continue
        alone = _alone(protocol, obj)
        renderer = Renderer(alone)
        for frame in frames:
            truth = frame_truth(alone, frame).objects[0]
            stated = _size_px(alone, truth.angular_size_deg or 0.0)
            width = _size_px(alone, obj.width_deg or 1e9)
            grey = renderer.grey(frame)
            rim = min(side.min() for side in (grey[0], grey[-1], grey[:, 0], grey[:, -1])) < 127.5
            if min(stated, width) < LEAST_PX or rim or not truth.visible:
                continue
            columns, rows = _thresholded(grey)
            if not columns.size:
                # the shape must be outside the display; otherwise its error is without bound
                x_share = truth.centre_x_px / alone.display.width
                y_share = truth.centre_y_px / alone.display.height
                inside = 0 <= x_share <= 1 and 0 <= y_share <= 1
                size_error = math.inf if inside else size_error
                continue
            measured = _size_of(obj.kind, columns.size / FINE**2, width)
            if obj.kind == "bar":
                pose = pose_of(alone, alone.objects[0], alone.time_of(frame))
                measured = _length_along(columns, rows, math.radians(pose.orientation_deg))
            size_error = max(size_error, abs(measured - stated))
            x, y = columns.mean() + 0.5 / FINE, rows.mean() + 0.5 / FINE
            off = math.hypot(x - truth.centre_x_px, y - truth.centre_y_px)
            centre_error = max(centre_error, off)
            count += 1
    return size_error, centre_error, count


def _thresholded(grey: NDArray[np.uint8]) -> tuple[Floats, Floats]:
    """Return x and y of what is below half the contrast, interpolated between pixels."""
    x, y, width, height = cv2.boundingRect(255 - grey)
    if not width:
        return np.empty(0), np.empty(0)
    left, top = max(0, x - 2), max(0, y - 2)  # with the white pixels from which it interpolates
    part = grey[top : y + height + 2, left : x + width + 2].astype(np.float32)
    rows, columns = np.nonzero(cv2.resize(part, None, fx=FINE, fy=FINE) < 127.5)
    return columns / FINE + left, rows / FINE + top


def _alone(protocol: Protocol, obj: Object) -> Protocol:
    """Put one object, black, on white: nothing else in the picture."""
    kind = "disk" if obj.kind == "patch" else obj.kind
    contrast = 1.0 if kind != obj.kind else obj.contrast
    black = dataclasses.replace(
        obj, kind=kind, luminance=0.0, brightness=None, contrast=contrast, exponent=1.0
    )
    display = dataclasses.replace(protocol.display, background=1.0)
    return dataclasses.replace(protocol, objects=(black,), display=display, effects=Effects())


def _size_px(protocol: Protocol, angle_deg: float) -> float:
    return 2 * Projection.of(protocol.display).reach(angle_deg / 2)


def _length_along(x: Floats, y: Floats, angle: float) -> float:
    """Length of an evenly filled bar, from the spread of its pixels along its axis."""
    return math.sqrt(12 * float(np.var(x * math.cos(angle) - y * math.sin(angle))))


def _size_of(kind: str, area: float, width: float) -> float:
    """Size of a shape of this area."""
    if kind == "square":
        return math.sqrt(area)
    if kind == "cross":
        return (area / width + width) / 2 if area > width**2 else math.sqrt(area)
    if kind == "ring" and area > math.pi * width**2:
        return area / (math.pi * width) + width
    return 2 * math.sqrt(area / math.pi)
