"""OppLoD, the opponency based looming detector (``docs/model.md``, sections 4 and 5)."""

from __future__ import annotations

from copy import deepcopy
from typing import TYPE_CHECKING, ClassVar

from oppload_cli.models.arms import ArmsJudgement
from oppload_cli.models.camera import NO_BARS, Bars, NoiseFilter, SteadyLight, SteadyView, reduced
from oppload_cli.models.detector import Column, Detector
from oppload_cli.models.dpc import smaller
from oppload_cli.models.layers import Layers
from oppload_cli.models.opplod_parameters import OpplodParams, OpplodResponse
from oppload_cli.models.opposing_motion import PixelwiseJudgement, PooledJudgement

if TYPE_CHECKING:
    from typing import Any

    from oppload_cli.models.detector import UnitMaps
    from oppload_cli.models.dpc import Map
    from oppload_cli.models.layers import Dpc, SharedLayer

# The paper's model, made to work at any frame rate, without the parts that `default` adds for
# videos of cameras.
_REFERENCE = OpplodParams(
    field_share=5 / 12,
    cell_share=1 / 30,
    pool_sigma=1.5,
    border=0,
    entering=0,
    compression=1.0,
    stride=1,
    halved_weight=0.0,
    persistence=0.0,
    sudden=0.0,
    passing=0.0,
    light_s=0.0,
    residual_noise=0.0,
    steady_view=False,
    interpolated="earlier",
    adaptation_level=0.0,
    cone=90.0,
)

# Tuned to LPLC2 neurons (``docs/lplc2.md``): fields of 60 degrees on displays of 72 degrees.
_LPLC2 = _REFERENCE.replaced(
    judgement="arms",
    axes=0,
    kernel_height=240,
    field_share=5 / 6,
    cell_share=11 / 240,
    pool_sigma=0.5,
    arm_cone=87.0,
    suppression_cone=35.5,
    suppression_field=1.07,
    inward=35.0,
    lateral=11.5,
    surround=0.45,
    suppression_s=0.12,
    half_saturation=7e-4,
    saturation=0.92,
    threshold=0.65,
    arm_power=0.75,
    calcium_s=1.0,
)


