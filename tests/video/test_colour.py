from __future__ import annotations

from fractions import Fraction
from typing import TYPE_CHECKING, Any

import av
import cv2
import numpy as np
import pytest

from oppload_cli.video.frames import InputFacts, Picture
from oppload_cli.video.source import open_video
from oppload_cli.video.writers import Colour, colour_size
from tests.media import grey_frames, write_video

if TYPE_CHECKING:
    from pathlib import Path

    from numpy.typing import NDArray

VERMILLION = (0, 94, 213)  # blue, green, red


@pytest.mark.parametrize(
    ("width", "height", "weight"), [(480, 720, 1.402), (1024, 576, 1.402), (1024, 580, 1.5748)]
)
def test_large_pictures_that_state_no_colour_space_have_that_of_hd(
    width: int, height: int, weight: float
) -> None:
    """Red is Y + 1.402 Cr by BT.601, and Y + 1.5748 Cr by BT.709; the shorter side decides."""
    codes = np.full((height * 3 // 2, width), 100, np.uint8)
    codes[height : height * 5 // 4], codes[height * 5 // 4 :] = 128, 200
    frame = av.VideoFrame.from_ndarray(codes, "yuv420p")
    colour = Colour(InputFacts("a", "container", width, height, Fraction(30), None), (64, 48))
    shown = colour(Picture(0, 0, codes, full_range=False, original=frame))
    red = 255 * ((100 - 16) / 219 + weight * (200 - 128) / 224)
    assert shown[..., 2].mean() == pytest.approx(red, abs=4)  # 14 apart


def flat(width: int = 64, height: int = 48) -> NDArray[np.uint8]:
    return np.full((height, width, 3), VERMILLION, np.uint8)


def colours(path: Path, height: int | None = 24) -> list[NDArray[np.uint8]]:
    with open_video(path, height=height, colour=True) as video:
        pictures = [frame.colour for frame in video]
    assert all(picture is not None for picture in pictures)
    return [picture for picture in pictures if picture is not None]


def write_colour(path: Path, picture: NDArray[np.uint8], space: int, **more: Any) -> Path:
    """Encode a picture twice in a stated colour space; 2 is "unspecified"."""
    with av.open(str(path), "w") as container:
        stream: Any = container.add_stream("libx264", rate=30, options={"crf": "1"})
        stream.height, stream.width = picture.shape[:2]
        stream.pix_fmt = more.get("pixels", "yuv420p")
        stream.codec_context.colorspace = space
        for index in range(2):
            frame = av.VideoFrame.from_ndarray(picture, "bgr24").reformat(
                format=stream.pix_fmt, dst_colorspace=more["coded"], dst_color_range=1
            )
            frame.colorspace = space
            frame.pts = index
            container.mux(stream.encode(frame))
        container.mux(stream.encode())
    return path


@pytest.mark.parametrize(
    ("space", "coded", "size"),
    [(1, 1, (64, 48)), (6, 5, (64, 48)), (2, 5, (64, 48)), (2, 1, (1280, 720))],
)
def test_colours_are_those_that_were_coded(
    tmp_path: Path, space: int, coded: int, size: tuple[int, int]
) -> None:
    path = write_colour(tmp_path / "a.mp4", flat(*size), space, coded=coded)
    for picture in colours(path):
        assert picture.shape == (size[1], size[0], 3)
        assert np.abs(picture.astype(int) - VERMILLION).max() <= 5


def test_ten_bits_too(tmp_path: Path) -> None:
    path = write_colour(tmp_path / "a.mp4", flat(), 1, coded=1, pixels="yuv420p10le")
    assert np.abs(colours(path)[1].astype(int) - VERMILLION).max() <= 5


@pytest.mark.parametrize("name", ["rgb555", "rgb565"])
def test_two_bytes_per_pixel_in_the_order_of_quicktime(tmp_path: Path, name: str) -> None:
    """FFmpeg confuses the bytes of these formats when it converts them to 24 bits per pixel."""
    frame = av.VideoFrame.from_ndarray(flat(), "bgr24").reformat(format=f"{name}le")
    swapped, path = frame.reformat(format=f"{name}be"), tmp_path / "a.mov"
    with av.open(str(path), "w") as container:
        stream: Any = container.add_stream("rawvideo", rate=10)
        stream.width, stream.height, stream.pix_fmt = swapped.width, swapped.height, f"{name}be"
        container.mux(stream.encode(swapped))
        container.mux(stream.encode())
    assert np.abs(colours(path)[0].astype(int) - VERMILLION).max() <= 10  # it is dithered
    with open_video(path, height=None) as video:
        grey = cv2.cvtColor(flat(), cv2.COLOR_BGR2GRAY) / 255
        np.testing.assert_allclose(next(iter(video)).luma, grey, atol=0.03)


def test_images_and_gifs(tmp_path: Path) -> None:
    folder = tmp_path / "images"
    folder.mkdir()
    for index in range(2):
        cv2.imwrite(str(folder / f"{index}.png"), flat())
    assert all((picture == VERMILLION).all() for picture in colours(folder))
    path = tmp_path / "a.gif"
    rgb = np.ascontiguousarray(flat()[:, :, ::-1])
    write_video(path, [rgb] * 2, codec="gif", pixel_format="rgb8", source_format="rgb24", rate=10)
    # GIF's palette of 256 has steps of 36 and 85.
    assert np.abs(colours(path)[1].astype(int) - VERMILLION).max() <= 43


def test_grey_is_grey(tmp_path: Path) -> None:
    images = grey_frames(3)
    path = write_video(tmp_path / "a.avi", images)
    for picture, image in zip(colours(path), images, strict=True):
        np.testing.assert_array_equal(picture, np.repeat(image[:, :, None], 3, axis=2))


def test_no_side_is_longer_than_1920() -> None:
    sizes = {(3840, 2160): (1920, 1080), (1000, 4000): (480, 1920), (9000, 2): (1920, 1)}
    for (width, height), expected in sizes.items():
        facts = InputFacts("a", "images", width, height, Fraction(30), 1)
        assert colour_size(facts) == expected
        original = flat(width, height)
        picture = Colour(facts)(Picture(0, 0, original[:, :, 0], original=original))
        assert picture.shape == (expected[1], expected[0], 3)
        assert (picture == VERMILLION).all()


def test_every_picture_has_the_size_of_the_first(tmp_path: Path) -> None:
    for index, size in enumerate([(64, 48), (32, 24), (128, 96)]):
        cv2.imwrite(str(tmp_path / f"{index}.png"), flat(*size))
    pictures = colours(tmp_path)
    assert [picture.shape for picture in pictures] == [(48, 64, 3)] * 3
    assert all((picture == VERMILLION).all() for picture in pictures)


def test_a_picture_that_cannot_be_converted_is_grey() -> None:
    facts = InputFacts("a", "container", 8, 6, None, None)
    plane = np.full((6, 8), 16 + 219 // 2, np.uint8)
    grey = Colour(facts)(Picture(0, 0, plane, 8, False))
    assert (grey == round(109 / 219 * 255)).all()


def test_nothing_is_in_colour_unless_it_was_asked_for(tmp_path: Path) -> None:
    path = write_video(tmp_path / "a.avi", grey_frames(3))
    with open_video(path) as video:
        assert [frame.colour for frame in video] == [None] * 3
