"""One pass over a video: every frame through every model and its alarm."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from oppload_cli.detection.alarm import Alarm, AlarmParams
from oppload_cli.models.bank import ModelBank
from oppload_cli.models.layers import MEMORY
from oppload_cli.models.opplod import Box, OpplodResponse
from oppload_cli.models.parameters import DlgmdParams, OpplodParams
from oppload_cli.parameters import Parameters, parameter
from oppload_cli.results.record import FrameRecord

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from numpy.typing import NDArray

    from oppload_cli.models.bank import Response
    from oppload_cli.video.source import Video
    from oppload_cli.video.working import WorkingSize


@dataclass(frozen=True, kw_only=True)
class RepeatParams(Parameters):
    """How exact repeats of a frame are taken (``docs/model.md``, "Repeated frames")."""

    most: int = parameter(
        5,
        "repeats in a row taken as a copied frame; a longer run is a still scene",
        unit="frames",
        low=0,
        high=1000,
    )


class Repeats:
    """Tells copies that a converter made from a scene that stands still.

    Content of 10 frames/s in a file of 30 repeats each frame twice: fed to the
    models it would stand still, and then jump. So a few exact repeats in a row are
    passed over. A longer run is a still scene, which the models must see.

    Parameters
    ----------
    params : RepeatParams
    """

    def __init__(self, params: RepeatParams) -> None:
        self._most = params.most
        self._run = 0
        self._last: NDArray[np.float32] | None = None
        self.count = 0

    def step(self, luma: NDArray[np.float32]) -> tuple[bool, bool]:
        """Take the next frame.

        Parameters
        ----------
        luma : ndarray of float32, shape (height, width)
            Luminance at the working size; kept, not copied.

        Returns
        -------
        repeat : bool
            Whether it equals the frame before.
        passed_over : bool
            Whether the models shall not see it.
        """
        repeat = self._last is not None and np.array_equal(luma, self._last)
        self._last = luma
        self._run = self._run + 1 if repeat else 0
        self.count += repeat
        return repeat, repeat and self._run <= self._most


def analyse(
    video: Video,
    params: Sequence[OpplodParams | DlgmdParams] | None = None,
    *,
    alarm: AlarmParams | None = None,
    repeats: RepeatParams | None = None,
) -> Iterator[FrameRecord]:
    """Run models over a video in one pass.

    Parameters
    ----------
    video : Video
        From :func:`oppload_cli.open_video`; it is iterated, not closed.
    params : sequence of OpplodParams or DlgmdParams, optional
        One set per model; both models with the defaults if left out.
    alarm : AlarmParams, optional
        Of every model's alarm.
    repeats : RepeatParams, optional
        What is done with exact repeats.

    Yields
    ------
    FrameRecord
        One per decoded frame; responses are None during warm-up.
    """
    bank = ModelBank(video.working.shape, params or [OpplodParams(), DlgmdParams()])
    alarms = {name: Alarm(alarm) for name in bank.models}
    copies = Repeats(repeats or RepeatParams())
    for seen, frame in enumerate(video):
        repeat, passed_over = copies.step(frame.luma)
        if passed_over:
            # Where nothing changes every model answers 0, whatever came before.
            answers = bank.at_rest() if seen >= MEMORY else dict.fromkeys(bank.models)
            change: float | None = 0.0
        else:
            answers = bank.step(frame.luma)
            change = bank.luma_change
        yield FrameRecord(
            frame.index,
            frame.time_s,
            change,
            {name: _in_source(answer, video.working) for name, answer in answers.items()},
            {
                name: alarms[name].step(answer.response, frame.time_s)
                for name, answer in answers.items()
                if answer is not None
            },
            repeat,
        )


def _in_source(answer: Response | None, working: WorkingSize) -> Response | None:
    """Return an answer with its box in source pixels."""
    if not isinstance(answer, OpplodResponse) or answer.box is None:
        return answer
    box, x, y = answer.box, working.scale_x, working.scale_y
    return replace(answer, box=Box(box.x * x, box.y * y, box.width * x, box.height * y))
