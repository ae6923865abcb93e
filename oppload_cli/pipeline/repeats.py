"""Repeats: pictures that a converter put into a file more than once."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from statistics import median
from typing import TYPE_CHECKING, NamedTuple

import cv2
import numpy as np

from oppload_cli.schema import Parameters, parameter

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Luma = NDArray[np.float32]

KEEP, EXACT, NEAR = "keep", "exact", "near"

_SOME_ROWS = 16  # every so many rows are compared first
_CELLS = 15  # across the shorter side of the frame; a change is averaged over each
_PICTURES = 3  # the median change of the latest ones is the usual change
_FRAMES = 6  # changes remembered; before a cadence the second largest is that of a new picture
_ENOUGH, _PROOF_S = 2, 2.0  # drops and rises within so many seconds that make a cadence
_BACK = 0.4  # share of the usual change to which the change rises after a repeat
_LENIENT = 2.0  # in a cadence one of its two changes may be so many times larger
_SPAN = 20  # pictures over which their mean interval is taken
_PULL = 0.1  # share by which an even time moves towards the frame before its picture is shown
_WORTH_TELLING = 0.05  # share of repeats among all frames
_STILL_S = 1.0  # so long no camera gives the same picture to the last bit


@dataclass(frozen=True, kw_only=True)
class RepeatParams(Parameters):
    """How repeats of a picture are taken (``docs/model.md``, "Repeats")."""

    handling: str = parameter(
        NEAR,
        "repeats that the detectors do not see: 'exact' ones only, 'near' ones too, or none "
        "('keep')",
        choices=(EXACT, NEAR, KEEP),
    )
    longest_s: float = parameter(
        0.18,
        "longest time for which one picture is repeated; a longer one is a scene at rest",
        unit="s",
        low=0,
        high=10,
    )
    share: float = parameter(
        0.25,
        "a near repeat changes less than this share of the usual change",
        low=0,
        high=0.5,
    )
    least: float = parameter(
        0.008,
        "repeats are recognised only where the usual change of some cell is above this",
        unit="luminance",
        low=0,
        high=1,
    )


class Repeat(NamedTuple):
    """The relation of a frame to the picture before it."""

    kind: str = ""  # exact, near, or empty where it is not known to be a repeat
    passed_over: bool = False  # the detectors do not see it
    held: bool = False  # it belongs to a cadence: the answer to its picture still holds
    still_begins: bool = False  # the frames passed over before were no repeats but a still scene
    # From the presentation time to when the picture was taken, in seconds: not 0 in a cadence,
    # where pictures were taken at even intervals.
    shift_s: float = 0.0


class _Change(NamedTuple):
    """Mean P of a frame against the picture shown before it: over the frame, and largest of a cell.

    A re-encoded picture changes little in every cell. Where a scene slows
    down, or an encoder spares bits, some cells still change as before.
    """

    mean: float
    largest: float

    def below(self, share: float, other: _Change, *, lenient: bool) -> bool:
        """Tell whether both changes are less than a share of the others.

        In a cadence (`lenient`) an encoder may have re-encoded much of a repeat, or one cell
        of it: then their geometric mean counts.
        """
        each = share * _LENIENT if lenient else share
        mean, largest = each * other.mean, each * other.largest
        product = share**2 * other.mean * other.largest
        return self.mean < mean and self.largest < largest and self.mean * self.largest < product


_NONE = _Change(0.0, 0.0)


class Repeats:
    """Distinguishes pictures that a converter repeated from scenes that slow down or stand still.

    Content of 10 frames/s in a file of 30 frames/s repeats each picture twice: the detectors would
    see it stand still, and then jump. Exact repeats are recognised at once. A near repeat, which
    the encoder has re-encoded, is a drop of the change far below that of the latest pictures; it is
    recognised only in a cadence: when such drops have ended `_ENOUGH` times with an equally steep
    rise. Where the scene comes to rest in a cadence, the detectors see it at the rate of the
    pictures, and after `longest_s` every frame. All of this uses past frames only, so that the
    first near repeats of a video are not recognised.

    Attributes
    ----------
    exact, near : int
        How many frames were recognised as repeats.
    """

    def __init__(self, params: RepeatParams) -> None:
        self._params = params
        self._shown: Luma | None = None  # the latest frame that the detectors saw
        self._usual: deque[_Change] = deque(maxlen=_FRAMES)
        # The frames in a row that may be repeats: how many, the largest change of them, and
        # when the picture was shown that they may repeat.
        self._run, self._worst, self._since_s = 0, _NONE, 0.0
        self._proofs: deque[tuple[float, int]] = deque()  # times and lengths of proved runs
        self._before_s = 0.0
        self._lasted_s: deque[float] = deque(maxlen=_SPAN)  # of pictures of a cadence
        self._picture_s = self._even_s = 0.0  # when the latest one was shown, and was taken
        self._told_s = 0.0  # when the latest frame that the detectors saw was taken
        self._passed_over = False
        self.exact = self.near = 0
        self._frames = 0
        self._new_s = 0.0  # when a picture last differed from the one before
        self._pictures = self._repeats = 0  # while there is a cadence

    def pictures_per_s(self, frame_rate: float | None) -> float | None:
        """Return how many new pictures a second of moving scenes shows, where a cadence is found.

        Parameters
        ----------
        frame_rate : float or None
            Frames per second by the times of the frames, where they are known.

        Returns
        -------
        float or None
            Above 0; the mean over those parts of the video that have a cadence. None if fewer
            than `_WORTH_TELLING` of all frames are repeats in a cadence.
        """
        few = self._repeats < _WORTH_TELLING * self._frames or not self._repeats
        if few or not frame_rate:
            return None
        return frame_rate * self._pictures / (self._pictures + self._repeats)

    @property
    def still_s(self) -> float:
        """For how long all pictures have been the same, in seconds; 0 below a second."""
        lasted_s = self._before_s - self._new_s
        return lasted_s if lasted_s >= _STILL_S else 0.0

    def remarks(self, frame_rate: float | None) -> list[str]:
        """Return a remark, a sentence, on pictures that are all the same, or repeat in a cadence.

        The frame rate is that of :meth:`pictures_per_s`.
        """
        if self.still_s and self.exact == self._frames - 1:
            return ["all pictures are the same, and nothing can cause an alarm; check the input"]
        pictures = self.pictures_per_s(frame_rate)
        if pictures is None:
            return []
        return [
            f"holds about {pictures:.3g} different pictures/s in {frame_rate:.4g} frames/s; the "
            "repeats are left out"
        ]

    def step(self, luma: Luma, time_s: float) -> Repeat:
        """Take the next frame: its luminance at the working size, 0 to 1, and its time in seconds.

        The array, float32 of shape (height, width), is kept, not copied.
        """
        known = self.exact
        repeat = self._recognised(luma, time_s)
        self.exact += repeat.kind == EXACT
        if self.exact == known:
            self._new_s = time_s
        self.near += repeat.kind == NEAR
        if not repeat.passed_over:
            self._shown = luma
            # A frame at rest is no picture, and outside a cadence a drop may be a repeat.
            if not repeat.kind and (self._is_cadence or not self._run):
                self._even_s = self._evenly(time_s)
                repeat = repeat._replace(shift_s=self._even_s - time_s)
                self._picture_s = time_s
            self._told_s = time_s + repeat.shift_s
        self._frames += 1
        self._passed_over = repeat.passed_over
        self._before_s = time_s
        return repeat

    def _evenly(self, time_s: float) -> float:
        """Return when a picture was taken.

        A file of 30 frames/s shows each of 12 pictures/s for two or three frames: they begin
        unevenly, but were taken at even intervals, each less than a frame before it is shown.
        Where one converter followed another it may be up to a frame more on either side.
        """
        lasted_s = time_s - self._picture_s
        if not self._proofs:
            self._lasted_s.clear()
        # Before the cadence only the picture of a proved run is known to be complete.
        known = self._is_cadence or (bool(self._proofs) and self._proofs[-1][0] == time_s)
        if not known or not 0 < lasted_s <= self._params.longest_s:
            return time_s
        self._lasted_s.append(lasted_s)
        if not self._is_cadence:
            return time_s
        even_s = self._even_s + sum(self._lasted_s) / len(self._lasted_s)
        frame_s, late_s = time_s - self._before_s, time_s - even_s
        even_s += _PULL * (max(late_s - frame_s, 0) + min(late_s, 0))
        earliest_s = max(time_s - 2 * frame_s, self._told_s + frame_s / 2)
        return min(max(even_s, earliest_s), time_s + frame_s)

    def _recognised(self, luma: Luma, time_s: float) -> Repeat:
        if self._shown is None:
            return Repeat()
        exact = _equal(luma, self._shown)
        handling = self._params.handling
        if handling == KEEP:
            self.exact += exact
            return Repeat()
        change = _NONE if exact else _change(luma, self._shown) if handling == NEAR else None
        while self._proofs and time_s - self._proofs[0][0] > _PROOF_S:
            self._proofs.popleft()
        if not exact and not (change and self._is_drop(change)):
            self._end_run(change, time_s)
            return Repeat()
        if not self._run:
            self._worst, self._since_s = _NONE, self._before_s
        self._run += 1
        self._worst = _Change(*map(max, self._worst, change or _NONE))
        if time_s - self._since_s > self._params.longest_s:
            return self._at_rest(exact=exact)
        held = self._is_cadence and self._run % (1 + self._longest) > 0
        kind = EXACT if exact else NEAR if held else ""
        return Repeat(kind, bool(kind), held)

    @property
    def _is_cadence(self) -> bool:
        return len(self._proofs) >= _ENOUGH

    @property
    def _longest(self) -> int:
        """The most repeats in a row in this cadence: the frame after them is a new picture.

        Pictures at even intervals are repeated equally often, or once more.
        """
        *_, second, longest = sorted(run for _, run in self._proofs)
        return min(longest, second + 1)

    def _is_drop(self, change: _Change) -> bool:
        usual = self._usual_change()
        return usual.largest >= self._params.least and change.below(
            self._params.share, usual, lenient=self._is_cadence
        )

    def _usual_change(self) -> _Change:
        if not self._usual:
            return _NONE
        changes = list(zip(*self._usual, strict=True))
        usual = [median(each[-_PICTURES:]) for each in changes]
        if not self._is_cadence:  # most of these frames may be repeats
            second = [sorted(each)[-2:][0] for each in changes]
            usual = list(map(max, usual, second))
        return _Change(*usual)

    def _end_run(self, change: _Change | None, time_s: float) -> None:
        """Take a new picture; the run before it is proved if the change rises as it dropped."""
        proved = self._run > 0 and self._before_s - self._since_s <= self._params.longest_s
        if change is not None:  # exact repeats prove themselves
            usual = self._usual_change()
            proved &= change.largest > _BACK * usual.largest
            proved &= self._worst.below(self._params.share, change, lenient=True)
            self._usual.append(change)
        if self._is_cadence:
            self._pictures += 1
            self._repeats += self._run * proved
        if proved:
            self._proofs.append((time_s, self._run))
        self._run = 0

    def _at_rest(self, *, exact: bool) -> Repeat:
        """Take a frame of a run that is too long for repeats."""
        if exact:
            return Repeat(EXACT, still_begins=self._passed_over)
        self._usual.clear()
        self._run = 0
        return Repeat()


def _equal(one: Luma, other: Luma) -> bool:
    """Compare frames; a few rows tell most of them apart."""
    return np.array_equal(one[::_SOME_ROWS], other[::_SOME_ROWS]) and np.array_equal(one, other)


def _change(one: Luma, other: Luma) -> _Change:
    """Average the change over cells as large as fit; OpenCV is fast where they are equal."""
    height, width = one.shape
    side = max(1, min(height, width) // _CELLS)
    rows, columns = height // side, width // side
    complete = cv2.absdiff(one, other)[: rows * side, : columns * side]
    cells = cv2.resize(complete, (columns, rows), interpolation=cv2.INTER_AREA)
    return _Change(float(cells.mean()), float(cells.max()))
