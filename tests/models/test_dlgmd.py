from __future__ import annotations

import numpy as np
import pytest

from oppload_cli.models.dlgmd import Dlgmd
from oppload_cli.models.parameters import DlgmdParams
from tests import reference
from tests.media import edge


@pytest.mark.parametrize("shape", [(31, 46), (4, 4), (3, 17)])
def test_agrees_with_the_literal_reference(shape: tuple[int, int]) -> None:
    rng = np.random.default_rng(3)
    # Black first: P(t-2) stays small, so that the threshold of grouping matters.
    frames = [rng.random(shape, dtype=np.float32) * scale for scale in (0, 0.1, 0.1, 1)]
    model = Dlgmd(shape)
    answers = [model.step(frame) for frame in frames]
    s, g = reference.dlgmd(reference.photoreceptors(frames))
    assert answers[:3] == [None, None, None]
    assert answers[3] is not None
    assert answers[3].s == pytest.approx(s.mean(), abs=1e-5)
    assert answers[3].response == pytest.approx(g.mean(), abs=1e-5)
    np.testing.assert_allclose(model.grouped, g, atol=1e-5)


@pytest.mark.parametrize(("limit", "kept"), [(0.25, 0.25), (0.2500001, 0.0)])
def test_grouping_keeps_what_equals_the_threshold(limit: float, kept: float) -> None:
    model = Dlgmd((9, 9), DlgmdParams(threshold_factor=1000, threshold_limit=limit))
    for frame in np.random.default_rng(2).random((4, 9, 9), dtype=np.float32):
        model.step(frame)
    model.dpc.presynaptic[:] = 0
    model.dpc.presynaptic[4, 4] = 0.5  # alone, so that C is 0.5 and G is 0.25
    if model.dpc.live is not None:
        model.dpc.live[4, 0] = 1
    model.respond()
    assert model.grouped[4, 4] == kept


def test_faster_edges_answer_more() -> None:
    responses = []
    for speed in (2, 4, 6, 10):
        model = Dlgmd((40, 200))
        responses.append([model.step(frame) for frame in edge(speed, 8)][-1])
    values = [each.response for each in responses if each]
    assert values[0] == 0
    assert values[1] < values[2] < values[3]


def test_a_still_scene_answers_nothing() -> None:
    model = Dlgmd((20, 20))
    frame = np.random.default_rng(0).random((20, 20), dtype=np.float32)
    answers = [model.step(frame) for _ in range(5)]
    assert answers[3] == answers[4] == model.at_rest()
