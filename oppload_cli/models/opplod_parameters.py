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
        "pooled",
        "how opposing motion is judged: 'pooled' over cells, 'pixelwise' as in the paper, or by "
        "the 'arms' of units like LPLC2 neurons",
        choices=("pooled", "pixelwise", "arms"),
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
        1.0,
        "side of the receptive field as a share of the working height, if receptive_field is auto",
        low=0.01,
        high=2,
    )
    cell_share: float = parameter(
        0.05,
        "side of a cell as a share of the working height, if cell is auto",
        low=0.001,
        high=0.5,
    )
    units: str = parameter("every", "grid of units such as 5x5 (columns x rows), or 'every' cell")
    pool_sigma: float = parameter(
        1.0, "sigma of the pooling over cells; 0: no pooling", unit="cells", low=0, high=10
    )
    axes: int = parameter(
        45, "first axis of opponency; the second is at a right angle", unit="deg", choices=(0, 45)
    )
    cone: float = parameter(
        60.0,
        "motion counts as outward (inward) if the angle between it and the line from (to) the "
        "unit's centre is at most this",
        unit="deg",
        low=1,
        high=90,
    )
    periphery: float = parameter(
        1.0, "weight w_p of inward motion, which is subtracted from outward", low=0, high=1000
    )
    threshold: float = parameter(
        0.0, "threshold of opponency, T_o; at or below it the response is 0", low=0, high=1e9
    )
    gain: float = parameter(1.0, "gain of enhancing, c2", low=0, high=1e9)
    compression: float = parameter(
        0.5, "exponent of the pooled S; below 1, contrast matters less", low=0.1, high=2
    )

    # Motion that is compared, counted or left out
    stride: int = parameter(
        2,
        "intervals between the frames that are compared; judgement=pooled divides S by it",
        low=1,
        high=16,
    )
    halved_weight: float = parameter(
        2.0,
        "weight of the R that is added from the frame at half its size, compared over one "
        "interval; only with judgement=pooled; 0: none is added",
        low=0,
        high=1000,
    )
    interpolated: str = parameter(
        "both",
        "OppLoD also sees pictures between frames 1.7 to 6.7 intervals apart, interpolated from "
        "both frames or from the earlier one; none: no such pictures",
        choices=INTERPOLATED,
    )
    border: int = parameter(
        6,
        "S is set to 0 in a strip of this width along the edges of the frame and of bars beside "
        "the picture; 0: no strip, and no search for bars",
        unit="px",
        low=0,
        high=1000,
    )
    entering: int = parameter(
        24,
        "S is also set to 0, up to this distance from the edge of the frame or of a bar, where "
        "motion reaches that edge without a break; 0: nowhere",
        unit="px",
        low=0,
        high=1000,
    )
    history: float = parameter(
        0.125,
        "S of a cell counts only if the change near the cell was, both one and two intervals ago, "
        "at least this share of the present change; a smaller change means that motion has only "
        "just begun; 0: S always counts",
        low=0,
        high=1,
    )
    passing: float = parameter(
        0.25,
        "R is 0 where an object passes: about the unit with the largest R if P of one interval "
        "ago, displaced by more than the kernels reach, equals P now except for less than this "
        "share; only with halved_weight above 0; 0: nowhere",
        low=0,
        high=1,
    )
    persistence: float = parameter(
        0.45,
        "share of its former R that a unit keeps after one interval; the time between two frames "
        "counts as at most 1.3 intervals",
        low=0,
        high=0.99,
    )
    sudden: float = parameter(
        0.15,
        "an alarm begins only if R without persistence, both now and one interval ago, is at least "
        "this share of R; only with judgement=pooled; 0: no such condition",
        low=0,
        high=1,
    )
    adaptation_level: float = parameter(
        0.035,
        "if the background of R is above this level, R is multiplied by level / background; the "
        "background is the median of the winning unit's R, which includes the motion that history "
        "leaves out; 0: never",
        low=0,
        high=1e9,
    )
    adaptation_s: float = parameter(
        4.0,
        "length of the background of R, which ends adaptation_guard_s before the latest frame",
        low=0.1,
        high=60,
    )
    # With 0.228 s and a quarter of a step, the adaptation begins with the first frame that counts
    # for the alarm, at 24 frames/s and more.
    adaptation_guard_s: float = parameter(
        0.228, "time before the latest frame that the background of R leaves out", low=0, high=60
    )

    # Changes of the picture by the camera, which are removed
    light_s: float = parameter(
        4.0,
        "time constant with which a lasting change of the light reaches the model; faster changes, "
        "by lamps or by the camera's exposure, are removed; 0: no change is removed",
        low=0,
        high=60,
    )
    residual_noise: float = parameter(
        0.004,
        "standard deviation of the noise that may be left: a frame with more noise is blurred; "
        "0: no frame is blurred",
        unit="luminance",
        low=0,
        high=1,
    )
    steady_view: bool = parameter(
        True,
        "True: P leaves out the turn and the shift of the complete picture, as by a camera that "
        "pans, shakes or rolls",
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
        zeros = (
            *("border", "entering", "pool_sigma", "periphery", "halved_weight", "persistence"),
            *("sudden", "history", "adaptation_level", "light_s", "residual_noise"),
        )
        literal: dict[str, object] = {"cell": 1, "cone": 90, "compression": 1, "stride": 1}
        literal |= {**dict.fromkeys(zeros, 0), "steady_view": False, "interpolated": "none"}
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
        2 and 1 px: 240 and 12 px at 240 px, and 100 and 8 px under preset ``reference``. If
        `kernel_height` is set, the DPC constants in px are scaled.

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
        R of the winning unit before enhancing, at least 0.
    calcium : float or None
        The largest calcium signal of all units, at least 0; None if ``calcium_s`` is 0.

    Examples
    --------
    >>> import oppload_cli as oppload
    >>> oppload.OpplodResponse(0.5, opponency=0.7).opponency
    0.7
    """

    opponency: float = 0.0
    calcium: float | None = None
