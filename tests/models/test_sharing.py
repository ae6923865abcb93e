"""Layers that several detectors share are computed once, and sharing changes no answer."""

from __future__ import annotations

from collections import Counter
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

from oppload_cli.errors import FrameError
from oppload_cli.models import layers as module
from oppload_cli.models.bank import DetectorBank
from oppload_cli.models.dlgmd import DlgmdParams
from oppload_cli.models.dpc import DpcParams
from oppload_cli.models.flow_divergence import FlowDivergenceParams
from oppload_cli.models.frame_difference import FrameDifferenceParams
from oppload_cli.models.layers import Layers
from oppload_cli.models.opplod import OpplodParams
from oppload_cli.models.opplod_reference import OpplodReferenceParams
from oppload_cli.models.registry import detector_of
from oppload_cli.motion.flow import DenseFlow
from tests.media import looming

if TYPE_CHECKING:
    from collections.abc import Callable

    from oppload_cli.models.detector import Detector, Response
    from oppload_cli.schema import Parameters

pytestmark = pytest.mark.once

SHAPE = (120, 120)
FRAMES = looming(120, 60, 60, 12)
OPPLOD, REFERENCE = OpplodParams(), OpplodReferenceParams()
DLGMD, DIFFERENCE = DlgmdParams(), FrameDifferenceParams()
FLOW = FlowDivergenceParams()
OTHER_SIGMA = DlgmdParams(sigma_inhibition=4.0)


@pytest.fixture
def calls(monkeypatch: pytest.MonkeyPatch) -> Counter[str]:
    """Count how often the layers are computed."""
    counted: Counter[str] = Counter()

    def counting(name: str) -> Callable[..., Any]:
        function = getattr(module, name)

        def count(*args: Any) -> Any:
            counted[name] += 1
            return function(*args)

        return count

    for name in ("photoreceptors", "presynaptic_sums"):
        monkeypatch.setattr(module, name, counting(name))
    measure = DenseFlow.step

    def flow(*args: Any) -> Any:
        counted["flow"] += 1
        return measure(*args)

    monkeypatch.setattr(DenseFlow, "step", flow)
    return counted


@pytest.mark.parametrize(
    ("params", "photoreceptors", "sums", "flows"),
    [
        ([DIFFERENCE], 11, 0, 0),
        ([DLGMD], 11, 9, 0),
        ([REFERENCE, DLGMD, DIFFERENCE], 11, 9, 0),
        ([DLGMD, DIFFERENCE, REFERENCE], 11, 18, 0),  # the first one asks for no pathways
        ([REFERENCE, OTHER_SIGMA], 11, 18, 0),
        ([OPPLOD], 11, 9, 12),
        ([OPPLOD, DLGMD, DIFFERENCE], 11, 9, 12),
        ([OPPLOD, FLOW], 11, 9, 12),
        ([FLOW, OPPLOD], 11, 9, 12),
        ([OPPLOD, REFERENCE, DLGMD], 11, 9, 12),
    ],
)
def test_equal_layers_are_computed_once(
    calls: Counter[str], params: list[Parameters], photoreceptors: int, sums: int, flows: int
) -> None:
    bank = DetectorBank(SHAPE, params)
    for _ in range(2):
        for frame in FRAMES:
            bank.step(frame)
        assert (calls["photoreceptors"], calls["presynaptic_sums"]) == (photoreceptors, sums)
        assert calls["flow"] == flows
        calls.clear()
        bank.reset()


@pytest.mark.parametrize(
    "params",
    [
        [REFERENCE, DLGMD, DIFFERENCE],
        [DLGMD, REFERENCE],
        [OPPLOD, REFERENCE],
        [REFERENCE, OTHER_SIGMA],
        [DIFFERENCE, OPPLOD, DLGMD],
        [FLOW, OPPLOD],
        [REFERENCE.replaced(axes=0), DLGMD],
    ],
)
def test_sharing_changes_no_answer(params: list[Parameters]) -> None:
    bank = DetectorBank(SHAPE, params)
    alone: dict[str, Detector] = {
        detector_of(chosen).name: detector_of(chosen)(SHAPE, chosen) for chosen in params
    }
    peaks: Counter[str] = Counter()
    for frame in FRAMES:
        together = bank.step(frame)
        assert together == {name: detector.step(frame) for name, detector in alone.items()}
        for name, answer in together.items():
            peaks[name] = max(peaks[name], bool(answer and answer.response))
    assert list(together) == [detector_of(chosen).name for chosen in params]
    assert set(peaks.values()) == {1}


def test_detectors_with_other_axes_have_layers_of_their_own(calls: Counter[str]) -> None:
    layers = Layers(SHAPE)
    holds = [
        layers.dpc(DpcParams(), (45, 135)),
        layers.dpc(DpcParams(), (0, 90)),
        layers.dpc(DpcParams()),  # S is the same with any axes
        layers.dpc(REFERENCE, (0, 90)),  # only its DPC constants matter
    ]
    assert holds[0].layer is not holds[1].layer
    assert holds[2].layer is holds[0].layer
    assert holds[3].layer is holds[1].layer
    for frame in FRAMES:
        assert len({hold.step(frame) for hold in holds}) == 1
    assert (calls["photoreceptors"], calls["presynaptic_sums"]) == (11, 18)


def test_a_refused_frame_is_refused_once_and_changes_no_answer() -> None:
    params = [OPPLOD, DLGMD, DIFFERENCE]
    bank, other = DetectorBank(SHAPE, params), DetectorBank(SHAPE, params)
    answers: list[dict[str, Response | None]] = []
    for frame in FRAMES:
        with pytest.raises(FrameError):
            bank.step(frame[:-1])
        with pytest.raises(FrameError, match="not finite"):
            bank.step(np.full(SHAPE, np.nan, np.float32))
        answers.append(bank.step(frame))
        assert answers[-1] == other.step(frame)
        assert bank.luma_change == other.luma_change
    assert any(found["opplod"] and found["opplod"].response for found in answers)
