"""The parameters of OppLoD (``docs/model.md``, sections 4 and 5), and its response."""

from __future__ import annotations

import math
import re
from dataclasses import dataclass

from oppload_cli.errors import ParameterError
from oppload_cli.models.detector import INTERPOLATED, Response
from oppload_cli.models.dpc import DpcParams
from oppload_cli.schema import parameter

_LEAST_SIGMA = 0.01  # cells; with a smaller sigma no cell is pooled with its neighbours


@dataclass(frozen=True, kw_only=True)
class OpplodParams(DpcParams):
    """Parameters of OppLoD: DPC, opponency and enhancing (``docs/model.md``, sections 4 and 5).

    Examples
    --------
    >>> import oppload_cli as oppload
    >>> oppload.OpplodParams().replaced(gain=2).gain
    2.0
    """

    # Opposing motion judgement and enhancing
    judgement: str = parameter(
        "agreement",
        "how opposing motion is judged: 'pooled' over cells, in 'agreement' of this with the "
        "growth that the flow shows, 'pixelwise' as in the paper, or by the 'arms' of units like "
        "LPLC2 neurons",
        choices=("agreement", "pooled", "pixelwise", "arms"),
    )
    receptive_field: int | None = parameter(
        None,
        "side of a unit's square receptive field; auto: field_share times the working height",
        unit="px",
        low=2,
        high=8192,
    )
    cell: int | None = parameter(
        None,
        "side of a cell, and spacing of the cells; auto: cell_share times the working height",
        unit="px",
        low=1,
        high=1024,
    )
    field_share: float = parameter(
        5 / 12,
        "side of the receptive field as a share of the working height, if receptive_field is auto",
        low=0.01,
        high=2,
    )
    cell_share: float = parameter(
        1 / 30,
        "side of a cell as a share of the working height, if cell is auto",
        low=0.001,
        high=0.5,
    )
    units: str = parameter("every", "grid of units such as 5x5 (columns x rows), or 'every' cell")
    pool_sigma: float = parameter(
        1.5, "sigma of the pooling over cells; 0: no pooling", unit="cells", low=0, high=10
    )
    axes: int = parameter(
        45, "first axis of opponency; the second is at a right angle", unit="deg", choices=(0, 45)
    )
    periphery: float = parameter(
        1.0, "weight w_p of inward motion, which is subtracted from outward", low=0, high=1000
    )
    threshold: float = parameter(
        0.0, "threshold of opponency, T_o; at or below it the response is 0", low=0, high=1e9
    )
    gain: float = parameter(1.0, "gain of enhancing, c2", low=0, high=1e9)

    # Motion that is compared or left out
    interpolated: str = parameter(
        "earlier",
        "OppLoD also sees pictures between frames 1.7 to 6.7 intervals apart, interpolated from "
        "the earlier one; none: no such pictures",
        choices=INTERPOLATED,
    )
    history: float = parameter(
        0.125,
        "S of a cell counts only if the change near the cell was, both one and two intervals ago, "
        "at least this share of the present change; a smaller change means that motion has only "
        "just begun; 0: S always counts",
        low=0,
        high=1,
    )

    # Growth, the second witness; only with ``judgement=agreement``
    growth_share: float = parameter(
        0.3,
        "side of the window in which growth is measured, as a share of the working height; the "
        "focus of expansion may be about as far from its middle",
        low=0.05,
        high=1,
    )
    growth_memory_s: float = parameter(
        0.1, "time constant with which growth is followed along its motion", low=0, high=10
    )
    opponency_weight: float = parameter(
        0.15, "exponent of the units' response in its product with the growth", low=0, high=10
    )
    opponency_floor: float = parameter(
        1e-6,
        "added to the opponent units' response, so that units which do not see an object, as "
        "before a ground that moves, lower the product only to a limit",
        low=1e-12,
        high=1e9,
    )

    # Scale of the kernels
    kernel_height: int = parameter(
        0,
        "working height for which the DPC constants in px are given; at another working height "
        "they are scaled in proportion; 0: never scaled",
        unit="px",
        low=0,
        high=8192,
    )

    # Parameters that have an effect with ``judgement=arms`` only (preset ``lplc2``)
    graded: bool = parameter(
        True, "True: the arms use the direction of motion from both axes; False: the four S_phi"
    )
    arm_cone: float = parameter(
        90.0, "half-width of the cone where motion excites an arm", unit="deg", low=1, high=180
    )
    suppression_cone: float = parameter(
        36.0, "half-width of the cone where motion suppresses an arm", unit="deg", low=1, high=180
    )
    suppression_field: float = parameter(
        1.7, "reach of an arm's suppression, divided by that of its excitation", low=0.1, high=10
    )
    inward: float = parameter(
        5.0,
        "suppression of an arm by motion towards the middle; only with judgement=arms; pooled "
        "judgement has periphery",
        low=0,
        high=1000,
    )
    lateral: float = parameter(4.0, "suppression of an arm by motion across it", low=0, high=1000)
    surround: float = parameter(
        0.25, "suppression of an arm by all motion in the field (normalisation)", low=0, high=1000
    )
    suppression_s: float = parameter(
        0.15, "time constant of suppression; 0: it acts at once", low=0, high=60
    )
    half_saturation: float = parameter(
        1e-3, "excitation at which an arm without suppression responds by half", low=1e-12, high=1e9
    )
    saturation: float = parameter(1.0, "exponent of an arm's saturation", low=0.05, high=20)
    arm_power: float = parameter(
        1.5, "exponent of that part of the arms' sum that is above the threshold", low=0.1, high=10
    )
    calcium_s: float = parameter(
        0.0, "time constant of the calcium signal; 0: no calcium signal", low=0, high=60
    )

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
        literal: dict[str, object] = {
            "cell": 1,
            "pool_sigma": 0,
            "periphery": 0,
            "history": 0,
            "interpolated": "none",
        }
        for name, value in literal.items():
            if getattr(self, name) != value:
                raise ParameterError(
                    f"parameter '{name}' of opplod must be {value} with judgement=pixelwise "
                    f"(preset paper), which follows the paper's text literally"
                )
        if self.units == "every":
            raise ParameterError(
                "parameter 'units' of opplod must be a grid such as 5x5 with judgement=pixelwise"
            )

    def resolved(self, height: int) -> OpplodParams:
        """Return these parameters with the values that depend on the working height filled in.

        If `receptive_field` and `cell` are None they become shares of the working height, at least
        2 and 1 px: 100 and 8 px at 240 px. If `kernel_height` is set, the DPC constants in px are
        scaled.

        Raises
        ------
        ParameterError
            If the scaled DPC constants leave their allowed ranges.
        """
        scale = height / self.kernel_height if self.kernel_height else 1.0
        ranges = {each.name: each for each in self.declared()}
        least_scale = max(
            self.latency_lambda / (ranges["latency_lambda"].high or math.inf),
            (ranges["sigma_excitation"].low or 0) / self.sigma_excitation,
            (ranges["sigma_inhibition"].low or 0) / self.sigma_inhibition,
        )
        if scale < least_scale:
            raise ParameterError(
                f"opplod with kernel_height={self.kernel_height} (preset lplc2) needs a working "
                f"height of at least {math.ceil(self.kernel_height * least_scale)} px, not "
                f"{height}; raise the working height (--height)"
            )
        return self.replaced(
            sigma_excitation=self.sigma_excitation * scale,
            sigma_inhibition=self.sigma_inhibition * scale,
            kernel_radius=min(50, max(1, round(self.kernel_radius * scale))),
            latency_lambda=self.latency_lambda / scale,
            kernel_height=0,
            receptive_field=self.receptive_field
            or max(2, min(8192, round(height * self.field_share))),
            cell=self.cell or max(1, min(1024, round(height * self.cell_share))),
        )

    @property
    def cell_px(self) -> int:
        """`cell` of resolved parameters; a ParameterError if it is still None."""
        return self._in_px("cell")

    @property
    def field_px(self) -> int:
        """`receptive_field` of resolved parameters; a ParameterError if it is still None."""
        return self._in_px("receptive_field")

    def _in_px(self, name: str) -> int:
        value: int | None = getattr(self, name)
        if value is None:
            raise ParameterError(
                f"parameter '{name}' of opplod depends on the working height; call resolved(height)"
            )
        return value

    @property
    def both_axes(self) -> tuple[int, int]:
        """The two axes of opponency in degrees, 90 apart."""
        return self.axes, self.axes + 90

    def grid(self) -> tuple[int, int] | None:
        """Return the grid of units as (columns, rows), or None if every cell is a unit."""
        if self.units == "every":
            return None
        columns, rows = self.units.split("x")
        return int(columns), int(rows)


@dataclass(frozen=True)
class OpplodResponse(Response):
    """The response of OppLoD to one frame.

    Attributes
    ----------
    response : float
        The enhanced response of the frame, at least 0.
    box : Box or None
        Receptive field of the winning unit in working pixels; the object looms at its centre. The
        box may reach over the frame's edge. None if the response is 0.
    opponency : float
        R of the winning unit before enhancing, at least 0; with ``judgement=agreement`` the
        enhanced response of the units around the place, ``c2 R^2``.
    growth : float or None
        Growth at the place in 1/s, at least 0; None unless ``judgement=agreement``, and where no
        flow can be measured.
    calcium : float or None
        The largest calcium signal of all units, at least 0; None if ``calcium_s`` is 0.

    Examples
    --------
    >>> import oppload_cli as oppload
    >>> oppload.OpplodResponse(0.5, opponency=0.7).opponency
    0.7
    """

    opponency: float = 0.0
    growth: float | None = None
    calcium: float | None = None
