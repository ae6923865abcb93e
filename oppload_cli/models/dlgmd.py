"""D-LGMD, the baseline (``docs/model.md``, section 3)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

import cv2
import numpy as np

from oppload_cli.compute.loops import with_twin
from oppload_cli.models.detector import AlarmRule, Column, Detector, Response
from oppload_cli.models.dpc import DpcParams, excitation, referred
from oppload_cli.schema import parameter

if TYPE_CHECKING:
    from typing import Any

    from oppload_cli.models.dpc import Map


@dataclass(frozen=True, kw_only=True)
class DlgmdParams(DpcParams):
    """Parameters of D-LGMD: the DPC constants and grouping (``docs/model.md``, section 3).

    Examples
    --------
    >>> import oppload_cli as oppload
    >>> oppload.DlgmdParams(group_size=8).group_size
    8
    """

    group_size: int = parameter(
        4, "side of the square over which grouping sums S", unit="px", low=1, high=100
    )
    threshold_factor: float = parameter(
        1.2, "threshold of grouping as a multiple of the earlier change, P(t-2)", low=0, high=1000
    )
    threshold_limit: float = parameter(0.3, "largest threshold of grouping", low=0, high=1000)
    grouped_limit: float = parameter(1.0, "largest value of G at a pixel", low=0, high=1e6)


@dataclass(frozen=True)
class DlgmdResponse(Response):
    """The response of D-LGMD to one frame.

    Attributes
    ----------
    response : float
        Mean of the grouped map G over the frame, 0 to `grouped_limit`.
    s : float
        Mean of the presynaptic sum S over the frame, at least 0.

    Examples
    --------
    >>> import oppload_cli as oppload
    >>> oppload.DlgmdResponse(0.25, s=0.1).s
    0.1
    """

    s: float = 0.0


def threshold(params: DlgmdParams, change_two_ago: float) -> float:
    """Return ``T = min(1.2 mean(P(t-2)), 0.3)``, the threshold of grouping (section 3).

    `change_two_ago` is mean(P(t-2)), 0 to 1.
    """
    return min(params.threshold_factor * change_two_ago, params.threshold_limit)


@with_twin
def group(presynaptic: Map, side: int, least: float, limit: float, out: Map) -> tuple[float, float]:
    """Group S, and return the means of S and of G over the frame (section 3).

    ``C = ones(side, side) * S`` and ``G = S C``, which is 0 below `least`, and at most `limit`.

    Parameters
    ----------
    presynaptic : ndarray of float32, shape (height, width)
        S, at least 0.
    side : int
        Side in pixels of the square over which S is summed, at least 1.
    least, limit : float
        The threshold T, and the largest value of G.
    out : ndarray of float32, shape (height, width)
        Filled with G.
    """
    anchor = (side - 1) // 2  # as MATLAB's conv2(..., 'same') places the square
    sums = cv2.boxFilter(
        presynaptic,
        cv2.CV_32F,
        (side, side),
        anchor=(anchor, anchor),
        normalize=False,
        borderType=cv2.BORDER_CONSTANT,
    )
    np.multiply(sums, presynaptic, out=out)
    out[out < np.float32(least)] = 0
    np.minimum(out, np.float32(limit), out=out)
    return cv2.mean(presynaptic)[0], cv2.mean(out)[0]


class Dlgmd(Detector):
    """The D-LGMD model; arguments as :class:`~oppload_cli.models.detector.Detector`.

    Attributes
    ----------
    grouped : ndarray of float32, shape (height, width)
        G of the latest frame, 0 to `grouped_limit`.

    Source: Zhao et al. 2021 with the constants of the authors' code; ``docs/model.md``,
    sections 1 to 3.

    Examples
    --------
    >>> import numpy as np, oppload_cli as oppload
    >>> model = oppload.Dlgmd((48, 64))
    >>> still = np.full((48, 64), 0.5, np.float32)
    >>> [model.step(still) for _ in range(4)]
    [None, None, None, DlgmdResponse(response=0.0, box=None, s=0.0)]
    """

    name = "dlgmd"
    label = "D-LGMD"
    colour = "#0072B2"
    year = 2021
    reference = "Zhao et al., D-LGMD, IEEE Trans. Neural Networks and Learning Systems"
    answers_to = "fast and growing edges, of any contrast; also fast translation"
    made_for = "600 px high, 30 frames/s"
    cost_ms = 0.4
    meaning = "D-LGMD: DPC and grouping"
    unit = "mean of G"
    response_column = "0 to 1", "mean over the frame of G, the grouped map of D-LGMD"
    columns = (Column("s", "", "mean over the frame of S, the presynaptic sum of D-LGMD"),)
    responses = DlgmdResponse
    parameters = DlgmdParams
    alarm: ClassVar = AlarmRule(0.01)
    by_default = True
    warm_up = 3  # S needs P now, one and two intervals ago

    params: DlgmdParams

    def __init__(
        self, shape: tuple[int, int], params: DlgmdParams | None = None, **others: Any
    ) -> None:
        super().__init__(shape, params, **others)
        self._dpc = self.layers.dpc(self.params)
        self.grouped: Map = np.zeros(shape, np.float32)

    @property
    def maps(self) -> dict[str, Map]:
        """P, E, I, S and G of the latest frame, shape (height, width)."""
        return {**self._dpc.layer.maps, "G": self.grouped}

    def reset(self) -> None:
        """Forget all frames: the next frame is frame 0."""
        self._dpc.reset()
        self.grouped[:] = 0

    def step(self, luma: Map) -> DlgmdResponse | None:
        """Take the next frame: S, grouping, means; None for the first three intervals."""
        if not self._dpc.step(luma):
            return None
        params, dpc = self.params, self._dpc.layer
        photoreceptors, share = dpc.photoreceptors, dpc.photoreceptors.share
        t = threshold(params, photoreceptors.means[2])
        side, limit = params.group_size, params.grouped_limit
        mean_s, mean_g = group(dpc.sums.presynaptic, side, t, limit, self.grouped)
        if share != 1:  # for G, E is grouped as S is (docs/time.md)
            e = excitation(photoreceptors.maps, dpc.kernels)
            mean_e, grouped_e = group(e, side, t, limit, np.empty_like(e))
            mean_s = float(referred(mean_s, mean_e, share, directional=False))
            mean_g = float(referred(mean_g, grouped_e, share, directional=False))
        return DlgmdResponse(mean_g, s=mean_s)
