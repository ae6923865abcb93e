"""The layers of one video: photoreceptors and DPC, computed once for all detectors.

This module decides which frames are compared with each other (``docs/time.md``). The equations
are in :mod:`oppload_cli.models.dpc`.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, field
from functools import partial
from typing import TYPE_CHECKING, Any, Generic, Protocol, TypeVar

import cv2
import numpy as np

from oppload_cli.errors import FrameError
from oppload_cli.models.dpc import (
    Kernels,
    PresynapticSums,
    check_frame,
    excitation,
    inhibition,
    photoreceptors,
    presynaptic_sums,
    rectified,
)
from oppload_cli.models.timebase import ROUNDING, Clock, nearly_one
from oppload_cli.motion.flow import DenseFlow

if TYPE_CHECKING:
    from collections.abc import Callable, Hashable

    from oppload_cli.models.dpc import DpcParams, Map
    from oppload_cli.motion.flow import Flow

# Two frames have ages nearest to an interval: one is too young, the other too old. The younger one
# is taken if it is too young by at most a quarter of the interval, and by at most 0.4 of the time
# by which the older one is too old. These limits were measured at 20 to 144 frames/s.
# Luminance interpolated between the two would halve the peaks at 50 frames/s: each change would
# overlap the change before it, and meet its inhibition.
_MOST_LACKING, _LACKING_OVER_EXCESS = 1 / 4, 0.4
# Frames kept per interval; at higher frame rates some are not kept. All are at 480 frames/s, even
# if their times are whole milliseconds.
_MOST_KEPT = 17
# Luminance above 2 in one of the first 3 frames is an error: the values are probably 0 to 255.
_CHECKED_FRAMES, _BRIGHTEST = 3, 2.0


@dataclass(slots=True, eq=False)
class _PastFrame:
    """What is kept of a frame (also of the latest one): its time and its P."""

    at: float  # time in intervals
    change: Map | None = None  # P; None if there was no frame to compare with
    mean: float = 0.0  # of P over the frame
    share: float = 1.0  # the wanted interval divided by the actual one
    before: _PastFrame | None = None  # the frame with which this one was compared
    # The means of P over squares, by the numbers of squares down and across.
    coarse: dict[tuple[int, int], Map] = field(default_factory=dict)


class Photoreceptors:
    """P of a video, now and one and two intervals ago.

    P(t) compares a frame with the youngest frame that is at least an interval old. But the frame
    after that one is taken instead if its age is nearly an interval, and much nearer to an interval
    than that of the older frame (``docs/time.md``). The time of the frame that is taken counts as
    one interval ago.

    Parameters
    ----------
    shape : tuple of int
        Height and width of the working frames.
    clock : Clock, optional
        Tells the time of the frames; without it each frame lasts one interval.

    Attributes
    ----------
    frames : int
        Number of frames taken.
    elapsed : float
        Intervals from the frame before to the latest one.
    """

    def __init__(self, shape: tuple[int, int], clock: Clock | None = None) -> None:
        self.shape = shape
        self._clock = clock or Clock()
        self._no_change: Map = np.zeros(shape, np.float32)
        self.reset()

    def reset(self) -> None:
        """Forget all frames: the next frame is frame 0."""
        self.frames = 0
        self.elapsed = 1.0
        self._now: float | None = None
        self._rest = 0.0  # time of the latest frame without any change
        self._latest = _PastFrame(0.0)
        self._lumas: deque[tuple[_PastFrame, Map]] = deque()

    @property
    def _series(self) -> tuple[_PastFrame | None, ...]:
        before = self._latest.before
        return self._latest, before, before.before if before else None

    @property
    def maps(self) -> list[Map]:
        """P now and one and two intervals ago, 0 to 1; zeros where no frames were compared."""
        return [
            self._no_change if frame is None or frame.change is None else frame.change
            for frame in self._series
        ]

    @property
    def share(self) -> float:
        """The wanted interval divided by the actual one; 1 if they differ by at most 3 %."""
        return self._latest.share

    @property
    def means(self) -> list[float]:
        """The mean of each of `maps` over the frame, 0 to 1.

        Changes add up over time. So each mean is scaled to the wanted length of the interval.
        """
        return [frame.mean * frame.share if frame else 0.0 for frame in self._series]

    @property
    def luma_change(self) -> float | None:
        """The mean of P(t), the first of `means`; None if there was no frame to compare with."""
        return None if self._latest.change is None else self.means[0]

    @property
    def ready(self) -> bool:
        """Whether P was measured now and one and two intervals ago."""
        return all(frame is not None and frame.change is not None for frame in self._series)

    @property
    def motion_lasts(self) -> bool:
        """Whether the luminance changed all the time in the three intervals of `maps`.

        False at the start of a video, and for three intervals after the complete scene was at rest.
        """
        oldest = self._series[-1]
        if oldest is None or oldest.before is None:
            return False
        return self._rest - oldest.before.at <= ROUNDING

    def coarse(self, shape: tuple[int, int]) -> list[Map]:
        """Return `maps` averaged over squares; `shape` is the number of squares down and across.

        The squares are as large as possible, and centred in the frame. If the frame has fewer
        pixels than squares, the maps are resized instead.
        """
        return [self._coarse_of(frame, shape) for frame in self._series]

    def _coarse_of(self, frame: _PastFrame | None, shape: tuple[int, int]) -> Map:
        if frame is None or frame.change is None:
            return np.zeros(shape, np.float32)
        if shape not in frame.coarse:  # it is needed for three intervals
            (height, width), (rows, columns) = self.shape, shape
            side = min(height // rows, width // columns)  # OpenCV is fast if all squares are equal
            if not side:  # the squares would be smaller than a pixel
                rows, columns, side = height, width, 1
            top, left = (height - rows * side) // 2, (width - columns * side) // 2
            squares = frame.change[top : top + rows * side, left : left + columns * side]
            means = cv2.resize(squares, shape[::-1], interpolation=cv2.INTER_AREA)
            frame.coarse[shape] = np.asarray(means)
        return frame.coarse[shape]

    def check(self, luma: Map) -> None:
        """Raise the FrameError that `step` would raise for this frame."""
        check_frame(luma, self.shape)
        if self.frames < _CHECKED_FRAMES and cv2.minMaxLoc(luma)[1] > _BRIGHTEST:
            raise FrameError(
                "a frame holds luminance above 1; L must be 0 to 1: divide 8-bit values by 255"
            )

    def step(self, luma: Map) -> bool:
        """Take the next frame, luminance of 0 to 1 as float32; return `ready`.

        Raises
        ------
        FrameError
            If the array is not float32 of the right shape, or has a value that is not finite. Also
            if one of the first three frames has a value above 2: its luminance is probably 0 to
            255. The frame is then not taken. Other values outside 0 to 1 are not checked.
        """
        self.check(luma)
        frame = self._latest = _PastFrame(self._clock.now(self._now))
        compared = self._compared_with(frame.at)
        if compared:
            frame.before, luma_before = compared
            frame.change = photoreceptors(luma, luma_before)
            frame.mean = cv2.mean(frame.change)[0]
            frame.share = nearly_one(1 / (frame.at - frame.before.at))
        # Before the first comparison the scene is at rest while frames equal the first one.
        if not (frame.mean if compared else self._lumas and np.any(luma != self._lumas[0][1])):
            self._rest = frame.at
        if self._now is not None:
            self.elapsed = nearly_one(frame.at - self._now)
        self._keep(frame, luma)
        self._now, self.frames = frame.at, self.frames + 1
        return self.ready

    def _compared_with(self, now: float) -> tuple[_PastFrame, Map] | None:
        """Return the frame to compare with, and its luminance; forget the luminance before it."""
        lumas, wanted = self._lumas, now - 1
        while len(lumas) > 1 and lumas[1][0].at <= wanted + ROUNDING:
            lumas.popleft()
        if not lumas:
            return None
        older, younger = lumas[0], lumas[min(1, len(lumas) - 1)]
        excess = wanted - older[0].at
        if excess < 0:
            # At the start no frame is old enough. Assume a frame one step before the first frame.
            younger, excess = older, excess + now - (self._now or 0.0)
        lacking = younger[0].at - wanted
        if lacking <= min(_MOST_LACKING, _LACKING_OVER_EXCESS * excess):
            return younger
        return older if older[0].at <= wanted + ROUNDING else None

    def _keep(self, frame: _PastFrame, luma: Map) -> None:
        """Keep a frame for later comparisons, unless it comes very soon after the last kept one."""
        if not self._lumas or frame.at - self._lumas[-1][0].at >= 1 / _MOST_KEPT:
            self._lumas.append((frame, luma.copy()))
        oldest = self._series[-1]
        if oldest and oldest.before:
            oldest.before.before = None  # no later frame needs it


class Dpc:
    """The distributed presynaptic connections over one video (``docs/model.md``, section 2).

    Parameters
    ----------
    params : DpcParams
        The DPC constants.
    axes : tuple of int
        Axes of the pathways, as directions phi in degrees: none, (45, 135) or (0, 90). Each axis
        has the pathways phi and phi + 180.
    photoreceptors : SharedLayer of Photoreceptors
        Access to the photoreceptors of the working frames.

    Attributes
    ----------
    kernels : Kernels
        The kernels of these constants and axes.
    sums : PresynapticSums
        S and S_phi of the latest frame, once `ready`; the next frame overwrites them.
    """

    def __init__(
        self,
        params: DpcParams,
        axes: tuple[int, ...],
        photoreceptors: SharedLayer[Photoreceptors],
    ) -> None:
        self._photoreceptors, self.axes = photoreceptors, axes
        self.kernels = Kernels.of(params, axes)
        self.sums = PresynapticSums.zeros(self.photoreceptors.shape, axes)

    @property
    def photoreceptors(self) -> Photoreceptors:
        """P of the latest frames."""
        return self._photoreceptors.layer

    @property
    def frames(self) -> int:
        """Number of frames taken."""
        return self._photoreceptors.frames

    @property
    def ready(self) -> bool:
        """Whether S was computed for the latest frame; it is from the third interval on."""
        return self.photoreceptors.ready

    @property
    def maps(self) -> dict[str, Map]:
        """P, E, I and S of the latest frame, and S_phi as ``S_45`` and so on.

        Each access to this property computes E, I and S.
        """
        p = self.photoreceptors.maps
        pathways = {f"S_{phi}": pathway for phi, pathway in self.sums.pathways.items()}
        e, i = excitation(p, self.kernels), inhibition(p, self.kernels)
        return {"P": p[0], "E": e, "I": i, "S": rectified(e, i), **pathways}

    def reset(self) -> None:
        """Forget all frames: the next frame is frame 0."""
        self._photoreceptors.reset()
        self.sums = PresynapticSums.zeros(self.photoreceptors.shape, self.axes)

    def step(self, luma: Map) -> bool:
        """Take the next frame; arguments, result and errors as `Photoreceptors.step`."""
        if self._photoreceptors.step(luma):
            presynaptic_sums(self.photoreceptors.maps, self.kernels, self.sums)
        return self.ready


class FlowLayer:
    """The flow of the latest frame: given, as by the pass over a video, or measured here.

    Parameters
    ----------
    clock : Clock
        Tells the time of the frames.
    """

    def __init__(self, clock: Clock) -> None:
        self._clock = clock
        self._search = DenseFlow(1 / clock.per_second)
        self.reset()

    def reset(self) -> None:
        """Forget all frames: the next frame is frame 0."""
        self._search.reset()
        self._now: float | None = None
        self._given, self._frames = False, 0
        self._latest: Flow | None = None

    def give(self, flow: Flow | None) -> None:
        """Set the flow of the next frame, None if it has none; from now on no flow is measured."""
        self._given, self._latest = True, flow

    def of(self, luma: Map, frames: int) -> Flow | None:
        """Return the flow of a frame; None for the first one.

        `frames` is the number of frames that the caller has taken before. The first detector that
        asks for a frame measures its flow, and the others get the same.
        """
        if not self._given and frames >= self._frames:
            self._now, self._frames = self._clock.now(self._now), frames + 1
            self._latest = self._search.step(luma, self._now / self._clock.per_second)
        return self._latest


# ---- Sharing -------------------------------------------------------------------------------


class _Layer(Protocol):
    """A layer that several detectors may share; it holds the values of the latest frame."""

    @property
    def frames(self) -> int: ...
    @property
    def ready(self) -> bool: ...
    def step(self, luma: Map) -> bool: ...
    def reset(self) -> None: ...


_AnyLayer = TypeVar("_AnyLayer", bound=_Layer)


class SharedLayer(Generic[_AnyLayer]):
    """One detector's access to a layer that several detectors share.

    Each detector has its own SharedLayer. It calls `step` at every frame, and then reads the values
    of `layer`. Only the first call of `step` in each frame computes the layer.
    """

    def __init__(self, layer: _AnyLayer) -> None:
        self.layer = layer
        self.frames = 0  # number of frames that this detector has taken

    def step(self, luma: Map) -> bool:
        """Take the next frame; tell whether the layer has values."""
        if self.frames == self.layer.frames:
            self.layer.step(luma)
        self.frames += 1
        return self.layer.ready

    def reset(self) -> None:
        """Forget all frames."""
        self.layer.reset()
        self.frames = 0


class Layers:
    """The layers of one video; each layer is computed once, even if several detectors use it.

    Detectors that share layers must be reset together, as ``DetectorBank.reset`` does.

    Parameters
    ----------
    shape : tuple of int
        Height and width of the working frames.
    clock : Clock, optional
        Tells the time of the frames; without it each frame lasts one interval.

    Examples
    --------
    >>> import oppload_cli as oppload
    >>> layers = oppload.Layers((48, 64))
    >>> one = oppload.Dlgmd((48, 64), layers=layers)
    >>> other = oppload.FrameDifference((48, 64), layers=layers)
    >>> one.layers is other.layers
    True
    """

    def __init__(self, shape: tuple[int, int], clock: Clock | None = None) -> None:
        self.shape = shape
        self.clock = clock or Clock()
        self._flow = FlowLayer(self.clock)
        self._dpcs: dict[DpcParams, list[Dpc]] = {}
        self._others: dict[Hashable, Any] = {}

    @property
    def time_s(self) -> float | None:
        """Presentation time in seconds of the current frame; None if it is not known."""
        return self.clock.time_s

    def flow(self) -> FlowLayer:
        """Return the flow, which a bank gives to its detectors or which they measure."""
        return self._flow

    def photoreceptors(self) -> SharedLayer[Photoreceptors]:
        """Return access to the photoreceptors."""
        return self.other("photoreceptors", partial(Photoreceptors, self.shape, self.clock))

    def dpc(self, params: DpcParams, axes: tuple[int, ...] = ()) -> SharedLayer[Dpc]:
        """Return access to the DPC layers of some constants and axes.

        Only the DPC constants of `params` are used. `axes` is as in :class:`Dpc`, and empty for a
        detector that needs S only.
        """
        constants = params.dpc()
        dpcs = self._dpcs.setdefault(constants, [])
        for dpc in dpcs:
            if axes in {(), dpc.axes}:
                return SharedLayer(dpc)
        dpcs.append(Dpc(constants, axes, self.photoreceptors()))
        return SharedLayer(dpcs[-1])

    def other(self, key: Hashable, make: Callable[[], _AnyLayer]) -> SharedLayer[_AnyLayer]:
        """Return access to a layer of another kind; `make` creates it at the first call for a key.

        The key must contain the kind of the layer and all its constants.
        """
        if key not in self._others:
            self._others[key] = make()
        return SharedLayer(self._others[key])
