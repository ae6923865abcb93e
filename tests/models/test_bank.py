from __future__ import annotations

import cv2
import numpy as np
import pytest

from oppload_cli.errors import ParameterError
from oppload_cli.models import crew
from oppload_cli.models.bank import ModelBank
from oppload_cli.models.dlgmd import Dlgmd
from oppload_cli.models.opplod import Opplod
from oppload_cli.models.parameters import DlgmdParams, OpplodParams
from tests.media import looming


@pytest.mark.parametrize("sigma", [5.0, 4.0])
def test_shared_layers_change_no_answer(sigma: float) -> None:
    """With equal DPC constants the layers are shared, with others they are not."""
    frames = looming(120, 60, 60, 10)
    opplod, dlgmd = OpplodParams(), DlgmdParams(sigma_inhibition=sigma)
    bank = ModelBank((120, 120), [opplod, dlgmd])
    alone: dict[str, Opplod | Dlgmd] = {
        "opplod": Opplod((120, 120), opplod),
        "dlgmd": Dlgmd((120, 120), dlgmd),
    }
    for frame in frames:
        together = bank.step(frame)
        assert together == {name: model.step(frame) for name, model in alone.items()}
    assert list(together) == ["opplod", "dlgmd"]
    assert bank.luma_change == pytest.approx(float(np.abs(frames[-1] - frames[-2]).mean()))


def test_reset_starts_over() -> None:
    frames = looming(60, 30, 30, 6)
    bank = ModelBank((60, 60), [OpplodParams(), DlgmdParams()])
    first = [bank.step(frame) for frame in frames]
    bank.reset()
    assert [bank.step(frame) for frame in frames] == first
    assert bank.luma_change is not None


def test_no_model_is_an_error() -> None:
    with pytest.raises(ParameterError, match="no model is chosen"):
        ModelBank((9, 9), [])


def test_the_number_of_threads_changes_no_bit(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(crew, "LARGE", 1)
    frames = list(np.random.default_rng(4).random((7, 90, 131), dtype=np.float32))
    before = cv2.getNumThreads()
    answers, maps = [], []
    try:
        for threads in (1, 2, 5):
            cv2.setNumThreads(threads)
            bank = ModelBank((90, 131), [OpplodParams(), DlgmdParams()])
            answers.append([bank.step(frame) for frame in frames])
            opplod, dlgmd = bank.models.values()
            assert isinstance(opplod, Opplod)
            assert isinstance(dlgmd, Dlgmd)
            maps.append([*(each.tobytes() for each in opplod.pathways.values()), dlgmd.grouped])
    finally:
        cv2.setNumThreads(before)
    assert answers[0] == answers[1] == answers[2]
    assert answers[0][-1]["opplod"] is not None
    np.testing.assert_equal(maps[1:], [maps[0], maps[0]])
