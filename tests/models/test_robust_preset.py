"""What preset `robust` adds to the model, against the literal reference and closed forms."""

from __future__ import annotations

from fractions import Fraction
from typing import TYPE_CHECKING

import numpy as np
import pytest

from oppload_cli.errors import ParameterError
from oppload_cli.models.opplod import Opplod
from oppload_cli.models.opponency import PooledJudge
from oppload_cli.models.parameters import OpplodParams
from oppload_cli.models.presets import PRESETS
from tests import reference

if TYPE_CHECKING:
    from tests.media import Luma

PAPER, ROBUST = PRESETS["paper"].opplod, PRESETS["robust"].opplod
SHAPE = (40, 61)
SMALL = OpplodParams(receptive_field=30, cell=5, pool_sigma=1.0, periphery=0.7)


def random_frames() -> list[Luma]:
    """Seven frames, the last of high contrast: what excites there is not all inhibited."""
    rng = np.random.default_rng(5)
    contrasts = (0.01, 0.01, 0.02, 0.01, 0.03, 0.05, 1)
    return [rng.random(SHAPE, dtype=np.float32) * np.float32(each) for each in contrasts]


@pytest.mark.parametrize(
    "changes",
    [
        {"compression": 0.5},
        {"compression": 1.5},
        {"border": 6},
        {"strides": 2},
        {"strides": 2, "compression": 0.5},
        {"strides": 2, "compression": 0.5, "border": 4, "axes": 0},
    ],
)
def test_opponency_agrees_with_the_literal_reference(changes: dict[str, float]) -> None:
    frames = random_frames()
    model = Opplod(SHAPE, SMALL.replaced(**changes))
    answer = [model.step(frame) for frame in frames][-1]
    wanted = {"axes": 45, "strides": 1, "compression": 1.0, "border": 0, **changes}
    expected = reference.strided_opponency(
        frames, field=30, cell=5, sigma=1.0, w_p=0.7,
        axes=int(wanted["axes"]), strides=int(wanted["strides"]),
        compression=wanted["compression"], border=int(wanted["border"]),
    )  # fmt: skip
    assert expected.max() > 1e-3
    assert answer is not None
    assert answer.opponency == pytest.approx(expected.max(), rel=3e-4)
    row, column = np.unravel_index(expected.argmax(), expected.shape)
    assert answer.box is not None
    assert answer.box.x + 15 == reference.centres(SHAPE[1], 5)[int(column)]
    assert answer.box.y + 15 == reference.centres(SHAPE[0], 5)[int(row)]


@pytest.mark.parametrize("border", [0, 3, 19, 20, 50])
def test_the_border_answers_nothing(border: int) -> None:
    model = Opplod(SHAPE, SMALL.replaced(border=border))
    for frame in random_frames():
        model.step(frame)
    for values in model.pathways.values():
        inner = values[border : SHAPE[0] - border, border : SHAPE[1] - border]
        assert np.count_nonzero(values) == np.count_nonzero(inner)
        assert np.count_nonzero(inner) > 0 or border > 3


@pytest.mark.parametrize("compression", [0.5, 1.0])
def test_a_contrast_counts_to_the_power_of_the_compression(compression: float) -> None:
    """S is linear in the luminance, a product has two of them, and the response R^2 four."""
    peaks = []
    for contrast in (1.0, 0.25):
        model = Opplod(SHAPE, SMALL.replaced(compression=compression))
        answers = [model.step(frame * np.float32(contrast)) for frame in random_frames()]
        assert answers[-1] is not None
        peaks.append(answers[-1].response)
    assert peaks[1] / peaks[0] == pytest.approx(0.25 ** (4 * compression), rel=1e-4)


@pytest.mark.parametrize(
    ("rate", "reference_rate", "compression", "gain"),
    [
        (30, 30, 0.5, 1),
        (15, 30, 0.5, 0.5),
        (60, 30, 0.5, 2),
        (60, 30, 1, 4),
        (None, 30, 0.5, 1),
        (60, 0, 0.5, 1),
    ],
)
def test_the_response_is_referred_to_the_reference_rate(
    rate: float | None, reference_rate: float, compression: float, gain: float
) -> None:
    params = SMALL.replaced(frame_rate=rate, reference_rate=reference_rate, compression=compression)
    assert params.rate_gain() == pytest.approx(gain)
    here, there = (Opplod(SHAPE, each) for each in (params, params.replaced(reference_rate=0.0)))
    for frame in random_frames():
        answer, plain = here.step(frame), there.step(frame)
    assert answer is not None
    assert plain is not None
    assert answer.opponency == pytest.approx(gain * plain.opponency, rel=1e-5)
    assert answer.response == pytest.approx(gain**2 * plain.response, rel=1e-5)


def test_adaptation_divides_by_the_median_of_what_has_been() -> None:
    """Reach 8 frames and guard 2 at 16 frames/s, recomputed literally on random maps."""
    params = SMALL.replaced(
        frame_rate=16.0, adaptation_level=2.0, adaptation_s=0.5, adaptation_guard_s=0.125
    ).resolved(SHAPE[0])
    judge = PooledJudge(SHAPE, params)
    plain = PooledJudge(SHAPE, params.replaced(adaptation_level=0.0))
    rng = np.random.default_rng(3)
    raw: list[float] = []
    divided = 0
    for t in range(30):
        maps = {
            phi: rng.random(SHAPE, dtype=np.float32) * (1 + t % 4) for phi in range(45, 360, 90)
        }
        verdict = judge.judge(maps)
        before = sorted(raw[max(0, t - 10) : max(0, t - 2)])
        background = before[len(before) // 2] if before else 0.0
        raw.append(plain.judge(maps).opponency)
        factor = min(1.0, 2.0 / background) if background else 1.0
        divided += factor < 1
        assert verdict.opponency == pytest.approx(factor * raw[-1], rel=1e-5)
        assert verdict.response == pytest.approx((factor * raw[-1]) ** 2, rel=1e-5)
        assert judge.maps.responses.max() == pytest.approx(verdict.response, rel=1e-5)
    assert divided > 15


def test_frames_are_counted_at_30_per_second_where_the_rate_is_not_known() -> None:
    assert OpplodParams().frames(0.2) == 6
    assert OpplodParams(frame_rate=60.0).frames(0.2) == 12


@pytest.mark.parametrize(
    ("own", "stated", "known"),
    [
        (None, 25.0, 25.0),
        (50.0, 25.0, 50.0),
        (None, None, None),
        (None, 0.0, None),
        (None, 1e9, None),
        (None, 1e-9, None),
        (None, float(Fraction(30000, 1001)), 30000 / 1001),
    ],
)
def test_the_frame_rate_is_that_of_the_video(
    own: float | None, stated: float | None, known: float | None
) -> None:
    assert OpplodParams(frame_rate=own).resolved(240, stated).frame_rate == known


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("border", 6),
        ("compression", 0.5),
        ("strides", 2),
        ("reference_rate", 30.0),
        ("adaptation_level", 0.05),
        ("pool_sigma", 1.0),
        ("periphery", 1.0),
    ],
)
def test_the_paper_to_the_letter_has_none_of_it(name: str, value: float) -> None:
    with pytest.raises(ParameterError, match=f"'{name}' of opplod must be .* judgement=pixelwise"):
        PAPER.replaced(**{name: value})


def test_the_fields_of_the_preset() -> None:
    resolved = ROBUST.resolved(240, 30)
    assert (resolved.receptive_field, resolved.cell, resolved.border) == (240, 12, 6)
    assert resolved.rate_gain() == 1
    assert ROBUST.resolved(240, 15).rate_gain() == 0.5
