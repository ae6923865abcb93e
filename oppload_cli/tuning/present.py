"""A stimulus shown to the models exactly as ``oppload run`` shows its lossless video."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, cast

import numpy as np

from oppload_cli.analysis import analyse
from oppload_cli.models.opplod import OpplodResponse
from oppload_cli.stimulus.renderer import frames
from oppload_cli.video.frames import Frame, InputFacts, Picture
from oppload_cli.video.luminance import Luminance
from oppload_cli.video.working import working_size

if TYPE_CHECKING:
    from collections.abc import Iterator

    from numpy.typing import NDArray

    from oppload_cli.models.bank import Response
    from oppload_cli.settings import Settings
    from oppload_cli.stimulus.protocol import Protocol
    from oppload_cli.video.source import Video

    Series = NDArray[np.float64]


class StimulusVideo:
    """The frames of a stimulus at the working size, as an open video would give them.

    Parameters
    ----------
    protocol : Protocol
        The stimulus.
    height : int or None
        Working height in pixels; None keeps the native size.
    """

    def __init__(self, protocol: Protocol, height: int | None) -> None:
        display = protocol.display
        self.protocol = protocol
        self.facts = InputFacts(
            protocol.name,
            "stimulus",
            display.width,
            display.height,
            display.frame_rate,
            protocol.frame_count,
        )
        self.working = working_size(self.facts, height)
        self._luminance = Luminance(self.working, 0)

    def __iter__(self) -> Iterator[Frame]:
        for shown in frames(self.protocol):
            picture = Picture(shown.index, shown.time_s, shown.grey)
            yield Frame(shown.index, shown.time_s, self._luminance(picture))


@dataclass(frozen=True)
class Responses:
    """What one model answered to one stimulus.

    Attributes
    ----------
    frame, time_s : ndarray, shape (n,)
        Of every frame of the stimulus.
    response : ndarray, shape (n,)
        NaN during warm-up.
    centre : ndarray, shape (n, 2)
        Centre (x, y) of the winning unit in stimulus pixels; NaN where there is none.
    box : ndarray, shape (n, 4)
        Its receptive field: left, top, width and height in stimulus pixels.
    """

    frame: Series
    time_s: Series
    response: Series
    centre: Series
    box: Series

    @property
    def peak(self) -> int | None:
        """Position of the first largest response; None where there is no response."""
        if not np.isfinite(self.response).any():
            return None
        return int(np.nanargmax(self.response))


def present(protocol: Protocol, settings: Settings) -> dict[str, Responses]:
    """Show a stimulus to the models.

    Parameters
    ----------
    protocol : Protocol
        The stimulus.
    settings : Settings
        Models, their parameters and the working height.

    Returns
    -------
    dict of str to Responses
        By model, in the settings' order: the numbers that ``oppload run`` writes
        for the stimulus's lossless video.
    """
    # analyse asks of a video no more than its frames and its working size.
    video = cast("Video", StimulusVideo(protocol, settings.height))
    records = list(
        analyse(video, settings.model_params(), places=None, repeats=settings.repeats, rmo=None)
    )
    frame = np.array([record.frame for record in records], float)
    time = np.array([record.time_s for record in records])
    made = {}
    for model in settings.models:
        answers = [record.responses.get(model) for record in records]
        boxes = np.array([_box(answer) for answer in answers])
        response = [np.nan if answer is None else answer.response for answer in answers]
        centre = boxes[:, :2] + boxes[:, 2:] / 2
        made[model] = Responses(frame, time, np.array(response), centre, boxes)
    return made


def _box(answer: Response | None) -> list[float]:
    if not isinstance(answer, OpplodResponse) or answer.box is None:
        return [np.nan] * 4
    return [answer.box.x, answer.box.y, answer.box.width, answer.box.height]
