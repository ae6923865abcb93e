"""What the detectors see of a file is what was rendered, to the last bit."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import pytest

from oppload_cli import Dlgmd, open_video, stimulus

if TYPE_CHECKING:
    from pathlib import Path

SHORT = {"timing.motion_s": 0.4}
NAMES = (
    "klapoetke2017/bar-expand-10/axis-75",
    "controls/looming-on-moving-texture/direction-90",
    "controls/looming-noise/noise-0.1",
)


@pytest.mark.parametrize("form", ["ffv1", "mkv", "png", "gif"])
@pytest.mark.parametrize("name", NAMES)
def test_lossless_formats_give_the_rendered_luminance(name: str, form: str, tmp_path: Path) -> None:
    protocol = stimulus.load(name, SHORT)
    written = stimulus.write(protocol, tmp_path, form=form)
    with open_video(written.video, height=None) as video:
        for rendered, read in zip(stimulus.frames(protocol), video, strict=True):
            assert read.index == rendered.index
            assert read.luma.dtype == rendered.luma.dtype == np.float32
            np.testing.assert_array_equal(read.luma, rendered.luma)


def test_mp4_is_within_eight_grey_levels(tmp_path: Path) -> None:
    for name in NAMES[:2]:
        protocol = stimulus.load(name, SHORT)
        written = stimulus.write(protocol, tmp_path, form="mp4")
        with open_video(written.video, height=None) as video:
            for rendered, read in zip(stimulus.frames(protocol), video, strict=True):
                assert np.abs(read.luma - rendered.luma).max() < 8 / 255


def test_models_respond_the_same_with_and_without_a_file(tmp_path: Path) -> None:
    protocol = stimulus.load("opplod2023/looming-disk-centre", {"timing.motion_s": 0.5})
    written = stimulus.write(protocol, tmp_path)
    model = Dlgmd((600, 600))
    with open_video(written.video, height=None) as video:
        from_file = [model.step(frame.luma) for frame in video]
    model.reset()
    assert [model.step(frame.luma) for frame in stimulus.frames(protocol)] == from_file
    assert from_file[2] is None
    assert from_file[-1] is not None
    assert from_file[-1].s > 0
