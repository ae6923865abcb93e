"""Every constant of the models, and the presets (``docs/model.md``).

Nothing here needs NumPy, so that the command line can describe the parameters
without paying for it.
"""

from __future__ import annotations

import re
from dataclasses import dataclass

from oppload_cli.errors import ParameterError
from oppload_cli.parameters import Parameters, parameter

UNKNOWN_RATE = 30.0  # Hz
LOWEST_RATE, HIGHEST_RATE = 1e-3, 1e6  # Hz


@dataclass(frozen=True, kw_only=True)
class DpcParams(Parameters):
    """Constants of the distributed presynaptic connections (DPC).

    They are in pixels of the working size and do not scale with it: this is what
    ties the speed selectivity to the working size. Values: the MATLAB code of the
    D-LGMD authors (``docs/model.md``, section 2).
    """

    sigma_excitation: float = parameter(
        1.5, "spread of excitation, sigma_E", unit="px", low=0.1, high=100
    )
    sigma_inhibition: float = parameter(
        5.0, "spread of inhibition, sigma_I", unit="px", low=0.1, high=100
    )
    inhibition_strength: float = parameter(
        1.5, "strength of inhibition against excitation, a", low=0, high=100
    )
    kernel_radius: int = parameter(6, "radius of all DPC kernels, r", unit="px", low=1, high=50)
    latency_alpha: float = parameter(-0.1, "latency constant alpha_tau", low=-10, high=10)
    latency_beta: float = parameter(0.5, "latency constant beta", low=0.01, high=10)
    latency_lambda: float = parameter(
        0.7, "latency constant lambda", unit="1/px", low=0.01, high=10
    )
    latency_one: float = parameter(
        1.0, "latency from which a connection is one frame late", unit="frames", low=-10, high=100
    )
    latency_two: float = parameter(
        1.8999,
        "latency above which a connection is two frames late",
        unit="frames",
        low=-10,
        high=100,
    )

    def dpc(self) -> DpcParams:
        """Return the DPC constants alone, to see whether two models can share them.

        Returns
        -------
        DpcParams
        """
        return DpcParams(**{name: getattr(self, name) for name in DpcParams.names()})


@dataclass(frozen=True, kw_only=True)
class DlgmdParams(DpcParams):
    """Parameters of D-LGMD: the DPC constants and grouping (``docs/model.md``, section 3)."""

    group_size: int = parameter(4, "side of the square of grouping", unit="px", low=1, high=100)
    threshold_factor: float = parameter(
        1.2, "threshold of grouping over the mean luminance change", low=0, high=1000
    )
    threshold_limit: float = parameter(0.3, "largest threshold of grouping", low=0, high=1000)
    grouped_limit: float = parameter(1.0, "largest grouped value of a pixel", low=0, high=1e6)


