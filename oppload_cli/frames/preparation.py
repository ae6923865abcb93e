"""The chain from a frame of an input to a frame for the detectors: time, repeats, flow, RMO."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, NamedTuple

from oppload_cli.frame_times import seconds_of, ticks
from oppload_cli.frames.repeats import EXACT, Repeat
from oppload_cli.motion.flow import Flow, rmo_of
from oppload_cli.motion.rmo import RmoMetrics

if TYPE_CHECKING:
    from collections.abc import Sequence

    from oppload_cli.frame_times import FrameTimes
    from oppload_cli.frames.repeats import Repeats
    from oppload_cli.motion.flow import DenseFlow
    from oppload_cli.motion.rmo import RmoParams
    from oppload_cli.video.frames import Frame

# A cadence that the first 0.6 s prove, or those after a still start, counts from their first frame
# on. For this their frames are kept, but not more than 64 MB.
_FIRST, _FIRST_BYTES = ticks(0.6), 1 << 26


class Prepared(NamedTuple):
    """A frame with its corrected time, whether it is a repeat, and its motion."""

    frame: Frame
    repeat: Repeat
    flow: Flow | None  # None for the first picture and for repeats
    rmo: RmoMetrics | None
    # Whether it is not known yet if the frames before, all equal, were repeats or a scene at rest.
    undecided: bool = False
    # All frames before this one, if their repeats are now better known: the detectors begin again.
    again: Sequence[Prepared] = ()


class Preparation:
    """The work on a frame before the detectors: its time, repeats, flow and RMO.

    Parameters
    ----------
    times : FrameTimes
        Corrects the times of the frames.
    repeats : Repeats
        Recognises repeats.
    flow : DenseFlow or None
        Measures the flow; None if nothing needs it.
    rmo : RmoParams or None
        Parameters of radial motion opponency; None if it is not measured.
    """

    def __init__(
        self,
        times: FrameTimes,
        repeats: Repeats,
        flow: DenseFlow | None,
        rmo: RmoParams | None,
    ) -> None:
        self.times, self.repeats = times, repeats
        self._flow, self._rmo = flow, rmo
        # The first frames of the video, until a cadence is known or there are too many.
        self._first: list[Prepared] | None = []

    def step(self, frame: Frame) -> Prepared:
        """Take the next frame."""
        # An open video has corrected its times already; the times from a caller may be wrong.
        time = self.times.step(frame.time)
        if time != frame.time:
            frame = replace(frame, time=time)
        repeat = self.repeats.step(frame.luma, time)
        prepared = self._prepared(frame, repeat)
        return prepared if self._first is None else self._with_first_frames(self._first, prepared)

    def _prepared(self, frame: Frame, repeat: Repeat) -> Prepared:
        """Return a frame with its motion."""
        taken_s = seconds_of(frame.time + repeat.shift)
        if repeat.kind or not self._flow:
            if self._flow and not repeat.passed_over:
                self._flow.stand_still(taken_s)
            return Prepared(frame, repeat, None, RmoMetrics() if self._rmo else None)
        flow = self._flow.step(frame.luma, taken_s)
        rmo = rmo_of(flow, self._rmo) if flow and self._rmo else None
        return Prepared(frame, repeat, flow, rmo)

    def _with_first_frames(self, first: list[Prepared], latest: Prepared) -> Prepared:
        """Return the latest frame, and those before too if their repeats are better known now."""
        still = latest.repeat.kind == EXACT and not latest.repeat.passed_over
        if still and all(prepared.repeat.kind == EXACT for prepared in first[1:]):
            first.clear()  # the video begins at rest: the frames count from the last one at rest
        first.append(latest)
        passed = latest.frame.time - first[0].frame.time
        if passed > _FIRST or len(first) * latest.frame.luma.nbytes > _FIRST_BYTES:
            self._first = None
            return latest
        if self.repeats.is_cadence:
            self._first = None
            found = self.repeats.again([(seen.frame.luma, seen.frame.time) for seen in first])
            if self._flow:
                self._flow.reset()
            *again, latest = (
                self._prepared(seen.frame, repeat)
                for seen, repeat in zip(first, found, strict=True)
            )
            return latest._replace(again=again)
        # Which of them are pictures that the detectors got, and not taken for repeats.
        pictures = [not seen.repeat.passed_over for seen in first]
        if sum(pictures) == 2 and pictures[-1] and len(first) > 2:
            return latest._replace(undecided=True)
        two_in_a_row = sum(pictures) == 3 and all(pictures[-2:]) and len(first) > 3
        if two_in_a_row and not self.repeats.in_run:
            # No repeat follows the second picture: the first was not repeated, but stood still.
            self.repeats.forget_cadence()
            again = [
                seen._replace(repeat=seen.repeat._replace(passed_over=False)) for seen in first[:-1]
            ]
            return latest._replace(again=again)
        return latest
