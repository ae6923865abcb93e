"""Small drawings of the page: responses over a clip, and boxes over a frame, as SVG."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from oppload_cli.detection.evaluation.series import Seen
    from oppload_cli.evaluation.stills import Moment

WIDTH, HEIGHT = 300, 56
HIGHEST = 3.0  # times the threshold; what is above is cut


def strip(seen: Seen, moment: Moment) -> str:
    """Return a contender's responses over a whole clip.

    Parameters
    ----------
    seen : Seen
        The clip.
    moment : Moment
        The frame to mark, the contender and its threshold.

    Returns
    -------
    str
        SVG: the approach shaded, the threshold dashed, the frame marked.
    """
    response = np.nan_to_num(seen.answers[moment.contender].response)
    top = float(response.max()) or 1.0
    threshold = moment.threshold
    if threshold > 0:
        top = min(max(top, 1.2 * threshold), HIGHEST * threshold)
    across = WIDTH / len(seen)
    parts = []
    start, stop = seen.approach
    if stop > start:
        parts.append(
            f'<rect class="approach" x="{start * across:.1f}" y="0" '
            f'width="{(stop - start) * across:.1f}" height="{HEIGHT}"/>'
        )
    points = " ".join(
        f"{(frame + 0.5) * across:.1f},{HEIGHT - 2 - (HEIGHT - 6) * min(value / top, 1.0):.1f}"
        for frame, value in _thinned(response)
    )
    parts.append(f'<polyline class="response" points="{points}"/>')
    if not math.isnan(threshold):
        y = HEIGHT - 2 - (HEIGHT - 6) * min(threshold / top, 1.0)
        parts.append(f'<line class="threshold" x1="0" x2="{WIDTH}" y1="{y:.1f}" y2="{y:.1f}"/>')
    x = (moment.frame + 0.5) * across
    parts.append(f'<line class="now" x1="{x:.1f}" x2="{x:.1f}" y1="0" y2="{HEIGHT}"/>')
    return f'<svg class="strip" viewBox="0 0 {WIDTH} {HEIGHT}">{"".join(parts)}</svg>'


def overlay(seen: Seen, moment: Moment) -> str:
    """Return the field of the winning unit, and the labelled box, over a frame.

    Parameters
    ----------
    seen : Seen
        The clip.
    moment : Moment
        The frame and the contender.

    Returns
    -------
    str
        SVG in source pixels.
    """
    parts = []
    if moment.frame in seen.label.boxes:
        parts.append(_rectangle("label", *seen.label.boxes[moment.frame]))
    place = seen.answers[moment.contender].place
    if place is not None and np.isfinite(place[moment.frame]).all():
        left, top, width, height = map(float, place[moment.frame])
        parts.append(_rectangle("winner", left, top, width, height))
        x, y, arm = left + width / 2, top + height / 2, seen.height / 30
        for dx, dy in ((arm, 0.0), (0.0, arm)):
            parts.append(
                f'<line class="winner" x1="{x - dx:.1f}" x2="{x + dx:.1f}" '
                f'y1="{y - dy:.1f}" y2="{y + dy:.1f}"/>'
            )
    return (
        f'<svg class="boxes" viewBox="0 0 {seen.width} {seen.height}" '
        f'preserveAspectRatio="none">{"".join(parts)}</svg>'
    )


def _rectangle(kind: str, left: float, top: float, width: float, height: float) -> str:
    return (
        f'<rect class="{kind}" x="{left:.1f}" y="{top:.1f}" '
        f'width="{width:.1f}" height="{height:.1f}"/>'
    )


def _thinned(response: np.ndarray) -> list[tuple[int, float]]:
    """Return frames and responses, the largest of every few where there are very many."""
    step = max(1, math.ceil(len(response) / (2 * WIDTH)))
    starts = range(0, len(response), step)
    at = [start + int(response[start : start + step].argmax()) for start in starts]
    return [(frame, float(response[frame])) for frame in at]
