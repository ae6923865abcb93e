"""Recognises repeats: frames that show the same picture as the frame before."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from itertools import pairwise
from statistics import fmean, median
from typing import TYPE_CHECKING, ClassVar, NamedTuple

import cv2
import numpy as np

from oppload_cli.frame_times import TICKS_PER_S, in_digits, seconds_of, ticks
from oppload_cli.schema import Parameters, parameter

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    Luma = NDArray[np.float32]

_KEEP, EXACT, NEAR = "keep", "exact", "near"

_CELLS = 15  # cells across the shorter side of the frame; changes are averaged over each cell
_PICTURES = 3  # the usual change is the median change of the latest 3 pictures
_FRAMES = 6  # before a cadence the usual change is at least the second largest of the latest 6
_ENOUGH, _PROOF = 2, 2 * TICKS_PER_S  # a cadence is two proved runs within 2 s
# A camera that shakes nearly stops now and then. So of runs that end more than 6 frames apart, the
# changes must be below this part of the share that holds otherwise.
_DENSE, _DEEP = 6, 0.35
_RISE = 0.4  # after a repeat the change rises to at least this share of the usual change
_LENIENT = 2.0  # in a cadence one value of a repeat's change may be twice as large
_SPAN = 20  # a picture's even time uses the mean interval of the latest 20 pictures
_PULL = 10  # 1 / share of the way by which an even time moves into the frame before the picture
_LEAST_SHARE = 0.05  # least share of repeats among all frames for a remark
_STILL = TICKS_PER_S  # a camera never gives exactly the same picture for so long
_LEAST_RANGE = 0.04  # of luminance; with a smaller range rendered approaches alarm late or never


@dataclass(frozen=True, kw_only=True)
class RepeatParams(Parameters):
    """How repeats of a picture are handled (``docs/model.md``, "Repeats")."""

    _set: ClassVar[str] = "repeats"

    handling: str = parameter(
        NEAR,
        "which repeats the detectors do not get: 'exact' repeats only, 'near' repeats too, or none "
        "('keep')",
        choices=(EXACT, NEAR, _KEEP),
    )
    longest_s: float = parameter(
        0.18,
        "longest time for which one picture is repeated; if it lasts longer the scene is at rest",
        low=0,
        high=10,
    )
    share: float = parameter(
        0.35,
        "the change of a near repeat is below this share of the usual change",
        low=0,
        high=0.5,
    )
    least: float = parameter(
        0.008,
        "near repeats are recognised only if the usual change of some cell is at least this",
        unit="luminance",
        low=0,
        high=1,
    )


class Repeat(NamedTuple):
    """The relation of a frame to the picture before it."""

    kind: str = ""  # exact, near, or empty if the frame is not known to be a repeat
    passed_over: bool = False  # whether the detectors do not get the frame
    held: bool = False  # whether the row of its picture holds for the frame too, as in a cadence
    # Whether the frames that were passed over just before were no repeats: the scene is at rest.
    still_begins: bool = False
    # Time at which the picture was taken minus the presentation time, in ticks. It is not 0 only in
    # a cadence, because the pictures were taken at even intervals.
    shift: int = 0


class _Change(NamedTuple):
    """Change of a frame since the picture before it: the mean P, and the largest P of a cell.

    A re-encoded picture changes little in every cell. If a scene slows down, or an encoder saves
    bits, some cells still change as before.
    """

    mean: float
    largest: float

    def below(self, share: float, other: _Change, *, lenient: bool) -> bool:
        """Return whether both values are below a share of those of another change.

        An encoder may change much of a repeat, or one cell. So with `lenient` one value may reach
        twice this share, if the geometric mean of both is below the share.
        """
        limit = share * _LENIENT if lenient else share
        mean, largest = limit * other.mean, limit * other.largest
        product = share**2 * other.mean * other.largest
        return self.mean < mean and self.largest < largest and self.mean * self.largest < product


_NONE = _Change(0.0, 0.0)


class _Proof(NamedTuple):
    """A proved run: the change drops, and rises as steeply after it."""

    time: int  # of the frame after the run
    frame: int  # number of this frame
    length: int  # of the run, in frames
    deep: bool  # whether the change dropped so far that runs far apart count


class Repeats:
    """Distinguishes repeats by a video converter from scenes that slow down or stand still.

    In a file of 30 frames/s with content of 10 pictures/s each picture is repeated twice: the scene
    would seem to stand still and then to jump. Exact repeats are recognised at once. A near repeat
    was re-encoded; its change drops far below that of the latest pictures. A run is a row of frames
    that may be repeats; it is proved if the change after it rises as steeply as it dropped. Near
    repeats are recognised only in a cadence: after two proved runs that lie close together, or in
    which the change is very small. If the scene comes to rest in a cadence, the detectors get
    frames at the rate of the pictures, and after `longest_s` every frame. Only past frames are
    used, so that the first near repeats are not recognised; :meth:`again` recognises them
    afterwards.

    Source: ``docs/model.md``, "Repeats".

    Attributes
    ----------
    exact, near : int
        Number of frames recognised as exact and as near repeats.
    """

    def __init__(self, params: RepeatParams) -> None:
        self._params, self._longest_time = params, ticks(params.longest_s)
        self._shown: Luma | None = None  # the latest frame that the detectors got
        self._usual: deque[_Change] = deque(maxlen=_FRAMES)
        # The current run: its length, the largest change in it, and the time of its picture.
        self._run, self._largest, self._since = 0, _NONE, 0
        self._proofs: deque[_Proof] = deque()
        self._before = 0  # time of the frame before
        self._lasted: deque[int] = deque(maxlen=_SPAN)  # durations of pictures of a cadence
        self._picture = self._even = 0  # times: the latest picture was shown, was taken
        self._taken = 0  # time at which the picture of `_shown` was taken
        self._passed_over = False  # whether the detectors did not get the frame before
        self.exact = self.near = 0
        # The range of luminance of all frames so far; once it is large enough, it stays.
        self._darkest, self._brightest = 1.0, 0.0
        self._frames = 0
        self._new = 0  # time of the latest frame that was not an exact repeat
        # The cadences: numbers of pictures and repeats, and the time for which they were shown.
        self._pictures = self._repeats = 0
        self._cadence = 0

    @property
    def pictures_per_s(self) -> float | None:
        """Mean number of new pictures per second in the parts with a cadence.

        None if too few frames are repeats in a cadence (a share below `_LEAST_SHARE`).
        """
        if self._repeats < _LEAST_SHARE * self._frames or not self._cadence:
            return None
        return self._pictures / seconds_of(self._cadence)

    @property
    def still_s(self) -> float:
        """Time in seconds for which the picture has not changed; 0 if less than a second."""
        lasted = self._before - self._new
        return seconds_of(lasted) if lasted >= _STILL else 0.0

    def remarks(self) -> list[str]:
        """Return sentences if pictures are all the same or nearly uniform, or if they repeat."""
        if self.still_s and self.exact == self._frames - 1:
            return ["all pictures are the same, and nothing can cause an alarm; check the input"]
        remarks = []
        if self._brightest - self._darkest < _LEAST_RANGE and self._before >= _STILL:
            remarks.append(
                f"all luminance lies between {self._darkest:.3f} and {self._brightest:.3f} of 0 "
                "(black) to 1 (white): with so little contrast an alarm comes late or never; give "
                "pictures that use more of this range"
            )
        if pictures := self.pictures_per_s:
            about = in_digits(float(f"{pictures:.3g}"))
            rate = pictures * (1 + self._repeats / self._pictures)
            remarks.append(
                f"holds about {about} different pictures/s in {in_digits(rate)} frames/s; "
                "the repeats are left out"
            )
        return remarks

    def step(self, luma: Luma, time: int) -> Repeat:
        """Take the next frame: its luminance at the working size, 0 to 1, and its time in ticks.

        The array, float32 of shape (height, width), is kept, not copied.
        """
        exact_before = self.exact
        if self._brightest - self._darkest < _LEAST_RANGE:
            self._darkest = min(self._darkest, float(luma.min()))
            self._brightest = max(self._brightest, float(luma.max()))
        repeat = self._recognised(luma, time)
        self.exact += repeat.kind == EXACT
        if self.exact == exact_before:
            self._new = time
        self.near += repeat.kind == NEAR
        if not repeat.passed_over:
            self._shown = luma
            # Only new pictures get an even time: neither frames at rest nor, outside a cadence,
            # frames that may be repeats.
            if not repeat.kind and (self.is_cadence or not self._run):
                self._even = self._even_time(time)
                repeat = repeat._replace(shift=self._even - time)
                self._picture = time
            self._taken = time + repeat.shift
        self._frames += 1
        self._passed_over = repeat.passed_over
        self._before = time
        return repeat

    def again(self, first: Sequence[tuple[Luma, int]]) -> list[Repeat]:
        """Recognise the repeats among the first frames once more, by the cadence that they proved.

        `first` holds luminance and time of all frames so far. `exact` and `near` do not change.
        """
        counts = self.exact, self.near, self._frames
        for _ in range(2):  # the first pass finds the lengths of the runs, which the second uses
            proofs, lasted = len(self._proofs), len(self._lasted)
            self._shown, self._run, self._frames = None, 0, 0
            self._pictures = self._repeats = 0
            self._cadence = 0
            repeats = [self.step(luma, time) for luma, time in first]
            if len(self._proofs) >= proofs + _ENOUGH:
                self._proofs = deque(list(self._proofs)[proofs:])
                self._lasted = deque(list(self._lasted)[lasted:], _SPAN)
        self.exact, self.near, self._frames = counts
        return repeats

    def forget_cadence(self) -> None:
        """Forget all proved runs: the first picture was not repeated, but stood still."""
        self._proofs.clear()

    def _even_time(self, time: int) -> int:
        """Return the time at which the picture was taken that a frame shows first.

        A file of 30 frames/s with 12 pictures/s shows each picture for two or three frames. So the
        pictures begin at uneven times. But they were taken at even intervals, each less than a
        frame before it is shown, or after two conversions up to a frame earlier or later.
        """
        lasted = time - self._picture
        if not self._proofs:
            self._lasted.clear()
        # Before a cadence only a proved run shows how long its picture lasted.
        known = self.is_cadence or (bool(self._proofs) and self._proofs[-1].time == time)
        if not known or not 0 < lasted <= self._longest_time:
            return time
        self._lasted.append(lasted)
        if not self.is_cadence:
            return time
        even = self._even + round(fmean(self._lasted))
        frame, late = time - self._before, time - even
        even += (max(late - frame, 0) + min(late, 0)) // _PULL
        earliest = max(time - 2 * frame, self._taken + frame // 2)
        return min(max(even, earliest), time + frame)

    def _recognised(self, luma: Luma, time: int) -> Repeat:
        if self._shown is None:
            return Repeat()
        handling = self._params.handling
        change = _change(luma, self._shown) if handling == NEAR else None
        # The cells may not reach the border of the frame.
        exact = not (change and change.largest) and np.array_equal(luma, self._shown)
        if handling == _KEEP:
            self.exact += exact
            return Repeat()
        while self._proofs and time - self._proofs[0].time > _PROOF:
            self._proofs.popleft()
        if not exact and not (change and self._is_drop(change)):
            self._end_run(change, time)
            return Repeat()
        if not self._run:
            self._largest, self._since = _NONE, self._before
        self._run += 1
        self._largest = _Change(*map(max, self._largest, change or _NONE))
        if time - self._since > self._longest_time:
            return self._at_rest(exact=exact)
        held = self.is_cadence and self._run % (1 + self._longest) > 0
        kind = EXACT if exact else NEAR if held else ""
        return Repeat(kind, bool(kind), held)

    @property
    def is_cadence(self) -> bool:
        """Whether the latest two seconds have a cadence: two deep runs, or two close together."""
        return sum(proof.deep for proof in self._proofs) >= _ENOUGH or any(
            later.frame - earlier.frame <= _DENSE for earlier, later in pairwise(self._proofs)
        )

    @property
    def in_run(self) -> bool:
        """Whether the latest frame may be a repeat."""
        return self._run > 0

    @property
    def _longest(self) -> int:
        """Most repeats in a row in this cadence: pictures at even intervals differ by at most 1."""
        *_, second, longest = sorted(proof.length for proof in self._proofs)
        return min(longest, second + 1)

    def _is_drop(self, change: _Change) -> bool:
        usual = self._usual_change()
        return usual.largest >= self._params.least and change.below(
            self._params.share, usual, lenient=self.is_cadence
        )

    def _usual_change(self) -> _Change:
        if not self._usual:
            return _NONE
        changes = list(zip(*self._usual, strict=True))
        usual = [median(values[-_PICTURES:]) for values in changes]
        if not self.is_cadence:  # most of these frames may be repeats
            second_largest = [sorted(values)[-2:][0] for values in changes]
            usual = list(map(max, usual, second_largest))
        return _Change(*usual)

    def _end_run(self, change: _Change | None, time: int) -> None:
        """Take a new picture; if the change rises as steeply as it dropped, the run is proved."""
        proved = self._run > 0 and self._before - self._since <= self._longest_time
        deep = True
        if change is not None:  # with `EXACT` a run needs no rise
            usual = self._usual_change()
            proved &= change.largest > (_RISE * usual.largest or self._params.least)
            proved &= self._largest.below(self._params.share, change, lenient=True)
            deep = self._largest.below(_DEEP * self._params.share, change, lenient=True)
            self._usual.append(change)
        # Where frames are dropped the usual frame rate is too high, so the time counts; not pauses.
        pause = time - self._before > self._longest_time
        if self.is_cadence and (proved or not self._run) and not pause:
            self._pictures += 1
            self._repeats += self._run
            self._cadence += time - (self._since if self._run else self._before)
        if proved:
            self._proofs.append(_Proof(time, self._frames, self._run, deep))
        self._run = 0

    def _at_rest(self, *, exact: bool) -> Repeat:
        """Take a frame of a run that is too long for repeats: the scene is at rest."""
        if exact:
            return Repeat(EXACT, still_begins=self._passed_over)
        self._usual.clear()
        self._run = 0
        return Repeat()


def _change(luma: Luma, earlier: Luma) -> _Change:
    """Return the change from `earlier` to `luma`, with OpenCV's fast mean over equal cells."""
    height, width = luma.shape
    side = max(1, min(height, width) // _CELLS)
    rows, columns = height // side, width // side
    complete = cv2.absdiff(luma, earlier)[: rows * side, : columns * side]
    cells = cv2.resize(complete, (columns, rows), interpolation=cv2.INTER_AREA)
    return _Change(float(cells.mean()), float(cells.max()))