class Opplod(Detector):
    """The OppLoD model; arguments as :class:`~oppload_cli.models.detector.Detector`.

    Give `frame_rate`, because without it each frame counts as 1/30 s.

    Attributes
    ----------
    judgement : PooledJudgement, PixelwiseJudgement or ArmsJudgement
        The opposing motion judgement that the parameters ask for.

    Source: the OppLoD paper; ``docs/model.md``, sections 1, 2, 4 and 5.

    Examples
    --------
    >>> import oppload_cli as oppload
    >>> with oppload.open_source("controls/looming-perspective") as frames:
    ...     model = oppload.Opplod(frames.working.shape, frame_rate=frames.facts.frame_rate)
    ...     responses = [model.step(frame.luma) for frame in frames]
    >>> responses[0] is None, responses[80].response > 0
    (True, True)
    """

    name = "opplod"
    label = "OppLoD"
    colour = "#D55E00"
    year = 2023
    reference = "Shuang et al., OppLoD, arXiv:2302.10284"
    answers_to = "edges that move outward from a centre on opposite sides"
    made_for = "240 px high, 30 frames/s; other rates by its presentation times"
    cost_ms = 4.0
    meaning = "OppLoD: DPC, directional inhibition, opponency, enhancing"
    response_column = "", "enhanced response of OppLoD; empty during warm-up"
    responses = OpplodResponse
    parameters = OpplodParams
    presets: ClassVar = {
        "reference": _REFERENCE,
        "paper": _REFERENCE.replaced(
            judgement="pixelwise",
            interpolated="none",
            receptive_field=200,
            cell=1,
            pool_sigma=0.0,
            periphery=0.0,
            history=0.0,
            units="5x5",
        ),
        "lplc2": _LPLC2,
    }
    alarm_floors: ClassVar = {"default": 0.06, "reference": 8e-4}
    by_default = True
    warm_up = 3  # S needs P now, one and two intervals ago
    columns: ClassVar = (
        Column(
            "calcium",
            "",
            "response as a calcium indicator shows it: the largest low-passed response of a unit",
            "lplc2",
        ),
    )
    places = True

    params: OpplodParams

    def __init__(
        self, shape: tuple[int, int], params: OpplodParams | None = None, **others: Any
    ) -> None:
        super().__init__(shape, params, **others)
        own, layers, clock = self.params, self.layers, self.layers.clock
        self._make_camera_parts()
        # The filters change frames, the others P or S, so that layers cannot be shared.
        if self._filters or own.steady_view or own.entering:
            layers = Layers(shape, clock)
        self._dpc = layers.dpc(own, own.both_axes, own.stride)
        self._half: SharedLayer[Dpc] | None = None
        self.judgement: PooledJudgement | PixelwiseJudgement | ArmsJudgement
        if own.judgement == "pooled":
            if own.halved_weight:
                half = max(1, shape[0] // 2), max(1, shape[1] // 2)
                self._half = Layers(half, clock).dpc(own, own.both_axes)
            self.judgement = PooledJudgement(shape, own, clock.per_second)
        elif own.judgement == "arms":
            self.judgement = ArmsJudgement(shape, own, clock.per_second)
        else:
            self.judgement = PixelwiseJudgement(shape, own)

    def _make_camera_parts(self) -> None:
        """Make the parts that remove the effects of the camera, without an earlier frame."""
        params = self.params
        self._filters: list[SteadyLight | NoiseFilter] = []
        if params.light_s:
            self._filters.append(SteadyLight(params.light_s * self.layers.clock.per_second))
        if params.residual_noise:
            self._filters.append(NoiseFilter(params.residual_noise))
        self._view = SteadyView() if params.steady_view else None
        self._bars = Bars() if params.judgement == "pooled" and params.border else None

    @property
    def interpolated(self) -> str:
        """The pictures in between that it gets, as its parameters say."""
        return self.params.interpolated

    def separate(self) -> None:
        """Replace shared layers by copies of its own."""
        clock = self.layers.clock
        self._dpc = deepcopy(self._dpc, {id(clock): clock})  # all layers keep the same clock

    @property
    def units(self) -> UnitMaps:
        """The units at the latest frame."""
        return self.judgement.maps

    @property
    def maps(self) -> dict[str, Map]:
        """P, E, I, S and S_phi (``S_45`` ...) of the latest frame, shape (height, width)."""
        return self._dpc.layer.maps

    @property
    def pathways(self) -> dict[int, Map]:
        """S_phi of the latest frame, shape (height, width), by direction phi in degrees."""
        return self._dpc.layer.sums.pathways

    def reset(self) -> None:
        """Forget all frames: the next frame is frame 0."""
        self._make_camera_parts()
        for part in (self._dpc, self._half, self.judgement):
            if part:
                part.reset()

    def at_rest(self) -> OpplodResponse:
        """Return the response, 0, to a frame in which nothing changed.

        The calcium signal keeps its latest value, so that it does not change during a few repeats.
        In a scene at rest it falls, because then the detector gets every frame.
        """
        judgement = self.judgement
        calcium = judgement.calcium if isinstance(judgement, ArmsJudgement) else None
        return OpplodResponse(0.0, calcium=calcium)

    def step(self, luma: Map) -> OpplodResponse | None:
        """Take the next frame: MDE, OMJ, enhancing.

        The result is None until frames have been compared over three intervals, at the working size
        or at half of it.
        """
        dpc = self._dpc.layer
        photoreceptors = dpc.photoreceptors
        if self._bars or self._filters or self._view:  # they come before the check by the layers
            photoreceptors.check(luma)
        if self._bars:
            self._bars.step(luma, photoreceptors.usual_step)
        for each in self._filters:
            luma = each.step(luma, photoreceptors.usual_step)
        if self._view:
            photoreceptors.view = self._view.step(luma, photoreceptors.usual_step)
            if self._half:
                self._half.layer.photoreceptors.view = reduced(photoreceptors.view, 2)
        ready = self._dpc.step(luma)
        if self._half:
            ready |= self._half.step(smaller(luma, 2))
        if not ready:
            return None
        if not isinstance(self.judgement, PooledJudgement):
            return self.judgement.judge(dpc)
        half = self._half.layer if self._half else None
        return self.judgement.judge(dpc, half, self._bars.widths if self._bars else NO_BARS)
