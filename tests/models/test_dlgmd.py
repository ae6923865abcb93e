from __future__ import annotations

import numpy as np
import pytest

from oppload_cli.models.dlgmd import Dlgmd, DlgmdParams, threshold
from oppload_cli.models.layers import Layers
from oppload_cli.models.timebase import Clock
from tests import reference
from tests.media import edge


@pytest.mark.parametrize("shape", [(31, 46), (4, 4), (3, 17), (1, 1), (5, 90)])
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
    assert answers[3].box is None
    np.testing.assert_allclose(model.grouped, g, atol=1e-5)
    model.reset()
    assert not any(each.any() for each in model.maps.values())


@pytest.mark.parametrize("q", [0.8, 1.2])
def test_the_law_for_other_intervals_agrees_with_its_equations(q: float) -> None:
    """docs/explanation/frame-times.md; the interval of the earliest change has its own q, 0.6."""
    rng = np.random.default_rng(3)
    frames = [rng.random((31, 46), dtype=np.float32) * scale for scale in (0, 0.01, 0.02, 1)]
    for each in frames[1:]:
        each[:, :20] = 0.8  # a large change at first, far from the later ones: the threshold
    clock = Clock()
    model = Dlgmd((31, 46), layers=Layers((31, 46), clock))
    for frame, at in zip(frames, np.cumsum([0, 1 / 0.6, 1 / q, 1 / q]), strict=True):
        clock.time_s = at / 30
        answer = model.step(frame)
    p = reference.photoreceptors(frames)
    e, s = reference.excitation(p), reference.presynaptic(p)
    t = min(1.2 * 0.6 * p[0].mean(), 0.3)
    means = [(e.mean(), s.mean())]
    means.append(tuple(reference.grouped(each, 4, t, 1).mean() for each in (e, s)))
    expected = [
        min(q * of_e - (of_e - of_s), q**2 * of_s) if q > 1 else max(q * of_e - (of_e - of_s), 0)
        for of_e, of_s in means
    ]
    assert answer is not None
    assert [answer.s, answer.response] == pytest.approx(expected, rel=1e-4)
    assert min(expected) > 1e-3


def test_the_threshold_follows_the_change_two_frames_ago_up_to_a_limit() -> None:
    assert threshold(DlgmdParams(), 0.1) == pytest.approx(0.12)
    assert threshold(DlgmdParams(), 0.5) == 0.3
    assert threshold(DlgmdParams(threshold_factor=2, threshold_limit=0.7), 0.3) == 0.6


@pytest.mark.parametrize(("group_size", "limit"), [(1, 1.0), (7, 0.2)])
def test_parameters_of_grouping_act(group_size: int, limit: float) -> None:
    rng = np.random.default_rng(3)
    frames = [rng.random((20, 30), dtype=np.float32) * scale for scale in (0, 0.02, 0.02, 1)]
    model = Dlgmd((20, 30), DlgmdParams(group_size=group_size, grouped_limit=limit))
    for frame in frames:
        model.step(frame)
    p = reference.photoreceptors(frames)
    expected = reference.grouped(
        reference.presynaptic(p), group_size, min(1.2 * p[-3].mean(), 0.3), limit
    )
    np.testing.assert_allclose(model.grouped, expected, atol=1e-5)
    assert expected.max() > 0.05


def test_faster_edges_answer_more() -> None:
    responses = []
    for speed in (2, 4, 6, 10):
        model = Dlgmd((40, 200))
        responses.append([model.step(frame) for frame in edge(speed, 8)][-1])
    values = [each.response for each in responses if each]
    assert values[0] == 0
    assert values[1] < values[2] < values[3]


@pytest.mark.parametrize(("speed", "answers"), [(3, False), (10, True)])
def test_an_edge_answers_at_half_the_rate_if_it_does_at_30_frames_per_second(
    speed: int, answers: bool
) -> None:
    """The table of docs/model.md, section 3: S is 0 up to 3 px per interval, and 3.28 at 10."""
    clock = Clock()
    model = Dlgmd((40, 200), layers=Layers((40, 200), clock))
    for t, frame in enumerate(edge(2 * speed, 8)):
        clock.time_s = t / 15
        answer = model.step(frame)
    assert answer is not None
    assert (answer.response > 0, answer.s > 0) == (answers, answers)


def test_a_still_scene_answers_nothing() -> None:
    model = Dlgmd((20, 20))
    frame = np.random.default_rng(0).random((20, 20), dtype=np.float32)
    answers = [model.step(frame) for _ in range(5)]
    assert answers[3] == answers[4] == model.at_rest()
