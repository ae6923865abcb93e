"""The parameters of OppLoD (``docs/model.md``, sections 4 and 5), and its answer."""

from __future__ import annotations

import math
import re
from dataclasses import dataclass

from oppload_cli.errors import ParameterError
from oppload_cli.models.detector import Response
from oppload_cli.models.dpc import DpcParams
from oppload_cli.schema import parameter

_LEAST_SIGMA = 0.01  # cells: below, a cell is pooled with itself alone


@dataclass(frozen=True, kw_only=True)
class _ArmParams(DpcParams):
    """Parameters of the arms; they count with ``judgement=arms`` only (preset ``lplc2``)."""

    kernel_height: int = parameter(
        0,
        "working height that the DPC constants in px are meant for; at another one they are "
        "scaled; 0: never",
        unit="px",
        low=0,
        high=8192,
    )
    graded: bool = parameter(
        True, "whether the arms see the graded direction of motion, or the four S_phi"
    )
    arm_cone: float = parameter(
        90.0, "half-width of the cone in which an arm is excited", unit="deg", low=1, high=180
    )
    suppression_cone: float = parameter(
        36.0, "half-width of the cone in which an arm is suppressed", unit="deg", low=1, high=180
    )
    suppression_field: float = parameter(
        1.7, "reach of suppression along an arm, over that of excitation", low=0.1, high=10
    )
    inward: float = parameter(5.0, "suppression by motion towards the middle", low=0, high=1000)
    lateral: float = parameter(4.0, "suppression by motion across the arm", low=0, high=1000)
    surround: float = parameter(
        0.25, "suppression by all motion in the field (normalisation)", low=0, high=1000
    )
    suppression_s: float = parameter(
        0.15, "time constant of suppression; 0: none", unit="s", low=0, high=60
    )
    half_saturation: float = parameter(
        1e-3, "excitation that fills half of an arm without suppression", low=1e-12, high=1e9
    )
    saturation: float = parameter(1.0, "exponent of an arm's saturation", low=0.05, high=20)
    arm_power: float = parameter(
        1.5, "exponent of the sum of the arms above the threshold", low=0.1, high=10
    )
    calcium_s: float = parameter(
        0.0, "time constant of the calcium signal; 0: none", unit="s", low=0, high=60
    )

    @property
    def least_scale(self) -> float:
        """The least scale at which the scaled constants are within their ranges."""
        ranges = {each.name: each for each in self.declared()}
        least: float = max(
            self.latency_lambda / (ranges["latency_lambda"].high or math.inf),
            (ranges["sigma_excitation"].low or 0) / self.sigma_excitation,
            (ranges["sigma_inhibition"].low or 0) / self.sigma_inhibition,
        )
        return least

    def scaled(self, scale: float) -> dict[str, float]:
        """Return the DPC constants in px at a working size that is `scale` times as large."""
        return {
            "sigma_excitation": self.sigma_excitation * scale,
            "sigma_inhibition": self.sigma_inhibition * scale,
            "kernel_radius": min(50, max(1, round(self.kernel_radius * scale))),
            "latency_lambda": self.latency_lambda / scale,
        }


