"""Several detectors over one video: the layers that they share are computed once."""

from __future__ import annotations

from typing import TYPE_CHECKING

from oppload_cli.errors import ParameterError
from oppload_cli.models.dpc import Layers
from oppload_cli.models.registry import detector_of
from oppload_cli.models.timebase import Clock

if TYPE_CHECKING:
    from collections.abc import Sequence

    from oppload_cli.models.detector import Detector, Response
    from oppload_cli.models.dpc import Map
    from oppload_cli.models.timebase import TimeParams
    from oppload_cli.schema import Parameters


class DetectorBank:
    """Detectors that see the same frames, in one pass.

    Parameters
    ----------
    shape : tuple of int
        Height and width of the working frames.
    params : sequence of Parameters
        One set for each detector, in the order of the answers.
    frame_rate : float, optional
        Frames per second of the video, where it is known.
    time : TimeParams, optional
        The time base; intervals of 1/30 s if left out.

    Attributes
    ----------
    detectors : dict of str to Detector
        By name.

    Raises
    ------
    ParameterError
        If no detector is given, or one is given twice.

    Examples
    --------
    >>> import numpy as np, oppload_cli as oppload
    >>> bank = oppload.DetectorBank((48, 64), [oppload.DlgmdParams()], frame_rate=30)
    >>> for luma in np.zeros((5, 48, 64), np.float32):
    ...     answers = bank.step(luma)
    >>> answers
    {'dlgmd': DlgmdResponse(response=0.0, box=None, s=0.0)}
    """

    def __init__(
        self,
        shape: tuple[int, int],
        params: Sequence[Parameters],
        frame_rate: float | None = None,
        time: TimeParams | None = None,
    ) -> None:
        if not params:
            raise ParameterError("no model is chosen; name at least one")
        self._layers = layers = Layers(shape, Clock(time, frame_rate))
        self._photoreceptors = layers.photoreceptors()
        self.detectors: dict[str, Detector] = {}
        for each in params:
            kind = detector_of(each)
            if kind.name in self.detectors:
                raise ParameterError(f"model '{kind.name}' is given twice; name each once")
            self.detectors[kind.name] = kind(shape, each, frame_rate=frame_rate, layers=layers)

    @property
    def luma_change(self) -> float | None:
        """Mean of P(t) over the frame, 0 to 1; None where no earlier frame was compared."""
        return self._photoreceptors.layer.luma_change

    @property
    def photoreceptors(self) -> Map:
        """P(t), shape (height, width), 0 to 1; zeros on the first frame."""
        return self._photoreceptors.layer.maps[0]

    def reset(self) -> None:
        """Forget all frames: the next frame is frame 0."""
        self._photoreceptors.reset()
        for detector in self.detectors.values():
            detector.reset()

    def step(self, luma: Map, time_s: float | None = None) -> dict[str, Response | None]:
        """Take the next frame; every detector answers to it.

        Parameters
        ----------
        luma : ndarray of float32, shape (height, width)
            Luminance, 0 to 1.
        time_s : float, optional
            Its presentation time in seconds; detectors read it from their layers.

        Returns
        -------
        dict of str to Response or None
            By name; None during warm-up.

        Raises
        ------
        FrameError
            If the array is not a luminance image of the right shape.
        ParameterError
            If a detector returns anything else than an instance of its `answers`.
        """
        self._layers.clock.time_s = time_s
        self._photoreceptors.step(luma)
        return {name: _checked(each, each.step(luma)) for name, each in self.detectors.items()}

    def at_rest(self, intervals: float) -> dict[str, Response | None]:
        """Return every detector's answer to a frame in which nothing changed.

        Parameters
        ----------
        intervals : float
            How long the video lasts already; a detector in its warm-up has no answer.
        """
        return {
            name: each.at_rest() if intervals >= each.warm_up else None
            for name, each in self.detectors.items()
        }


def _checked(detector: Detector, answer: object) -> Response | None:
    if answer is None or isinstance(answer, detector.answers):
        return answer
    raise ParameterError(
        f"detector '{detector.name}': its step returned {type(answer).__name__}, "
        f"not a {detector.answers.__name__} or None"
    )
