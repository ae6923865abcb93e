"""Decoding in a process of its own: the same pictures, and what becomes of a crash."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from fractions import Fraction
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pytest

from oppload_cli import open_video
from oppload_cli.errors import SourceError
from oppload_cli.video import opening
from oppload_cli.video.apart import DecodingProcess
from oppload_cli.video.span import Position, Span
from tests.cli.process import ENTRY
from tests.media import grey_frames, write_video
from tests.robustness.inputs import KINDS, make
from tests.video.test_container import MATRICES, turned

if TYPE_CHECKING:
    from collections.abc import Callable

    from oppload_cli.video.source import Video

pytestmark = [
    pytest.mark.skipif(sys.platform != "linux", reason="copies are made on Linux only"),
    pytest.mark.filterwarnings("ignore:.*multi-threaded:DeprecationWarning"),
]


def apart(path: Path, height: int | None = 240, span: Span | None = None) -> Video:
    """A video that another process decodes."""
    return opening.begin_opening(
        str(path),
        height=height,
        span=span or Span(),
        image_rate=Fraction(30),
        threads=0,
        colour=False,
        apart=DecodingProcess(),
    ).result()


def many(path: Path) -> Path:
    """More frames than there are places in the shared memory."""
    return write_video(path, grey_frames(60), codec="libx264", pixel_format="yuv420p")


MAKE: dict[str, Callable[[Path], Path]] = {
    "many.mp4": many,
    "turned.mp4": lambda path: turned(many(path), MATRICES[90]),
    "deep.mkv": lambda path: make(path, KINDS["h264-ten-bits"]),
    "colour.gif": lambda path: make(path, KINDS["gif"]),
    "odd.mkv": lambda path: make(path, KINDS["odd-size"]),
    "irregular.mp4": lambda path: make(path, KINDS["variable-mp4"]),
}


@pytest.mark.parametrize("name", MAKE)
@pytest.mark.parametrize("height", [None, 24, 40])
@pytest.mark.parametrize(
    "span",
    [Span(), Span(start=Position(frame=7)), Span(end=Position(frame=9))],
    ids=["all", "start", "end"],
)
def test_frames_are_the_same_apart(
    name: str, height: int | None, span: Span, tmp_path: Path
) -> None:
    path = MAKE[name](tmp_path / name)
    with apart(path, height, span) as there, open_video(path, height=height, span=span) as here:
        assert there.facts == here.facts
        assert there.working == here.working
        expected, frames = list(here), list(there)
    assert [(each.index, each.time_s) for each in frames] == [
        (each.index, each.time_s) for each in expected
    ]
    for one, other in zip(frames, expected, strict=True):
        np.testing.assert_array_equal(one.luma, other.luma)
    assert (there.decode.apart, here.decode.apart) == (True, False)
    there.decode.apart = False
    assert there.decode == here.decode


def test_a_picture_lasts_until_the_next_one(tmp_path: Path) -> None:
    path = many(tmp_path / "a.mp4")
    process = DecodingProcess()
    process.begin(str(path), None, Span(), 0)
    expected = {}
    with open_video(path, height=None) as here:
        expected = {frame.index: frame.luma for frame in here}
    for picture in process.opened().pictures():
        time.sleep(0.01)  # it has time to write into the place of this one
        luma = (picture.plane.astype(np.float32) - 16) / 219
        np.testing.assert_allclose(luma.clip(0, 1), expected[picture.index], atol=1e-6)
    process.close()


def test_what_it_cannot_open_is_said_as_here(tmp_path: Path) -> None:
    path = tmp_path / "no.mp4"
    path.write_bytes(b"nothing" * 100)
    with pytest.raises(SourceError) as here:
        open_video(path)
    with pytest.raises(SourceError) as there:
        apart(path)
    assert str(there.value) == str(here.value)


@pytest.mark.parametrize("name", ["nosuch.mp4", "camera:x", "http://127.0.0.1:1/a.mp4"])
def test_other_inputs_are_read_here(name: str) -> None:
    process = DecodingProcess()
    call = opening.begin_opening(
        name,
        height=240,
        span=Span(),
        image_rate=Fraction(30),
        threads=0,
        colour=False,
        apart=process,
    )
    with pytest.raises(SourceError):
        call.result()
    with pytest.raises(ValueError, match="closed"):
        process.begin("a.mp4", None, Span(), 0)


def decoder_of(run: subprocess.Popen[str]) -> int:
    """The process that decodes for a run."""
    (process,) = Path(f"/proc/{run.pid}/task/{run.pid}/children").read_text().split()
    return int(process)


@pytest.fixture(scope="module")
def film(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("film")
    frames = grey_frames(60, width=96, height=64) * 30
    return write_video(folder / "film.avi", frames, codec="mpeg4", pixel_format="yuv420p")


@pytest.mark.skipif(
    not hasattr(os, "sched_getaffinity") or len(os.sched_getaffinity(0)) < 2,
    reason="NOT MEASURED: with one core nothing is decoded apart",
)
@pytest.mark.parametrize("name", ["SIGSEGV", "SIGKILL"])
def test_a_run_whose_decoder_ends(film: Path, tmp_path: Path, name: str) -> None:
    with subprocess.Popen(
        [sys.executable, "-c", ENTRY, "run", str(film), "-o", str(tmp_path)],
        stderr=subprocess.PIPE,
        text=True,
    ) as run:
        part = tmp_path / "film.frames.csv.part"
        while run.poll() is None and (not part.exists() or part.stat().st_size < 400):
            time.sleep(0.01)
        os.kill(decoder_of(run), getattr(signal, name))
        said = run.communicate(timeout=30)[1]
    if name == "SIGKILL":
        rows = part.read_text().count("\n") - 1
        assert run.returncode == 3
        assert said.strip() == (
            f"oppload: {film}: its decoder was ended (SIGKILL) after frame {rows - 1}; check the "
            f"memory, and run it again; the first {rows} rows are in {part}"
        )
        return
    # A crash is the file's doing: what there is of it is a result, and said to be incomplete.
    rows = (tmp_path / "film.frames.csv").read_text().count("\n") - 1
    assert 1 < rows < 1800
    assert run.returncode == 4
    reason = f"the decoder crashed (SIGSEGV) after frame {rows - 1}"
    assert reason in said
    decode = json.loads((tmp_path / "film.oppload.json").read_text())["decode"]
    assert (decode["decoded"], decode["failures"], decode["complete"]) == (rows, 1, False)
    assert decode["messages"] == [reason]
