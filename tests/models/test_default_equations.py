"""Preset `default` agrees with its equations (``docs/default-equations.md``)."""

from __future__ import annotations

from functools import cache
from itertools import pairwise
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

from oppload_cli.models.opplod import Opplod
from tests.detection.scenes import looming_over, shaken
from tests.media import texture
from tests.models import default_reference
from tests.presets import DEFAULT

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from tests.media import Luma


@cache
def shaking() -> list[Luma]:
    """A disk that approaches before a texture; the camera shakes."""
    ground = shaken(0.2 + 0.6 * texture(240, 240, 1), 16, 3, seed=2)
    return looming_over([np.asarray(each, np.float32) for each in ground])


@cache
def noisy() -> list[Luma]:
    """A disk that approaches before a texture, seen by a camera with noise."""
    ground = (0.2 + 0.6 * texture(240, 240, 1)).astype(np.float32)
    random = np.random.default_rng(3)
    return [
        each + random.normal(0, 0.03, each.shape).astype(np.float32)
        for each in looming_over([ground] * 14)
    ]


@cache
def flickering() -> list[Luma]:
    """A disk that approaches after a rest, under a lamp that flickers, at times by rows.

    At the end everything stands still but for a few pixels.
    """
    ground = (0.2 + 0.6 * texture(240, 240, 1)).astype(np.float32)
    film = looming_over([ground] * 20)[4:]
    rows = np.arange(240)[:, None] / 240
    for t in range(3, 12):
        film[t] *= np.float32(1 + 0.1 * np.sin(2 * np.pi * (rows * (t % 2) + t / 3)))
    still = [film[-1].copy() for _ in range(3)]
    for t, each in enumerate(still):
        each[t, :50] += np.float32(0.02)
    return [*([film[0]] * 4), *film, *still]


@cache
def passed() -> list[Luma]:
    """A box passes at 20 px per frame, while a disk approaches before a texture.

    A strip below the receptive field of the box flickers, so that a larger field would matter.
    """
    ground = (0.2 + 0.6 * texture(240, 240, 1)).astype(np.float32)
    film = looming_over([ground] * 20)
    random = np.random.default_rng(6)
    for t, each in enumerate(film[4:18]):
        each[30:110, 20 * t : 20 * t + 60] = 0.9
        each[220:] = random.uniform(0.25, 0.75)
    return film


SCENES = {"shaking": shaking, "noisy": noisy, "flickering": flickering, "passed": passed}


def of_the_package(scene: str, **changes: Any) -> NDArray[np.float64]:
    """R of each frame."""
    model = Opplod((240, 240), DEFAULT.replaced(**changes))
    answers = [model.step(frame) for frame in SCENES[scene]()]
    return np.array([answer.opponency if answer else 0.0 for answer in answers])


@cache
def of_the_equations(scene: str) -> NDArray[np.float64]:
    """R of each frame."""
    return np.array(default_reference.responses(SCENES[scene]()))


@pytest.mark.long
@pytest.mark.parametrize("scene", SCENES)
def test_responses_agree_with_the_equations(scene: str) -> None:
    expected = of_the_equations(scene)
    np.testing.assert_allclose(of_the_package(scene), expected, atol=1e-4 * expected.max())


@pytest.mark.once
@pytest.mark.parametrize(
    ("scene", "without"),
    [
        ("shaking", {"steady_view": False}),
        ("shaking", {"entering": 0}),
        ("shaking", {"adaptation_level": 0}),
        ("noisy", {"residual_noise": 0}),
        ("passed", {"passing": 0}),
        ("flickering", {"light_s": 0}),
        ("flickering", {"history": 0}),
        ("flickering", {"adaptation_level": 0}),
        ("flickering", {"border": 0, "entering": 0}),
    ],
)
def test_the_scenes_show_what_each_part_does(scene: str, without: dict[str, Any]) -> None:
    usual = of_the_package(scene)
    assert np.abs(of_the_package(scene, **without) - usual).max() > 5e-3 * usual.max()


@pytest.mark.long
def test_a_scene_that_comes_to_rest_does_not_raise_the_response() -> None:
    peak, *after = of_the_package("flickering")[14:]
    assert all(earlier >= later for earlier, later in pairwise([peak, *after]))
