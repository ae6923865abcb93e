"""Presentation times as the detectors and alarms need them: each after the one before."""

from __future__ import annotations

import math
from statistics import median
from typing import Any

USUAL_RATE = 30.0  # frames/s, where nothing is known
MOST_STEPS = 1 << 10  # of which the median is taken
CONTRADICTION = 0.1  # of the declared rate
LEAST_RATE = 9.0  # frames/s; below it few responses mean anything (docs/time.md)


class FrameTimes:
    """The presentation times of the frames of one input.

    Parameters
    ----------
    rate : float, optional
        Frames per second as the input declares them.
    """

    def __init__(self, rate: float | None = None) -> None:
        usable = rate is not None and math.isfinite(rate) and rate > 0
        self._declared = rate if usable else None
        self._step_s = 1 / (self._declared or USUAL_RATE)
        self._steps: list[float] = []
        self._first_s: float | None = None
        self._now_s = 0.0
        self._frames = self._wrong = 0
        self._first_wrong = 0
        self._longest_s = 0.0

    def step(self, time_s: float) -> float:
        """Take the time of the next frame.

        Parameters
        ----------
        time_s : float
            Presentation time in seconds, as the input gives it.

        Returns
        -------
        float
            The same, where it lies after that of the frame before; else the time before and
            the latest step that was right.
        """
        if self._first_s is None:
            self._first_s = self._now_s = time_s
        elif time_s > self._now_s:
            self._step_s = time_s - self._now_s
            self._longest_s = max(self._longest_s, self._step_s)
            if len(self._steps) < MOST_STEPS:
                self._steps.append(self._step_s)
            self._now_s = time_s
        else:
            if not self._wrong:
                self._first_wrong = self._frames
            self._wrong += 1
            self._now_s += self._step_s
        self._frames += 1
        return self._now_s

    @property
    def rate(self) -> float | None:
        """Frames per second by the median step of the first 1024 frames; None for one frame."""
        return 1 / median(self._steps) if self._steps else None

    def as_dict(self) -> dict[str, Any]:
        """Return the facts for the sidecar."""
        return {
            "frames_per_s": None if self.rate is None else round(self.rate, 3),
            "longest_step_s": round(self._longest_s, 6),
            "not_after_the_one_before": self._wrong,
            "notes": self.notes(),
        }

    def notes(self) -> list[str]:
        """Return remarks about the times, a sentence each."""
        notes = []
        if self._wrong:
            notes.append(
                f"{self._wrong} frames, the first one {self._first_wrong} after the first, have a "
                f"time that does not lie after that of the frame before; the models take them "
                f"one step of {self._step_s:.3g} s later"
            )
        rate = self.rate
        if rate is None:
            return notes
        if self._declared and abs(rate / self._declared - 1) > CONTRADICTION:
            notes.append(
                f"{self._declared:.4g} frames/s are declared, but the times of most frames say "
                f"{rate:.4g}; the times count"
            )
        if rate < LEAST_RATE:
            notes.append(
                f"{rate:.3g} frames/s are too few for the models, whose interval is 1/30 s; "
                f"below {LEAST_RATE:.0f} expect missed approaches"
            )
        return notes
