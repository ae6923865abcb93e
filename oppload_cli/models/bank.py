"""A bank that runs several detectors over one video."""

from __future__ import annotations

import math
import traceback
from collections.abc import Iterable
from contextlib import contextmanager
from dataclasses import replace
from typing import TYPE_CHECKING, Any, cast

import numpy as np

from oppload_cli.errors import DetectorError, FrameError, OpploadError, ParameterError
from oppload_cli.models.detector import Box, UnitMaps, checked_shape
from oppload_cli.models.layers import Layers
from oppload_cli.models.registry import detector_of, is_of_package
from oppload_cli.models.timebase import REFERENCE_INTERVAL, ROUNDING, Clock, TimeParams

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, Sequence

    from oppload_cli.models.detector import Detector, Response
    from oppload_cli.models.dpc import Map
    from oppload_cli.motion.flow import Flow
    from oppload_cli.schema import Parameters

    Shape = tuple[int, int]


class DetectorBank:
    """Several detectors that get the same frames and share their layers.

    Parameters
    ----------
    shape : tuple of int
        Height and width of the working frames.
    params : sequence of Parameters
        One set for each detector; the responses have the same order.
    frame_rate : float, optional
        Frames per second of the video, if known.
    time : TimeParams, optional
        The time base; if left out, that of each detector.
    shapes : mapping of str to tuple of int, optional
        Height and width of the frames of those detectors that get others than `shape`.

    Attributes
    ----------
    detectors : dict of str to Detector
        The detectors by name.
    responded : set of str
        Names of the detectors that have responded: from now on their response is never None.

    Raises
    ------
    ParameterError
        If no detector or no list is given, or one detector is given twice.
    DetectorError
        If a user's detector cannot be made.

    Examples
    --------
    >>> import numpy as np, oppload_cli as oppload
    >>> bank = oppload.DetectorBank((48, 64), [oppload.DlgmdParams()], frame_rate=30)
    >>> for luma in np.zeros((5, 48, 64), np.float32):
    ...     responses = bank.step(luma)
    >>> responses
    {'dlgmd': DlgmdResponse(response=0.0, box=None, s=0.0)}
    """

    def __init__(
        self,
        shape: tuple[int, int],
        params: Sequence[Parameters],
        frame_rate: float | None = None,
        time: TimeParams | None = None,
        shapes: Mapping[str, Shape] | None = None,
    ) -> None:
        given: object = params  # a caller may give one set, in spite of the type
        if not isinstance(given, Iterable):
            raise ParameterError(
                f"params must not be {given!r:.60}; give a list, such as [DlgmdParams()]"
            )
        params = list(params)
        if not params:
            raise ParameterError("no model is chosen; name at least one")
        self._shape, time = checked_shape(shape), time or TimeParams()
        # Layers by the size of the frames and the time base of the detectors that share them.
        self._layers: dict[tuple[Shape, TimeParams], Layers] = {}

        def layers_of(shape: Shape, time: TimeParams) -> Layers:
            key = shape, time.of(REFERENCE_INTERVAL)
            return self._layers.setdefault(key, Layers(shape, Clock(time, frame_rate)))

        self._photoreceptors = layers_of(self._shape, time).photoreceptors()
        self.responded: set[str] = set()
        self._separated = False
        self.detectors: dict[str, Detector] = {}
        for chosen in params:
            kind = detector_of(chosen)
            if kind.name in self.detectors:
                raise ParameterError(f"model '{kind.name}' is given twice; name each once")
            size = (shapes or {}).get(kind.name, self._shape)
            layers = layers_of(size, time.of(kind.interval))
            with _errors_of(kind, "cannot be made"):
                detector = kind(size, chosen, frame_rate=frame_rate, layers=layers)
            self.detectors[kind.name] = detector

    @property
    def luma_change(self) -> float | None:
        """Mean of P(t) over the frame, 0 to 1; None if no frames were compared."""
        return self._photoreceptors.layer.luma_change

    @property
    def photoreceptors(self) -> Map:
        """P(t), shape (height, width), 0 to 1; zeros on the first frame."""
        return self._photoreceptors.layer.maps[0]

    def reset(self) -> None:
        """Forget all frames: the next frame is frame 0."""
        self.responded.clear()
        self._photoreceptors.reset()
        for layers in self._layers.values():
            layers.flow().reset()
        for detector in self.detectors.values():
            detector.reset()

    def step(self, luma: Map, time_s: float | None = None) -> dict[str, Response | None]:
        """Take the next frame; return every detector's response by name.

        A detector's response is None only during its warm-up. If its `step` returns None later, its
        response to a frame without change (`at_rest`) is returned instead.

        Parameters
        ----------
        luma : ndarray of float32, shape (height, width)
            Luminance, 0 to 1.
        time_s : float, optional
            Presentation time of the frame in seconds; detectors read it from their layers.

        Raises
        ------
        FrameError
            If the array is not a luminance image of the right shape, or the time is not finite.
        DetectorError
            If a detector returns something other than None or a valid instance of its `responses`,
            or if a detector that a user has registered raises an error.
        """
        if time_s is not None and not math.isfinite(time_s):
            raise FrameError(
                f"time_s must be a finite number, not {time_s}; leave it out if it is not known"
            )
        self.see(luma, time_s)
        return self.respond({self._shape: luma}, time_s)

    def separate(self) -> None:
        """Separate the layers of detectors that get pictures between frames from those of others.

        It is called before every frame with such pictures; later calls have no effect.
        """
        for detector in self.detectors.values():
            if detector.interpolates and not self._separated:
                with _errors_of(type(detector), "its separate failed"):
                    detector.separate()
        self._separated = True

    def see(self, luma: Map, time_s: float | None) -> None:
        """Take the next frame for `photoreceptors` and `luma_change`; `respond` must follow."""
        self._set_time(time_s)
        self._photoreceptors.step(luma)

    def _set_time(self, time_s: float | None) -> None:
        for layers in self._layers.values():
            layers.clock.time_s = time_s

    def give(self, flow: Flow | None) -> None:
        """Set the flow of the next frame or picture; without a call the detectors measure it."""
        for layers in self._layers.values():
            scale = layers.shape[0] / self._shape[0]
            layers.flow().give(flow and flow.scaled(scale))

    def respond(
        self, lumas: Mapping[Shape, Map], time_s: float | None, *, between: bool = False
    ) -> dict[str, Response | None]:
        """Return the responses to the frame that was seen, or to a picture before it.

        Parameters
        ----------
        lumas : mapping of tuple of int to ndarray of float32
            The luminance, as for `step`, by its height and width: one for each size that a
            detector has.
        time_s : float or None
            As for `step`, like the errors.
        between : bool
            Whether it is a picture between frames, which only some detectors get (`interpolates`).
        """
        self._set_time(time_s)
        # A detector must not write into the frame, since the others get the same frame.
        lumas = {shape: luma.view() for shape, luma in lumas.items()}
        for luma in lumas.values():
            luma.flags.writeable = False
        responses = {
            name: _response_of(detector, "step", lumas[detector.shape])
            for name, detector in self.detectors.items()
            if detector.interpolates or not between
        }
        self.responded |= {name for name, response in responses.items() if response is not None}
        return {
            name: self._at_rest(name) if response is None else response
            for name, response in responses.items()
        }

    def units_of(self, name: str) -> UnitMaps | None:
        """Return the units of a detector at the latest frame; None if it has no units."""
        detector = self.detectors[name]
        with _errors_of(type(detector), "its units failed"):
            units: Any = detector.units  # a user's detector may ignore the types
        if units is not None and not _are_units(units):
            raise DetectorError(
                f"detector '{name}': its units must be UnitMaps or None, with an array of "
                "responses of at least 0, a row for each of centres_y and a column for each of "
                "centres_x"
            )
        return cast("UnitMaps | None", units)

    def at_rest(self, frames: int, seconds: float) -> dict[str, Response | None]:
        """Return every detector's response to a frame in which nothing changed.

        The response is None unless the detector has responded before. If nothing has changed since
        the start of the video, `step` has taken only one frame. Then a detector responds as soon as
        the time since the start, of so many frames and seconds, has reached its warm-up.
        """
        if self._photoreceptors.layer.frames == 1:
            self.responded |= {
                name
                for name, detector in self.detectors.items()
                if detector.layers.clock.lasted(frames, seconds) + ROUNDING >= detector.warm_up
            }
        return {name: self._at_rest(name) for name in self.detectors}

    def _at_rest(self, name: str) -> Response | None:
        return _response_of(self.detectors[name], "at_rest") if name in self.responded else None


