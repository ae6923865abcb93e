"""Layers of frames several apart, against layers that see every n-th frame alone."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import pytest

from oppload_cli.errors import FrameError
from oppload_cli.models.bank import ModelBank
from oppload_cli.models.layers import Dpc
from oppload_cli.models.opplod import Opplod, OpplodResponse
from oppload_cli.models.parameters import DlgmdParams, DpcParams, OpplodParams
from oppload_cli.models.presets import PRESETS
from oppload_cli.models.strides import StridedDpc
from tests.media import looming

if TYPE_CHECKING:
    from tests.media import Luma

AXES = (45, 135)
SHAPE = (30, 41)
ROBUST = PRESETS["robust"].opplod


def random_frames(count: int, shape: tuple[int, int] = SHAPE) -> list[Luma]:
    return list(np.random.default_rng(21).random((count, *shape), dtype=np.float32))


@pytest.mark.parametrize("stride", [1, 2, 3])
def test_every_frame_is_seen_as_models_of_every_nth_frame_see_it(stride: int) -> None:
    frames = random_frames(4 * stride + 3)
    strided = StridedDpc(SHAPE, DpcParams(), AXES, stride)
    ready = []
    for t, frame in enumerate(frames):
        ready.append(strided.step(frame))
        alone = Dpc(SHAPE, DpcParams(), AXES)
        for each in frames[t % stride : t + 1 : stride]:
            alone.step(each)
        np.testing.assert_array_equal(strided.latest.photoreceptors, alone.photoreceptors)
        mine, expected = strided.latest.layers, alone.layers
        np.testing.assert_array_equal(mine.excitation, expected.excitation)
        np.testing.assert_array_equal(mine.inhibition, expected.inhibition)
        for phi in AXES:
            np.testing.assert_array_equal(mine.directional[phi], expected.directional[phi])
    assert ready == [t >= 3 * stride for t in range(len(frames))]


def test_reset_starts_over() -> None:
    frames = random_frames(9)
    strided = StridedDpc(SHAPE, DpcParams(), AXES, 2)
    first = [(strided.step(frame), strided.latest.layers.inhibition.copy()) for frame in frames]
    strided.reset()
    for frame, (ready, inhibition) in zip(frames, first, strict=True):
        assert strided.step(frame) == ready
        if ready:
            np.testing.assert_array_equal(strided.latest.layers.inhibition, inhibition)
    assert ready


def test_a_frame_that_is_refused_takes_no_turn() -> None:
    frames = random_frames(8)
    strided, other = (StridedDpc(SHAPE, DpcParams(), AXES, 2) for _ in range(2))
    for frame in frames:
        with pytest.raises(FrameError, match="float32 array of shape"):
            strided.step(frame[1:])
        assert strided.step(frame) == other.step(frame)
        np.testing.assert_array_equal(
            strided.latest.layers.inhibition, other.latest.layers.inhibition
        )


def test_a_model_answers_with_one_stride_until_the_next_is_valid() -> None:
    frames = random_frames(9, (60, 80))
    params = OpplodParams(receptive_field=40, cell=5)
    one, two = Opplod((60, 80), params), Opplod((60, 80), params.replaced(strides=2))
    pairs = [(one.step(frame), two.step(frame)) for frame in frames]
    assert pairs[:3] == [(None, None)] * 3
    for first, second in pairs[3:6]:
        assert first == second
    for first, second in pairs[6:]:
        assert first is not None
        assert second is not None
        assert second.opponency != first.opponency


def test_sharing_layers_with_dlgmd_changes_no_answer() -> None:
    frames = looming(120, 60, 60, 12)
    bank = ModelBank((120, 120), [ROBUST, DlgmdParams()])
    alone = Opplod((120, 120), ROBUST)
    found = [(bank.step(frame)["opplod"], alone.step(frame)) for frame in frames]
    assert all(together == single for together, single in found)
    assert max(answer.response for answer, _ in found if answer) > 0


def test_a_model_of_several_strides_can_be_used_again() -> None:
    frames = [
        each * np.float32(1 if t in {3, 7, 11, 15} else 0.02)
        for t, each in enumerate(random_frames(16, (60, 80)))
    ]
    params = OpplodParams(receptive_field=40, cell=5, strides=2)
    model = Opplod((60, 80), params.replaced(adaptation_guard_s=0, adaptation_level=1e-6))
    first = [model.step(frame) for frame in frames]
    assert first[3] is not None
    assert first[3].response > 0
    model.reset()
    assert [model.step(frame) for frame in frames] == first


@pytest.mark.parametrize(("strides", "memory"), [(1, 3), (2, 6), (5, 15)])
def test_a_bank_forgets_within_its_memory(strides: int, memory: int) -> None:
    params = OpplodParams(receptive_field=40, cell=5, strides=strides)
    # Where a frame of high contrast follows faint ones, not all is inhibited.
    frames = [
        each * np.float32(0.02 if t % memory else 1)
        for t, each in enumerate(random_frames(20, (60, 80)))
    ]
    bank = ModelBank((60, 80), [DlgmdParams(), params])
    assert bank.memory == memory
    fresh = ModelBank((60, 80), [DlgmdParams(), params])
    for frame in frames:
        bank.step(frame)
    for frame in frames[:memory]:
        bank.step(frame)
        fresh.step(frame)
    answer = fresh.step(frames[memory])
    assert bank.step(frames[memory]) == answer
    assert isinstance(answer["opplod"], OpplodResponse)
    assert answer["opplod"].response > 0


def test_the_memory_without_opplod_is_that_of_dlgmd() -> None:
    assert ModelBank((9, 9), [DlgmdParams()]).memory == 3
