"""Stacks of arrays and images, and the videos of laboratories."""

from __future__ import annotations

import struct
from fractions import Fraction
from typing import TYPE_CHECKING, Any

import h5py
import numpy as np
import pytest
from PIL import Image

from oppload_cli.errors import SourceError
from oppload_cli.video.inputs import result_stem
from oppload_cli.video.source import open_video
from tests.cli.inside import oppload
from tests.media import grey_frames

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    from numpy.typing import NDArray

    from oppload_cli.video.frames import Frame

COUNT, ROWS, COLUMNS = 6, 40, 56
TIMES_S = [0.0, 0.01, 0.02, 0.035, 0.05, 0.06]  # one late picture
START_S = 1_600_000_000.25  # laboratories write the time of day


def stack() -> NDArray[np.uint8]:
    return np.array(grey_frames(COUNT, COLUMNS, ROWS))


def write_fmf(path: Path, version: int = 3, coding: bytes = b"MONO8") -> None:
    head = struct.pack("<I", version)
    if version == 3:
        head += struct.pack("<I", len(coding)) + coding + struct.pack("<I", 8)
    head += struct.pack("<IIQQ", ROWS, COLUMNS, ROWS * COLUMNS + 8, COUNT)
    chunks = [
        struct.pack("<d", START_S + time_s) + picture.tobytes()
        for time_s, picture in zip(TIMES_S, stack(), strict=True)
    ]
    path.write_bytes(head + b"".join(chunks))


def write_ufmf(path: Path, version: int = 3) -> None:
    """Write a background of zeros, and each picture as two boxes that cover it."""
    place = "<IHH" if version == 2 else "<QHH"
    content = struct.pack("<4sI", b"ufmf", version) + struct.pack(place, 0, COLUMNS, ROWS)
    content += b"\0" * (version == 4) + struct.pack("<B", 5) + b"MONO8"
    content += b"\0\4mean" + struct.pack("<cHHd", b"B", COLUMNS, ROWS, 0.0)
    content += bytes(ROWS * COLUMNS)
    for time_s, picture in zip(TIMES_S, stack(), strict=True):
        points = "<dI" if version == 4 else "<dH"
        content += b"\1" + struct.pack(points, START_S + time_s, 2)
        for x, width in ((0, 20), (20, COLUMNS - 20)):
            box = picture[:, x : x + width]
            content += struct.pack("<HHHH", x, 0, width, ROWS) + box.tobytes()
    path.write_bytes(content + b"\2d\0")


def write_norpix(path: Path, version: int = 5, bits: int = 8) -> None:
    first = 8192 if version >= 5 else 1024
    size = ROWS * COLUMNS * (1 if bits == 8 else 2)
    step = size + 8 + 24  # pictures begin at steps with a rest
    head = struct.pack("<I24sii512s", 0xFEED, "Norpix seq".encode("utf-16-le"), version, 1024, b"")
    stored = 8 if bits == 8 else 16
    head += struct.pack("<9I", COLUMNS, ROWS, stored, bits, size, 100, COUNT, 0, step)
    content = bytearray(head + struct.pack("<d", 100.0)).ljust(first, b"\0")
    for time_s, picture in zip(TIMES_S, stack(), strict=True):
        values: Any = picture
        if bits > 8:
            values = (picture / 255 * (2**bits - 1)).round().astype("<u2")
        millis = round(1000 * (0.25 + time_s))
        stamp = struct.pack("<IHH", 1_600_000_000, millis, 0)
        content += (values.tobytes() + stamp[: 8 if version >= 5 else 6]).ljust(step, b"\0")
    path.write_bytes(content)


def write_hdf5(path: Path, **arrays: NDArray[Any]) -> None:
    with h5py.File(path, "w") as file:
        for name, values in arrays.items():
            file[f"camera/{name}"] = values


def write_images(path: Path, pictures: NDArray[Any], **options: Any) -> None:
    first, *rest = [Image.fromarray(picture) for picture in pictures]
    first.save(path, save_all=True, append_images=rest, **options)


def read(name: Path | str, **options: Any) -> list[Frame]:
    with open_video(name, height=None, **options) as video:
        frames = list(video)
        assert video.decode.complete, video.decode.messages
    return frames


LABORATORY: dict[str, tuple[str, Callable[[Path], None]]] = {
    "fmf 1": ("a.fmf", lambda path: write_fmf(path, 1)),
    "fmf 3": ("a.fmf", write_fmf),
    **{f"ufmf {v}": ("a.ufmf", lambda path, v=v: write_ufmf(path, v)) for v in (2, 3, 4)},  # type: ignore[misc]
    "norpix 3": ("a.seq", lambda path: write_norpix(path, 3)),
    "norpix 5": ("a.seq", write_norpix),
    "norpix of 12 bits": ("a.seq", lambda path: write_norpix(path, bits=12)),
}


