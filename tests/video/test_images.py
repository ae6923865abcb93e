from __future__ import annotations

from fractions import Fraction
from typing import TYPE_CHECKING

import cv2
import numpy as np
import pytest

from oppload_cli.errors import SourceError
from oppload_cli.video.images import image_paths
from oppload_cli.video.source import open_video
from tests.media import grey_frames

if TYPE_CHECKING:
    from pathlib import Path


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """Twelve images whose names sort otherwise by letter."""
    for index, image in enumerate(grey_frames(12)):
        cv2.imwrite(str(tmp_path / f"frame_{index}.png"), image)
    (tmp_path / "notes.txt").write_text("not an image")
    return tmp_path


@pytest.mark.parametrize("name", ["", "frame_%d.png", "frame_%01d.png"])
def test_a_folder_or_pattern_is_read_in_the_order_of_its_numbers(folder: Path, name: str) -> None:
    with open_video(folder / name, height=None, image_rate=Fraction(10)) as video:
        frames = list(video)
        assert video.facts.kind == "images"
        assert video.facts.frames_declared == 12
        assert video.decode.complete
    for index, (frame, image) in enumerate(zip(frames, grey_frames(12), strict=True)):
        assert frame.index == index
        assert frame.time_s == pytest.approx(index / 10)
        np.testing.assert_array_equal(frame.luma, image.astype(np.float32) / np.float32(255))


def test_a_pattern_takes_only_its_own(folder: Path) -> None:
    (folder / "frame_7.png").rename(folder / "other_7.png")
    assert len(image_paths(str(folder / "frame_%d.png"))) == 11
    assert len(image_paths(str(folder / "frame_%02d.png"))) == 2


def test_colour_becomes_grey_by_rec_601(tmp_path: Path) -> None:
    for index in range(2):
        cv2.imwrite(str(tmp_path / f"{index}.png"), np.full((20, 20, 3), (50, 100, 200), np.uint8))
    with open_video(tmp_path, height=None) as video:
        luma = next(iter(video)).luma
    assert luma.max() == luma.min() == pytest.approx(124 / 255)


def test_a_damaged_image_is_counted_and_the_others_are_read(folder: Path) -> None:
    (folder / "frame_5.png").write_bytes(b"\x89PNG but no more")
    with open_video(folder, height=None) as video:
        assert [frame.index for frame in video] == [0, 1, 2, 3, 4, 6, 7, 8, 9, 10, 11]
        assert video.decode.failures == 1
        assert not video.decode.complete
        assert "frame_5.png" in video.decode.messages[0]


@pytest.mark.parametrize(
    ("name", "message"),
    [("missing_%d.png", "no image there"), ("nowhere/f_%d.png", "no such folder")],
)
def test_a_pattern_without_images(folder: Path, name: str, message: str) -> None:
    with pytest.raises(SourceError, match=message):
        open_video(folder / name)


def test_a_single_image_shows_no_motion(folder: Path) -> None:
    with pytest.raises(SourceError, match="a single image shows no motion"):
        open_video(folder / "frame_1.png")


def test_images_that_cannot_be_read(tmp_path: Path) -> None:
    (tmp_path / "a.png").write_bytes(b"nothing")
    with pytest.raises(SourceError, match="none of these images"):
        open_video(tmp_path)
