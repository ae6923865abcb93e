"""Opposing motion judgement (OMJ) and enhancing (``docs/model.md``, section 5).

Two judges: :class:`PooledJudge` sums opponent products over cells,
:class:`~oppload_cli.models.pixelwise.PixelwiseJudge` is the paper to the letter. Both
take the four S maps and return the winning unit.
"""

from __future__ import annotations

import math
from functools import partial
from typing import TYPE_CHECKING

import cv2
import numpy as np

from oppload_cli.models.background import Background
from oppload_cli.models.crew import Crew
from oppload_cli.models.pairs import Pair, offset_weights
from oppload_cli.models.parameters import axes_of
from oppload_cli.models.pixelwise import PixelwiseJudge
from oppload_cli.models.pooling import Pooling
from oppload_cli.models.units import UnitMaps, selected_units
from oppload_cli.models.verdict import Verdict

if TYPE_CHECKING:
    from collections.abc import Mapping

    from oppload_cli.models.kernels import Map
    from oppload_cli.models.parameters import OpplodParams
    from oppload_cli.models.presynaptic import Live
    from oppload_cli.models.verdict import Judge


class PooledJudge:
    """OMJ of presets `default` and `robust`: pool, outward minus inward, enhance the best.

    Parameters
    ----------
    shape : tuple of int
        Height and width of the working frames.
    params : OpplodParams
        Resolved parameters (`receptive_field` and `cell` are numbers).
    """

    def __init__(self, shape: tuple[int, int], params: OpplodParams) -> None:
        self._params = params
        cell = params.cell or 1
        reach = int((params.receptive_field or 0) / 2 // cell)
        self._pairs = {
            phi: Pair(
                Pooling(shape, cell, params.pool_sigma * cell),
                offset_weights(reach, phi, params),
                params.compression,
            )
            for phi in axes_of(params)
        }
        pool = self._pairs[params.axes].pool
        self.centres_y, self.centres_x = pool.centres_y, pool.centres_x
        self.maps = UnitMaps(
            np.zeros(pool.shape, np.float32),
            {
                direction: pooled
                for phi, pair in self._pairs.items()
                for direction, pooled in ((phi, pair.passing), (phi + 180, pair.opposite))
            },
            self.centres_y,
            self.centres_x,
            float(params.receptive_field or 0),
            # A power of a Gaussian is a Gaussian, wider where the power is below 1.
            params.pool_sigma * cell / math.sqrt(params.compression),
        )
        self._crew = Crew(shape)
        self._further = np.zeros(pool.shape, np.float32)
        self._kept = np.zeros(pool.shape, np.float32)
        self._frames = 0
        self._background = Background(
            params.frames(params.adaptation_s), params.frames(params.adaptation_guard_s)
        )
        selected = selected_units(shape, self.centres_y, self.centres_x, params)
        self._gains = selected * np.float32(params.rate_gain())

    def reset(self) -> None:
        """Forget the frames that have passed."""
        self._frames = 0
        self._kept[:] = 0
        self._background.reset()

    def add(self, pathways: Mapping[int, Map], share: float, live: Live | None = None) -> None:
        """Take frames several apart: their R counts in the next frame judged.

        Parameters
        ----------
        pathways : mapping of int to ndarray of float32, shape (height, width)
            S_phi by direction phi in degrees.
        share : float
            What R is multiplied by.
        live : ndarray of uint8, optional
            As for :meth:`judge`.
        """
        self._further += np.float32(share) * self.opponency(pathways, live)

    def judge(self, pathways: Mapping[int, Map], live: Live | None = None) -> Verdict:
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
            The best unit's; its response is ``c2 R^2``, 0 unless R is above T_o.
        """
        opponency = self.opponency(pathways, live)
        if self._params.strides > 1:
            opponency += self._further
            self._further[:] = 0
        if self._params.persistence:
            cv2.accumulateWeighted(opponency, self._kept, 1 - self._params.persistence)
            opponency = self._kept.copy()
        opponency *= self._gains
        if self._params.adaptation_level:
            opponency *= self._adaptation(float(opponency.max()))
        best = int(opponency.argmax())
        row, column = divmod(best, opponency.shape[1])
        value = float(opponency[row, column])
        responses = self.maps.responses
        np.multiply(opponency, self._params.gain * opponency, out=responses)
        responses[opponency <= self._params.threshold] = 0
        above = value > self._params.threshold
        return Verdict(
            response=self._params.gain * value**2 if above else 0.0,
            opponency=value,
            centre_x=float(self.centres_x[column]),
            centre_y=float(self.centres_y[row]),
        )

    def _adaptation(self, best: float) -> np.float32:
        """Return what R is multiplied by: 1, or less in a scene full of opponent motion.

        ``min(1, level / B)``, B the background of the best unit's R (``docs/robust.md``).
        """
        if not best:  # rest is no background
            return np.float32(1)
        self._frames += 1
        background = self._background.step(best, self._frames)
        return np.float32(min(1, self._params.adaptation_level / background) if background else 1)

    def opponency(self, pathways: Mapping[int, Map], live: Live | None = None) -> Map:
        """Return R(c), outward minus inward opponency, of the unit at every cell.

        Parameters
        ----------
        pathways : mapping of int to ndarray of float32, shape (height, width)
            S_phi by direction phi in degrees.
        live : ndarray of uint8, optional
            As for :meth:`judge`.

        Returns
        -------
        ndarray of float32, shape (rows, columns)
            Sum over both axis pairs of ``max(0, out - w_p in)``.
        """
        self._crew(
            *(
                partial(pair, pathways[phi], pathways[phi + 180], live)
                for phi, pair in self._pairs.items()
            )
        )
        one, other = self._pairs.values()
        return np.maximum(one.difference, 0) + np.maximum(other.difference, 0)


def judge_for(shape: tuple[int, int], params: OpplodParams) -> Judge:
    """Return the judge that the parameters ask for.

    Parameters
    ----------
    shape : tuple of int
        Height and width of the working frames.
    params : OpplodParams
        Resolved parameters.

    Returns
    -------
    Judge
    """
    kind = PooledJudge if params.judgement == "pooled" else PixelwiseJudge
    return kind(shape, params)
