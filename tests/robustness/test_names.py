"""Names of results are plain names of files, whatever the names of the inputs."""

from __future__ import annotations

import json
import sys
from typing import TYPE_CHECKING

import pytest

from oppload_cli.errors import printable
from oppload_cli.files.reading import fault_of_stem
from oppload_cli.video.inputs import result_stem
from tests.cli.inside import oppload
from tests.media import grey_frames, write_video

if TYPE_CHECKING:
    from pathlib import Path

QUICK = ("--height", "24", "--no-rmo", "-q")
BAD = {
    "../escaped": "names no file",
    "/escaped": "names no file",
    "a//b": "names no file",
    "b/C:x": "begins with a drive",
    "a\\b": r"holds '\'",
    "..": "names no file",
    " ": "names no file",
    "C:x": "begins with a drive",
    "a\nb": "holds a control character",
    "a\x85b": "holds a control character",
    "NUL": "is a device on Windows",
    "con.x": "is a device on Windows",
    "LPT¹": "is a device on Windows",
    "aux .y": "is a device on Windows",
}
GOOD = ["a", "a.b/c", "..a", "ünï", "console", "com", "\udcff", "~", "-o"]
if sys.platform != "win32":
    GOOD += [":b.c", "10:20:30"]


@pytest.fixture
def clip(tmp_path: Path) -> Path:
    return write_video(tmp_path / "base.avi", grey_frames(8), codec="ffv1")


def test_plain_names() -> None:
    assert {name: fault_of_stem(name) for name in BAD} == BAD
    assert [fault_of_stem(name) for name in GOOD] == [""] * len(GOOD)


def test_names_are_shown_as_they_are_unless_they_would_act_on_a_terminal() -> None:
    plain = "at 10.00\u202fPM, \u3000, \u0645\u06cc\u200c\u062e, \U0001f468\u200d\U0001f469.mov"
    assert printable(plain) == plain
    acting = "\n\x1b\u2028\u202e\udcff"  # also ends of lines, and text from right to left
    assert printable(acting) == r"\n\x1b\u2028\u202e\udcff"


def test_the_stem_of_any_input_is_a_plain_name() -> None:
    inputs = ["new\nline.avi", "C:x.avi", "con.avi", "nul.a.avi", "...avi", "http://?", "a\\b.avi"]
    stems = [result_stem(name) for name in inputs]
    assert [fault_of_stem(stem) for stem in stems] == [""] * len(inputs)
    assert len({stem.casefold() for stem in stems}) == len(inputs)
    if sys.platform != "win32":
        assert result_stem("2026-01-01T10:20:30.mp4") == "2026-01-01T10:20:30"
    assert result_stem("a.avi", "b/c") == "b/c/a"
    assert result_stem("a.avi", "con").startswith("a-")


@pytest.mark.long
@pytest.mark.skipif(
    sys.platform == "win32", reason="Windows says otherwise that a name is too long"
)
@pytest.mark.usefixtures("undrawn")
def test_a_name_that_is_too_long(clip: Path, tmp_path: Path) -> None:
    """The name comes from the command line, a list or a sidecar."""
    long = "n" * 300
    path = tmp_path / "list"
    path.write_text(f"{long}\n{clip}\n")
    done = oppload("run", "--files-from", path, "-o", tmp_path / "out", *QUICK, "-j", "1")
    assert (done.returncode, "bug" in done.stderr) == (4, False), done.stderr
    assert f"{long}: cannot be read (file name too long)" in done.stderr
    sidecar, table = (tmp_path / "out" / f"base.{each}" for each in ("oppload.json", "frames.csv"))
    facts = json.loads(sidecar.read_text())
    facts["input"]["name"] = f"{long}.avi"
    facts["stimulus"] = {"path": long}
    sidecar.write_text(json.dumps(facts))
    for command in (
        ("plot", table, "-o", tmp_path / "a.png"),
        ("plot", table, "--kind", "map", "-o", tmp_path / "b.png"),
        ("report", table, "-o", tmp_path / "pages"),
        ("collect", long, "-o", tmp_path / "all.csv"),
        ("run", clip, "-o", tmp_path / "out", "--scheduler", long),
        ("evaluate", long, "-o", tmp_path / "out"),
    ):
        done = oppload(*command)
        assert "bug" not in done.stderr, done.stderr
        assert done.returncode in {0, 2, 4}


def test_an_empty_name_is_no_input(
    clip: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    done = oppload("run", "", "-o", tmp_path / "out")
    assert (done.returncode, done.stderr.count("\n")) == (3, 1)
    assert "an empty name is no input" in done.stderr
    assert not (tmp_path / "out").exists()
