"""Names on the command line, and the stems of results."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest

from oppload_cli.video.inputs import found_inputs, is_camera, left_out, result_stem


def test_a_folder_of_videos_is_each_of_them(tmp_path: Path) -> None:
    for name in ("b.mp4", "a.avi", "cover.png"):
        (tmp_path / name).touch()
    names = [found.name for found in found_inputs(str(tmp_path))]
    assert names == [str(tmp_path / "a.avi"), str(tmp_path / "b.mp4")]


def test_an_empty_folder(tmp_path: Path) -> None:
    (found,) = found_inputs(str(tmp_path))
    assert "no video and no image in this folder" in str(found.error)


@pytest.mark.parametrize(
    ("names", "held"),
    [
        (["a.exr", "b.exr", "notes.txt"], "2 files .exr; convert pictures to PNG or TIFF"),
        (["README"], "1 file without a suffix; convert"),
        (["a.npy", "b.npy"], "2 files .npy; give these by name"),
    ],
)
def test_a_folder_of_other_files_is_named_by_them(
    names: list[str], held: str, tmp_path: Path
) -> None:
    for name in names:
        (tmp_path / name).touch()
    (found,) = found_inputs(str(tmp_path))
    assert held in str(found.error)


def test_a_file_may_have_a_name_like_that_of_a_camera(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    names = ("camera:0", "camera:0.avi", "camera:x", "./camera:0.avi")
    assert [is_camera(name) for name in names] == [True, True, True, False]
    if sys.platform != "win32":  # where no name has a colon
        for name in names[:2]:
            Path(name).touch()
        assert [is_camera(name) for name in names] == [True, False, True, False]


def test_inputs_beside_the_videos_of_a_folder_give_a_note(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    names = ("a.avi", "a.frames.png", "still.jpg", "anim.webp", "results/a.frames.csv")
    for name in (*names, "seq/1.png", "seq/2.png", "plots/x.png", ".trash/b.mp4", "cam/b.mp4"):
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).touch()
    folders, images = left_out(str(tmp_path))
    assert folders.endswith("2 folders (cam, seq) are left out; --recursive runs the inputs there")
    assert ": 2 images (anim.webp, still.jpg) are left out beside videos; give a folder" in images
    assert not list(left_out(str(tmp_path), recursive=True))
    for name in ("a.1.png", "a.2.png", "cam/f1.png", "cam/f2.png"):  # the first two are figures
        (tmp_path / name).touch()
    (mixed,) = left_out(str(tmp_path), recursive=True)
    assert ": 1 folder (cam) is read without the numbered images that lie beside videos;" in mixed
    for name in ("cam/f1.png", "cam/f2.png"):
        (tmp_path / name).unlink()
    for name in ("seq", "cam", "plots", "a.avi", "none"):
        assert not list(left_out(str(tmp_path / name)))
    monkeypatch.chdir(tmp_path)
    assert not list(left_out(""))  # an empty name is no folder


def test_a_stem_depends_on_nothing_but_its_input() -> None:
    names = ["x/a.mp4", "y/a.mp4", "b_%04d.png", "camera:0", "rtsp://host/cam?key=1"]
    stems = [result_stem(name) for name in names]
    assert stems == ["a", "a", "b", "camera-0", "rtsp-host-cam"]
    assert result_stem("x/a.mp4", "x") == "x/a"
    long = result_stem("n" * 230 + ".mp4")
    assert len(long) == 200 + len("-") + 8


@pytest.mark.parametrize(
    ("pattern", "recursive", "folders"),
    [
        ("videos", True, ["cam1", "cam2/deep"]),
        ("videos/*/*.mp4", False, ["cam1"]),
        ("videos/**/*.mp4", False, ["cam1", "cam2/deep"]),
        ("videos/cam1/*.mp4", False, [""]),
        ("*/cam2/../cam1/a.mp4", False, [""]),
    ],
)
def test_results_mirror_the_folders_of_the_inputs(
    pattern: str,
    recursive: bool,
    folders: list[str],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.chdir(tmp_path)
    for name in ("videos/cam1/a.mp4", "videos/cam2/deep/a.mp4"):
        Path(name).parent.mkdir(parents=True)
        Path(name).touch()
    found = list(found_inputs(pattern, recursive=recursive))
    assert [Path(each.folder) for each in found] == [Path(each) for each in folders]
