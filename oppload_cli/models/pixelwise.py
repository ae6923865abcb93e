"""OMJ of preset `paper`: the opposing motion judgement to the letter (``docs/paper.md``)."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from oppload_cli.models.parameters import axes_of
from oppload_cli.models.units import UnitMaps, evenly
from oppload_cli.models.verdict import Verdict

if TYPE_CHECKING:
    from collections.abc import Mapping

    from oppload_cli.models.kernels import Map
    from oppload_cli.models.parameters import OpplodParams
    from oppload_cli.models.presynaptic import Live


class PixelwiseJudge:
    """OMJ of preset `paper`: products pixel by pixel in the fields of a grid of units.

    Parameters
    ----------
    shape : tuple of int
        Height and width of the working frames.
    params : OpplodParams
        Resolved parameters with a grid of units.
    """

    def __init__(self, shape: tuple[int, int], params: OpplodParams) -> None:
        self._params = params
        self._shape = shape
        self._field = min(params.receptive_field or 0, *shape)
        columns, rows = params.grid() or (1, 1)
        self.lefts = evenly(shape[1] - self._field, columns)
        self.tops = evenly(shape[0] - self._field, rows)
        self.maps = UnitMaps(
            np.zeros((rows, columns), np.float32),
            {},
            np.asarray(self.tops, np.float64) + self._field / 2,
            np.asarray(self.lefts, np.float64) + self._field / 2,
            float(self._field),
            0.0,
        )

    def reset(self) -> None:
        """Forget the frames that have passed: it remembers none."""

    def judge(
        self,
        pathways: Mapping[int, Map],
        live: Live | None = None,  # noqa: ARG002 - it looks at every pixel
    ) -> Verdict:
        """Judge the S maps of the four pathways.

        Parameters
        ----------
        pathways : mapping of int to ndarray of float32, shape (height, width)
            S_phi by direction phi in degrees.
        live : ndarray of uint8, optional
            Where they may be above 0, as :attr:`oppload_cli.models.layers.Dpc.live`.

        Returns
        -------
        Verdict
            The response is the sum of S_E over all units; the place is the unit
            of the largest part of it.
        """
        values = np.array(
            [[self._unit(pathways, top, left) for left in self.lefts] for top in self.tops]
        )
        row, column = divmod(int(values[..., 0].argmax()), values.shape[1])
        self.maps.responses[:] = values[..., 0]
        return Verdict(
            response=float(values[..., 0].sum()),
            opponency=float(values[row, column, 1]),
            centre_x=self.lefts[column] + self._field / 2,
            centre_y=self.tops[row] + self._field / 2,
        )

    def _unit(self, pathways: Mapping[int, Map], top: int, left: int) -> tuple[float, float]:
        """Return one unit's sum of S_E, and of the products that it is made from."""
        field = np.s_[top : top + self._field, left : left + self._field]
        enhanced = opponency = 0.0
        for phi in axes_of(self._params):
            product = pathways[phi][field] * pathways[phi + 180][field][::-1, ::-1]
            selected = product[product > self._params.threshold].astype(np.float64)
            # The products in the other order are the same ones, rotated by 180 degrees.
            enhanced += 2 * self._params.gain * float(selected @ selected)
            opponency += 2 * float(selected.sum())
        return enhanced, opponency