@pytest.mark.parametrize("kind", LABORATORY)
def test_videos_of_laboratories_have_their_pictures_and_their_times(
    kind: str, tmp_path: Path
) -> None:
    name, write = LABORATORY[kind]
    write(tmp_path / name)
    frames = read(tmp_path / name)
    assert [frame.time_s for frame in frames] == pytest.approx(TIMES_S, abs=1e-6)
    for frame, picture in zip(frames, stack(), strict=True):
        assert np.abs(frame.luma - picture / 255).max() < (3e-4 if "12" in kind else 1e-6)


@pytest.mark.parametrize("kind", LABORATORY)
@pytest.mark.parametrize("left", [0.6, 0.75, 0.999])
def test_a_cut_video_of_a_laboratory_is_incomplete(kind: str, left: float, tmp_path: Path) -> None:
    name, write = LABORATORY[kind]
    path = tmp_path / name
    write(path)
    content = path.read_bytes()
    path.write_bytes(content[: int(left * len(content)) - 30])
    with open_video(path, height=None) as video:
        frames = list(video)
    assert 0 < len(frames) < COUNT
    assert not video.decode.complete
    for frame, picture in zip(frames, stack(), strict=False):
        assert np.abs(frame.luma - picture / 255).max() < 3e-4


@pytest.mark.parametrize("kind", ["uint8", "uint16", "big-endian", "float32", "rgb", "f-order"])
@pytest.mark.parametrize("suffix", [".npy", ".npz", ".h5"])
def test_arrays_have_the_luminance_of_their_values(kind: str, suffix: str, tmp_path: Path) -> None:
    grey = stack()
    kinds: dict[str, NDArray[Any]] = {
        "uint8": grey,
        "uint16": grey.astype(np.uint16) * 257,
        "big-endian": (grey.astype(np.uint16) * 257).astype(">u2"),
        "float32": (grey / 255).astype(np.float32),
        "rgb": np.repeat(grey[..., None], 3, axis=3),
        "f-order": np.asfortranarray(grey),
    }
    values = kinds[kind]
    path = tmp_path / f"a{suffix}"
    if suffix == ".npy":
        np.save(path, values)
    elif suffix == ".npz":
        np.savez(path, values)
    else:
        write_hdf5(path, left=values)
    frames = read(path, image_rate=Fraction(200))
    assert [frame.time_s for frame in frames] == [index / 200 for index in range(COUNT)]
    for frame, picture in zip(frames, grey, strict=True):
        assert np.abs(frame.luma - picture / 255).max() < 1e-5


@pytest.mark.parametrize("bits", [8, 16])
def test_a_tiff_of_several_pictures_is_a_stack(bits: int, tmp_path: Path) -> None:
    grey = stack()
    write_images(tmp_path / "a.tif", grey if bits == 8 else grey.astype(np.uint16) * 257)
    with open_video(tmp_path / "a.tif", height=None) as video:
        assert video.facts.frame_rate == 30
        assert video.facts.rate_assumed
    frames = read(tmp_path / "a.tif", image_rate=10)
    assert [frame.time_s for frame in frames] == [index / 10 for index in range(COUNT)]
    for frame, picture in zip(frames, grey, strict=True):
        assert np.abs(frame.luma - picture / 255).max() < 1e-6


@pytest.mark.parametrize("name", ["a.webp", "a.png"])
def test_animations_have_the_times_of_their_pictures(name: str, tmp_path: Path) -> None:
    durations = [10, 10, 15, 15, 10, 10]  # ms
    write_images(tmp_path / name, stack(), duration=durations, lossless=True)
    frames = read(tmp_path / name)
    assert [frame.time_s for frame in frames] == pytest.approx(TIMES_S, abs=1e-9)
    for frame, picture in zip(frames, stack(), strict=True):
        assert np.abs(frame.luma - picture / 255).max() < 0.01


def test_the_array_of_a_file_is_named_after_a_colon(tmp_path: Path) -> None:
    path = tmp_path / "flies.h5"
    write_hdf5(path, left=stack(), right=stack()[::-1])
    name = f"{path}:/camera/right"
    first = read(name)[0]
    assert np.abs(first.luma - stack()[-1] / 255).max() < 1e-6
    assert result_stem(name) == "flies-camera-right"
    done = oppload("run", name, "--image-rate", "30", "-o", tmp_path, "--height", "native")
    assert done.returncode == 0
    assert (tmp_path / "flies-camera-right.frames.csv").read_text().count("\n") == COUNT + 1


