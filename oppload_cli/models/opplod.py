"""OppLoD, the opponency based looming detector (``docs/model.md``, sections 4 and 5)."""

from __future__ import annotations

from copy import deepcopy
from typing import TYPE_CHECKING, ClassVar

from oppload_cli.models.agreement import AgreementJudgement
from oppload_cli.models.arms import ArmsJudgement
from oppload_cli.models.detector import Column, Detector
from oppload_cli.models.opplod_parameters import OpplodParams, OpplodResponse
from oppload_cli.models.opposing_motion import PixelwiseJudgement, PooledJudgement
from oppload_cli.motion.flow import SHORTEST_SIDE

if TYPE_CHECKING:
    from typing import Any

    from oppload_cli.models.detector import UnitMaps
    from oppload_cli.models.dpc import Map

# The paper's model, made to work at any frame rate, without the growth that `default` adds.
_REFERENCE = OpplodParams(judgement="pooled")

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
    judgement : PooledJudgement, AgreementJudgement, PixelwiseJudgement or ArmsJudgement
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
    answers_to = "edges that move outward from a centre on opposite sides, where the flow grows too"
    made_for = "240 px high, 30 frames/s; other rates by its presentation times"
    cost_ms = 2.6
    meaning = "OppLoD: DPC, directional inhibition, opponency, enhancing, growth"
    response_column = (
        "",
        "response of OppLoD: under preset default the growth times a power of the units' enhanced "
        "response, else the enhanced response; empty during warm-up",
    )
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
    alarm_floors: ClassVar = {"default": 0.09, "reference": 8e-4}
    alarm_factor = 0.0  # the growth of a scene that always moves does not reach the floor
    by_default = True
    warm_up = 3  # S needs P now, one and two intervals ago
    columns: ClassVar = (
        Column(
            "growth",
            "1/s",
            "second witness: growth of what is at the place; empty where no flow can be measured",
            "default",
        ),
        Column(
            "opponency",
            "",
            "first witness: largest enhanced response of the units whose fields reach the place",
            "default",
        ),
        Column(
            "calcium",
            "",
            "response as a calcium indicator shows it: the largest low-passed response of a unit",
            "lplc2",
        ),
    )
    witnesses = "growth", "opponency"
    places = True

    params: OpplodParams

    def __init__(
        self, shape: tuple[int, int], params: OpplodParams | None = None, **others: Any
    ) -> None:
        super().__init__(shape, params, **others)
        own, clock = self.params, self.layers.clock
        self._dpc = self.layers.dpc(own, own.both_axes)
        self._measured = min(shape) >= SHORTEST_SIDE
        self.judgement: PooledJudgement | AgreementJudgement | PixelwiseJudgement | ArmsJudgement
        if own.judgement == "agreement":
            self.judgement = AgreementJudgement(shape, own, clock.per_second)
        elif own.judgement == "pooled":
            self.judgement = PooledJudgement(shape, own, clock.per_second)
        elif own.judgement == "arms":
            self.judgement = ArmsJudgement(shape, own, clock.per_second)
        else:
            self.judgement = PixelwiseJudgement(shape, own)

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
        self._dpc.reset()
        self.layers.flow().reset()
        self.judgement.reset()

    def at_rest(self) -> OpplodResponse:
        """Return the response, 0, to a frame in which nothing changed.

        The calcium signal keeps its latest value, so that it does not change during a few repeats.
        In a scene at rest it falls, because then the detector gets every frame.
        """
        judgement = self.judgement
        calcium = judgement.calcium if isinstance(judgement, ArmsJudgement) else None
        growth = 0.0 if isinstance(judgement, AgreementJudgement) and self._measured else None
        return OpplodResponse(0.0, growth=growth, calcium=calcium)

    def step(self, luma: Map) -> OpplodResponse | None:
        """Take the next frame: MDE, OMJ, enhancing, and growth.

        The result is None until frames have been compared over three intervals.
        """
        frames, judgement = self._dpc.frames, self.judgement
        ready = self._dpc.step(luma)
        if not isinstance(judgement, AgreementJudgement):
            return judgement.judge(self._dpc.layer) if ready else None
        elapsed = self._dpc.layer.photoreceptors.elapsed if frames else 0.0
        judgement.see(self.layers.flow().of(luma, frames), elapsed)
        return judgement.respond(self._dpc.layer, measured=self._measured) if ready else None
