"""Changes of the picture that the models cannot judge: cuts, flashes, motion out of rest."""

from __future__ import annotations

from collections import deque
from typing import TYPE_CHECKING

import numpy as np

from oppload_cli.detection.alarm import AlarmParams

if TYPE_CHECKING:
    from oppload_cli.models.kernels import Map


class Cuts:
    """Tells hard cuts, flashes, steps of luminance and motion out of rest from looming.

    The first three change most of the frame at once, far more than any of the frames
    before; an object that approaches takes many frames to fill the picture. And where
    the scene was at rest there is no inhibition yet: whatever begins to move, in
    whatever direction, excites all pathways for as many frames as the models see back.

    Parameters
    ----------
    params : AlarmParams, optional
        Its `cut_ratio`, `cut_share`, `rest` and `blind`.

    Source: ``docs/alarms.md``.
    """

    MEMORY = 5  # frames of luminance change that one is held against

    def __init__(self, params: AlarmParams | None = None) -> None:
        self._params = params or AlarmParams()
        self._changes: deque[float] = deque(maxlen=self.MEMORY)
        self._blind = 0

    def step(self, photoreceptors: Map, change: float) -> bool:
        """Take the next frame.

        Parameters
        ----------
        photoreceptors : ndarray of float32, shape (height, width)
            P(t), 0 to 1.
        change : float
            Its mean, 0 to 1.

        Returns
        -------
        bool
            Whether the models may be answering to such a change, now or of late.
        """
        self._blind = max(0, self._blind - 1)
        if self._is_cut(photoreceptors, change):
            self._blind = self._params.blind
        self._changes.append(change)
        return self._blind > 0

    def _is_cut(self, photoreceptors: Map, change: float) -> bool:
        before = max(self._changes, default=0.0)
        if not self._params.cut_ratio or change <= self._params.cut_ratio * before:
            return False
        if before <= self._params.rest:
            return True
        # Of a cut most pixels change about as much as the mean, of an object few change much.
        changed = np.count_nonzero(photoreceptors > change / 4)
        return bool(changed >= self._params.cut_share * photoreceptors.size)