@dataclass(frozen=True, kw_only=True)
class OpplodParams(DpcParams):
    """Parameters of OppLoD: the DPC constants, opponency and enhancing (sections 4 and 5)."""

    judgement: str = parameter(
        "pooled",
        "opposing motion judgement: 'pooled' over cells, or 'pixelwise' as the paper has it",
        choices=("pooled", "pixelwise"),
    )
    receptive_field: int | None = parameter(
        None, "side of a unit's square field; auto: 5/12 of the height", unit="px", low=2, high=8192
    )
    cell: int | None = parameter(
        None, "spacing of cells; auto: 1/30 of the height", unit="px", low=1, high=1024
    )
    pool_sigma: float = parameter(
        1.5, "spread of pooling; 0: no pooling", unit="cells", low=0, high=10
    )
    axes: int = parameter(
        45, "first axis of opponency; the other is 90 degrees on", unit="deg", choices=(0, 45)
    )
    border: int = parameter(0, "edge of the frame within which S is 0", unit="px", low=0, high=1000)
    compression: float = parameter(
        1.0, "exponent of the pooled S; below 1, contrast counts for less", low=0.1, high=2
    )
    strides: int = parameter(
        1, "sees frames 1 to this many apart, and adds up", unit="frames", low=1, high=16
    )
    persistence: float = parameter(
        0.0, "share of a unit's R that it keeps from frame to frame", low=0, high=0.99
    )
    reference_rate: float = parameter(
        0.0,
        "frame rate to which the response is referred; 0: per frame",
        unit="Hz",
        low=0,
        high=HIGHEST_RATE,
    )
    frame_rate: float | None = parameter(
        None,
        "frame rate of the video; auto: as the file states it",
        unit="Hz",
        low=LOWEST_RATE,
        high=HIGHEST_RATE,
    )
    adaptation_level: float = parameter(
        0.0, "background of R from which on it is divided; 0: never", low=0, high=1e9
    )
    adaptation_s: float = parameter(
        4.0, "how far back this background reaches", unit="s", low=0.1, high=60
    )
    adaptation_guard_s: float = parameter(
        0.2, "the latest time that is not yet background", unit="s", low=0, high=60
    )
    cone: float = parameter(
        90.0,
        "largest angle between an offset and the motion that is outward (or inward) there",
        unit="deg",
        low=1,
        high=90,
    )
    periphery: float = parameter(
        1.0, "weight of inward against outward motion, w_p", low=0, high=1000
    )
    threshold: float = parameter(0.0, "opponency above which it is enhanced, T_o", low=0, high=1e9)
    gain: float = parameter(1.0, "gain of enhancing, c2", low=0, high=1e9)
    units: str = parameter("every", "grid of units such as 5x5 (columns x rows), or 'every' cell")

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.units != "every" and not re.fullmatch(r"[1-9]\d{0,2}x[1-9]\d{0,2}", self.units):
            raise ParameterError(
                f"parameter 'units' of opplod must be 'every' or columns x rows such as 5x5, "
                f"not '{self.units}'"
            )
        if self.judgement == "pixelwise":
            self._check_pixelwise()

    def _check_pixelwise(self) -> None:
        literal = {
            "cell": 1,
            "border": 0,
            "cone": 90,
            "pool_sigma": 0,
            "periphery": 0,
            "compression": 1,
            "strides": 1,
            "persistence": 0,
            "reference_rate": 0,
            "adaptation_level": 0,
        }
        for name, value in literal.items():
            if getattr(self, name) != value:
                raise ParameterError(
                    f"parameter '{name}' of opplod must be {value} with judgement=pixelwise "
                    f"(preset paper), which is the paper to the letter"
                )
        if self.units == "every":
            raise ParameterError(
                "parameter 'units' of opplod must be a grid such as 5x5 with judgement=pixelwise"
            )

    def resolved(self, height: int, frame_rate: float | None = None) -> OpplodParams:
        """Return these parameters with what follows from the video filled in.

        Parameters
        ----------
        height : int
            Working height in pixels.
        frame_rate : float, optional
            Frames per second, where it is known; one outside 0.001 to 1000000 is not
            believed.

        Returns
        -------
        OpplodParams
            With `receptive_field` and `cell` as numbers: 5/12 and 1/30 of the
            height (100 and 8 px at 240), but at least 2 and 1 px; and with
            `frame_rate`, unless it is known neither here nor there.
        """
        believed = frame_rate if LOWEST_RATE <= (frame_rate or 0) <= HIGHEST_RATE else None
        field = self.receptive_field or max(2, round(height * 5 / 12))
        return self.replaced(
            receptive_field=field,
            cell=self.cell or max(1, min(1024, round(height / 30))),
            frame_rate=self.frame_rate or believed,
        )

    def frames(self, seconds: float) -> int:
        """Return how many frames a time lasts, at 30 per second where the rate is not known.

        Parameters
        ----------
        seconds : float
            The time, at least 0.

        Returns
        -------
        int
        """
        return round(seconds * (self.frame_rate or UNKNOWN_RATE))

    def rate_gain(self) -> float:
        """Return what R is multiplied by to refer it to the reference rate.

        At half the rate, edges move twice as far from frame to frame and P grows in
        proportion; S is referred to the time of a frame at the reference rate.

        Returns
        -------
        float
            ``(frame_rate / reference_rate) ^ (2 compression)``; 1 where either is not given.
        """
        if not self.reference_rate or not self.frame_rate:
            return 1.0
        gain: float = (self.frame_rate / self.reference_rate) ** (2 * self.compression)
        return gain

    def grid(self) -> tuple[int, int] | None:
        """Return the grid of units as (columns, rows), or None where every cell is one.

        Returns
        -------
        tuple of int or None
        """
        if self.units == "every":
            return None
        columns, rows = self.units.split("x")
        return int(columns), int(rows)


def axes_of(params: OpplodParams) -> tuple[int, int]:
    """Return the two axes of opponency.

    Parameters
    ----------
    params : OpplodParams
        Gives the first axis, 0 or 45 degrees.

    Returns
    -------
    tuple of int
        Directions in degrees, 90 apart.
    """
    return params.axes, params.axes + 90