WRONG: dict[str, tuple[Callable[[Path], object], str]] = {
    "a.npy": (lambda path: np.save(path, stack()[0]), r"its shape is \(40, 56\); a stack has"),
    "b.npy": (lambda path: np.save(path, stack().astype(int)), "values of the type int64"),
    "c.npy": (lambda path: np.save(path, stack() * 1.0), "values that are not from 0 to 1"),
    "d.npy": (lambda path: np.save(path, stack()[:0]), "holds no picture"),
    "e.npy": (lambda path: path.write_bytes(b"\x93NUMPY\1\0"), "its pictures cannot be read"),
    "f.npy": (lambda path: np.save(path, np.array([{}]), allow_pickle=True), "cannot be read"),
    "a.npz": (lambda path: path.write_bytes(b"PK\3\4"), "its pictures cannot be read"),
    "a.h5": (
        lambda path: write_hdf5(path, left=stack(), right=stack()),
        "holds 2 arrays; give one of a.h5:/camera/left, a.h5:/camera/right",
    ),
    "b.h5": (lambda path: write_hdf5(path, speed=np.arange(5)), "holds no array of pictures"),
    "c.h5": (lambda path: path.write_bytes(b"no file of HDF5"), "c.h5: "),
    "a.fmf": (lambda path: write_fmf(path, 2), "no FlyMovieFormat of version 1 or 3"),
    "b.fmf": (lambda path: write_fmf(path, coding=b"YUV422"), "of the kind YUV422"),
    "d.fmf": (
        lambda path: path.write_bytes(struct.pack("<IIIQQ", 1, 0, 9, 8, 1) + bytes(8)),
        r"its pictures cannot be read \(its size is 0\)",
    ),
    "g.npy": (lambda path: path.write_bytes(b""), "its pictures cannot be read"),
    "c.fmf": (lambda path: path.write_bytes(b"\1\0\0\0abc"), "ends within its head"),
    "a.ufmf": (lambda path: write_ufmf(path, 5), "no micro FlyMovieFormat of version 2 to 4"),
    "a.seq": (lambda path: path.write_bytes(bytes(600)), "no sequence of Norpix"),
    "a.tif": (lambda path: write_images(path, stack()[:1]), "a single image shows no motion"),
    "b.tif": (lambda path: path.write_bytes(b"II*\0"), "b.tif: not a PNG, JPEG, BMP"),
}


@pytest.mark.parametrize("name", WRONG)
def test_a_wrong_stack_is_refused_in_a_sentence(name: str, tmp_path: Path) -> None:
    write, sentence = WRONG[name]
    write(tmp_path / name)
    with pytest.raises(SourceError, match=sentence):
        list(open_video(tmp_path / name, image_rate=30))


WRONG_WITHIN: dict[str, tuple[str, int, bytes, str]] = {
    "no number": ("a.fmf", 2, struct.pack("<d", float("nan")), "its time is nan s"),
    "far too late": ("a.fmf", 2, struct.pack("<d", 1e300), "its time is 1e+300 s"),
    "far outside": ("a.ufmf", 0, struct.pack("<H", COLUMNS - 1), "a box reaches beyond the pic"),
}


@pytest.mark.parametrize("kind", WRONG_WITHIN)
def test_a_damaged_picture_ends_a_video_in_a_sentence(kind: str, tmp_path: Path) -> None:
    name, whole, wrong, sentence = WRONG_WITHIN[kind]
    path = tmp_path / name
    LABORATORY["fmf 3" if whole else "ufmf 3"][1](path)
    content = bytearray(path.read_bytes())
    chunk = ROWS * COLUMNS
    # The third picture of FlyMovieFormat begins with its time. In micro FlyMovieFormat a picture
    # has two boxes, each with four numbers before its values.
    at = len(content) - 4 * (chunk + 8) if whole else len(content) - 3 - 4 * (chunk + 27) + 11
    content[at : at + len(wrong)] = wrong
    path.write_bytes(content)
    with open_video(path, height=None) as video:
        assert len(list(video)) == 2
        assert f"frame 2 cannot be read ({sentence}" in video.decode.messages[0]
        assert not video.decode.complete


def test_a_stack_that_uses_few_of_its_bits_gets_a_remark(tmp_path: Path) -> None:
    np.save(tmp_path / "a.npy", stack().astype(np.uint16) * 16)  # 12 bits
    with open_video(tmp_path / "a.npy", image_rate=30) as video:
        assert len(list(video)) == COUNT
        (remark,) = video.decode.messages
    assert "if the pictures have 12 bits, scale them to 16 first" in remark


def test_a_stack_with_times_takes_no_other_rate(tmp_path: Path) -> None:
    write_fmf(tmp_path / "a.fmf")
    with pytest.raises(SourceError, match="it has the times of its camera"):
        open_video(tmp_path / "a.fmf", true_rate=100)