def _response_of(detector: Detector, method: str, *arguments: Map) -> Response | None:
    """Return the response that a method of a detector gives, after a check."""
    with _errors_of(type(detector), f"its {method} failed"):
        response: Response | None = getattr(detector, method)(*arguments)
    if response is None:
        return None
    if fault := _fault(detector, response):
        raise DetectorError(f"detector '{detector.name}': its {method} returned {fault}")
    return _plain(response)


@contextmanager
def _errors_of(detector: type[Detector], fault: str) -> Iterator[None]:
    """Turn an error in the code of a user's detector into a DetectorError that names it."""
    try:
        yield
    # SystemExit: code that calls exit() would end a process, or the worker of a cluster.
    except (Exception, SystemExit) as error:
        if isinstance(error, OpploadError | MemoryError) or is_of_package(detector):
            raise
        last = traceback.extract_tb(error.__traceback__)[-1]
        raise DetectorError(
            f"detector '{detector.name}': {fault} ({type(error).__name__}: {error}; "
            f"{last.filename}, line {last.lineno}); correct the detector"
        ) from error


def _fault(detector: Detector, returned: object) -> str:
    """Return a text that says why a response is not valid; empty for a valid one."""
    if not isinstance(returned, detector.responses):
        return f"{type(returned).__name__}, not a {detector.responses.__name__} or None"
    response: Any = returned.response  # a user's detector may ignore the types
    box: object = returned.box
    if not _is_finite(response) or response < 0:
        return f"a response of {response!r:.60}, not a finite number of at least 0"
    if box is not None and not (
        isinstance(box, Box) and all(map(_is_finite, box)) and min(box.width, box.height) >= 0
    ):
        return f"a box of {box!r:.60}, not a Box of finite numbers, its sides at least 0, or None"
    for name, *_ in (*detector.columns, *detector.details):
        value = getattr(returned, name)
        if value is not None and not _is_finite(value):
            return f"{name} = {value!r:.60}, not a finite number or None"
    return ""


def _are_units(units: object) -> bool:
    if not isinstance(units, UnitMaps):
        return False
    responses: Any = units.responses
    shape = len(units.centres_y), len(units.centres_x)
    is_map = isinstance(responses, np.ndarray) and responses.shape == shape
    return is_map and responses.size > 0 and bool(responses.min() >= 0)


def _is_finite(value: object) -> bool:
    return isinstance(value, int | float | np.integer | np.floating) and math.isfinite(value)


def _plain(response: Response) -> Response:
    """Return a response with Python's numbers in place of NumPy's, which tables and JSON refuse.

    The mean of an image of float32, for example, is a float32. A float64 is replaced too: JSON
    takes it, but not the result of comparing it with a threshold.
    """
    changed: dict[str, Any] = {
        name: value.item()
        for name, value in vars(response).items()
        if isinstance(value, np.generic)
    }
    if any(isinstance(side, np.generic) for side in response.box or ()):
        changed["box"] = Box(*map(float, response.box or ()))
    return replace(response, **changed) if changed else response
