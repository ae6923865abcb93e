"""What the response curves show: the last seconds of each model."""

from __future__ import annotations

from collections import deque
from typing import TYPE_CHECKING, NamedTuple

if TYPE_CHECKING:
    from collections.abc import Sequence

    from oppload_cli.results.record import FrameRecord

WINDOW_S = 5.0
LEAST_WINDOW_S = 0.1
MOST_COPIES = 5  # repeats in a row that are a copied frame, and no still scene
MOST_FRAMES = 1 << 16  # kept, in case times stand still


class Point(NamedTuple):
    """One frame of one model.

    Attributes
    ----------
    time_s : float
        Presentation time.
    ratio : float or None
        Response over the alarm's threshold; None where there is none.
    alarm : bool
        Whether the alarm is on.
    """

    time_s: float
    ratio: float | None
    alarm: bool


class History:
    """The last seconds of each model's response relative to its alarm threshold.

    Parameters
    ----------
    models : sequence of str
        Their names.
    duration_s : float or None
        Of the whole video where it is known: a short one is shown as a whole.

    Attributes
    ----------
    points : dict of str to deque of Point
        By model, in the order of the frames.
    """

    def __init__(self, models: Sequence[str], duration_s: float | None = None) -> None:
        self.points: dict[str, deque[Point]] = {name: deque(maxlen=MOST_FRAMES) for name in models}
        self.window_s = max(LEAST_WINDOW_S, min(WINDOW_S, duration_s or WINDOW_S))
        self._first_s: float | None = None
        self._now_s = 0.0
        self._copies = 0

    def add(self, record: FrameRecord) -> None:
        """Take the next frame.

        Parameters
        ----------
        record : FrameRecord
            Copies of a frame are passed over: the models did not see them.
        """
        self._first_s = record.time_s if self._first_s is None else self._first_s
        self._now_s = record.time_s
        self._copies = self._copies + 1 if record.repeat else 0
        if not 0 < self._copies <= MOST_COPIES:
            for name, points in self.points.items():
                alarm = record.alarms.get(name, False)
                points.append(Point(record.time_s, ratio_of(record, name), alarm))
        for points in self.points.values():
            # One point more than is seen: the curve comes from beyond the edge.
            while len(points) > 1 and points[1].time_s < self.start_s:
                points.popleft()

    @property
    def start_s(self) -> float:
        """Time at the left edge: it stays until the window is full."""
        return max(self._first_s or 0.0, self._now_s - self.window_s)


def ratio_of(record: FrameRecord, model: str) -> float | None:
    """Return a model's response relative to its alarm threshold.

    Parameters
    ----------
    record : FrameRecord
        The frame.
    model : str
        The model's name.

    Returns
    -------
    float or None
        At least 0; above 1 the frame counts for the alarm. None during warm-up and
        where the threshold is 0.
    """
    response, threshold = record.responses.get(model), record.thresholds.get(model)
    if response is None or not threshold:
        return None
    return response.response / threshold