@dataclass(frozen=True, kw_only=True)
class OpplodParams(_ArmParams):
    """Parameters of OppLoD: the DPC constants, opponency and enhancing (sections 4 and 5).

    Examples
    --------
    >>> import oppload_cli as oppload
    >>> oppload.OpplodParams().replaced(gain=2).gain
    2.0
    """

    judgement: str = parameter(
        "pooled",
        "opposing motion judgement: 'pooled' over cells, 'pixelwise' as the paper has it, or by "
        "the 'arms' of an LPLC2 neuron",
        choices=("pooled", "pixelwise", "arms"),
    )
    receptive_field: int | None = parameter(
        None,
        "side of a unit's square field; auto: field_share of the working height",
        unit="px",
        low=2,
        high=8192,
    )
    cell: int | None = parameter(
        None,
        "spacing of cells; auto: cell_share of the working height",
        unit="px",
        low=1,
        high=1024,
    )
    field_share: float = parameter(
        1.0,
        "side of an automatic receptive_field, as a share of the working height",
        low=0.01,
        high=2,
    )
    cell_share: float = parameter(
        0.05, "size of an automatic cell, as a share of the working height", low=0.001, high=0.5
    )
    pool_sigma: float = parameter(
        1.0, "spread of pooling; 0: no pooling", unit="cells", low=0, high=10
    )
    axes: int = parameter(
        45, "first axis of opponency; the other is 90 degrees on", unit="deg", choices=(0, 45)
    )
    border: int = parameter(
        6,
        "width of the strip along the edge of the frame, and along bars beside the picture, in "
        "which S is set to 0; 0: none, and bars are not looked for",
        unit="px",
        low=0,
        high=1000,
    )
    entering: int = parameter(
        24,
        "S is also 0 where motion reaches the edge of the frame, or of a bar, without a break: up "
        "to this distance; 0: nowhere",
        unit="px",
        low=0,
        high=1000,
    )
    compression: float = parameter(
        0.5, "exponent of the pooled S; below 1, contrast counts for less", low=0.1, high=2
    )
    stride: int = parameter(
        2,
        "compare frames that are this many intervals apart; judgement=pooled divides S by it",
        low=1,
        high=16,
    )
    halved_weight: float = parameter(
        2.0,
        "weight of R computed in a frame of half the size (smaller still at low frame rates), over "
        "one interval; with judgement=pooled only; 0: not computed",
        low=0,
        high=1000,
    )
    persistence: float = parameter(
        0.45,
        "share of its R that a unit keeps from one interval to the next; one picture counts as at "
        "most 1.3 intervals",
        low=0,
        high=0.99,
    )
    history: float = parameter(
        0.125,
        "S counts only where, one and two intervals ago, the change nearby was at least this share "
        "of the present one: with less, motion has only just begun there; 0: off",
        low=0,
        high=1,
    )
    adaptation_level: float = parameter(
        0.035,
        "where the recent median of R, with all motion counted, is above this level, R is "
        "multiplied by level / median; 0: never",
        low=0,
        high=1e9,
    )
    adaptation_s: float = parameter(
        4.0,
        "length of this background, which ends adaptation_guard_s before the latest frame",
        unit="s",
        low=0.1,
        high=60,
    )
    adaptation_guard_s: float = parameter(
        0.25,
        "time before the latest frame that does not yet count as background",
        unit="s",
        low=0,
        high=60,
    )
    light_s: float = parameter(
        4.0,
        "time constant with which a lasting change of the light is let through; faster changes, of "
        "lamps or by the exposure, are left out; 0: all changes count",
        unit="s",
        low=0,
        high=60,
    )
    cone: float = parameter(
        60.0,
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
        if 0 < self.pool_sigma < _LEAST_SIGMA:
            raise ParameterError(
                f"parameter 'pool_sigma' of opplod must be 0 or at least {_LEAST_SIGMA:g}, "
                f"not {self.pool_sigma:g}"
            )
        if self.judgement == "arms" and self.axes != 0:
            raise ParameterError(
                "parameter 'axes' of opplod must be 0 with judgement=arms (preset lplc2), whose "
                f"arms are cardinal, not {self.axes}"
            )
        if self.judgement == "pixelwise":
            self._check_pixelwise()

    def _check_pixelwise(self) -> None:
        literal = {
            "cell": 1,
            "border": 0,
            "entering": 0,
            "cone": 90,
            "pool_sigma": 0,
            "periphery": 0,
            "compression": 1,
            "stride": 1,
            "halved_weight": 0,
            "persistence": 0,
            "history": 0,
            "adaptation_level": 0,
            "light_s": 0,
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

    def resolved(self, height: int) -> OpplodParams:
        """Return these parameters with the values that depend on the video filled in.

        `receptive_field` and `cell` become their shares of the working height (240 and 12 px at
        240, and 100 and 8 px under preset ``reference``), but at least 2 and 1 px.

        Raises
        ------
        ParameterError
            If `kernel_height` is set, and the DPC constants cannot be scaled down so far.
        """
        scale = height / self.kernel_height if self.kernel_height else 1.0
        if scale < self.least_scale:
            least = math.ceil(self.kernel_height * self.least_scale)
            raise ParameterError(
                f"opplod with kernel_height={self.kernel_height} (preset lplc2) needs a working "
                f"height of at least {least} px, not {height}; raise --height"
            )
        return self.replaced(
            **self.scaled(scale),
            kernel_height=0,
            receptive_field=self.receptive_field
            or max(2, min(8192, round(height * self.field_share))),
            cell=self.cell or max(1, min(1024, round(height * self.cell_share))),
        )

    @property
    def cell_px(self) -> int:
        """`cell` of resolved parameters; a ParameterError for others."""
        return self._in_px("cell", self.cell)

    @property
    def field_px(self) -> int:
        """`receptive_field` of resolved parameters; a ParameterError for others."""
        return self._in_px("receptive_field", self.receptive_field)

    def _in_px(self, name: str, value: int | None) -> int:
        if value is None:
            raise ParameterError(
                f"parameter '{name}' of opplod follows the working height; take resolved(height)"
            )
        return value

    @property
    def both_axes(self) -> tuple[int, int]:
        """The two axes of opponency in degrees, 90 apart."""
        return self.axes, self.axes + 90

    def grid(self) -> tuple[int, int] | None:
        """Return the grid of units as (columns, rows), or None where every cell is a unit."""
        if self.units == "every":
            return None
        columns, rows = self.units.split("x")
        return int(columns), int(rows)


@dataclass(frozen=True)
class OpplodResponse(Response):
    """The answer of OppLoD to one frame.

    Attributes
    ----------
    response : float
        The enhanced response of the frame, at least 0.
    box : Box or None
        Receptive field of the winning unit in working pixels, centred where the object is
        looming; it may reach over the frame's edge. None where the response is 0.
    opponency : float
        R of the winning unit before enhancing, at least 0.
    calcium : float or None
        The largest calcium signal of all units, at least 0; None where there is none
        (``calcium_s`` is 0).

    Examples
    --------
    >>> import oppload_cli as oppload
    >>> oppload.OpplodResponse(0.5, opponency=0.7).opponency
    0.7
    """

    opponency: float = 0.0
    calcium: float | None = None
