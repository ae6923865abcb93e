"""Decoding in a separate process: the same pictures, and the end of a decoder."""

from __future__ import annotations

import gc
import json
import multiprocessing
import os
import signal
import sys
import threading
import time
from collections import deque
from contextlib import suppress
from fractions import Fraction
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pytest

from oppload_cli import open_video
from oppload_cli.errors import SourceError
from oppload_cli.pipeline.settings import resolve
from oppload_cli.video import opening
from oppload_cli.video.opening import Opening
from oppload_cli.video.span import Position, Reading, Span
from tests.cli.process import in_turn, python, start, wait_for_rows
from tests.media import grey_frames, write_film, write_video
from tests.robustness.inputs import KINDS, make
from tests.video.test_container import MATRICES, turned

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from oppload_cli.video.frames import Frame

pytestmark = [
    pytest.mark.skipif(sys.platform != "linux", reason="processes are forked on Linux only"),
    # Other tests have left threads here; the forked processes need nothing of theirs.
    pytest.mark.filterwarnings("ignore:.*multi-threaded:DeprecationWarning"),
]


@pytest.fixture(autouse=True)
def _possible(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let the process of the tests fork another one, although it has threads."""
    monkeypatch.setattr(opening, "_can_fork", lambda: True)
    monkeypatch.setattr(opening, "cores", lambda: 2)
    gc.collect()
    gc.freeze()  # decoders of other tests, freed in the fork, would wait for their threads


def begun(
    path: Path | str,
    height: int | None = 240,
    span: Span | None = None,
    true_rate: Fraction | None = None,
) -> Opening:
    """A video that another process decodes."""
    return Opening(
        str(path),
        height=height,
        span=span or Span(),
        reading=Reading(Fraction(30), true_rate),
        own_process=True,
    )


def children() -> list[int]:
    """Return the processes that this process started and has not yet waited for."""
    return [each.pid or 0 for each in multiprocessing.active_children()]


def many(path: Path) -> Path:
    """More frames than places in the shared memory."""
    return write_video(path, grey_frames(70), codec="libx264", pixel_format="yuv420p")


MAKE: dict[str, Callable[[Path], Path]] = {
    "many.mp4": many,
    "turned.mp4": lambda path: turned(many(path), MATRICES[90]),
    "deep.mkv": lambda path: make(path, KINDS["h264-ten-bits"]),
    "colour.gif": lambda path: make(path, KINDS["gif"]),
    "odd.mkv": lambda path: make(path, KINDS["odd-size"]),
    "irregular.mp4": lambda path: make(path, KINDS["variable-mp4"]),
}


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    folder = tmp_path_factory.mktemp("made")
    return {name: make_it(folder / name) for name, make_it in MAKE.items()}


@pytest.mark.parametrize(
    ("name", "height", "span", "true_rate"),
    [
        *((name, None, Span(), None) for name in MAKE),
        ("turned.mp4", 24, Span(start=Position(frame=7)), None),
        ("colour.gif", 40, Span(end=Position(frame=9)), None),
        ("many.mp4", 24, Span(end=Position(seconds=0.2)), Fraction(240)),
    ],
)
def test_frames_are_the_same_in_a_separate_process(
    name: str, height: int | None, span: Span, true_rate: Fraction | None, made: dict[str, Path]
) -> None:
    path = made[name]
    with (
        begun(path, height, span, true_rate).result() as there,
        open_video(path, height=height, span=span, true_rate=true_rate) as here,
    ):
        assert there.facts == here.facts
        assert there.working == here.working
        expected, frames = list(here), list(there)
    assert [(each.index, each.time_s) for each in frames] == [
        (each.index, each.time_s) for each in expected
    ]
    for one, other in zip(frames, expected, strict=True):
        np.testing.assert_array_equal(one.luma, other.luma)
    assert (there.decode.own_process, here.decode.own_process) == (True, False)
    there.decode.own_process = False
    assert there.decode == here.decode


@pytest.mark.long
@pytest.mark.parametrize("slots", [3, 64])
def test_no_picture_is_written_over_while_it_is_in_use(
    slots: int, made: dict[str, Path], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(opening, "MOST_SLOTS", slots)
    path = made["many.mp4"]
    with open_video(path, height=48) as here:
        expected = [frame.luma for frame in here]
    video = begun(path, 48).result()
    source = video._source
    for picture in source.pictures():
        time.sleep(0.005)  # the process has time to decode far ahead
        luma = (picture.plane.astype(np.float32) - 16) / 219
        np.testing.assert_allclose(luma.clip(0, 1), expected[picture.index], atol=1e-6)
    video.close()


def test_a_file_that_cannot_be_opened_gives_the_same_error(tmp_path: Path) -> None:
    path = tmp_path / "no.mp4"
    path.write_bytes(b"nothing" * 100)
    with pytest.raises(SourceError) as here:
        open_video(path)
    with pytest.raises(SourceError) as there:
        begun(path).result()
    assert str(there.value) == str(here.value)
    assert children() == []


def test_a_bug_in_the_process_is_raised_with_its_traceback(
    made: dict[str, Path], monkeypatch: pytest.MonkeyPatch
) -> None:
    class TwoWordsError(Exception):
        """An error that pickle cannot make again from its message alone."""

        def __init__(self, one: str, two: str) -> None:
            super().__init__(f"{one} {two}")

    def broken(*_: object, **__: object) -> None:
        raise TwoWordsError("on", "purpose")

    monkeypatch.setattr("oppload_cli.video.container.ContainerSource", broken)
    with pytest.raises(RuntimeError, match="TwoWordsError: on purpose") as caught:
        begun(made["many.mp4"]).result()
    assert "in broken" in caught.value.__notes__[0]


@pytest.mark.parametrize("name", ["nosuch.mp4", "camera:x", "http://127.0.0.1:1/a.mp4"])
def test_other_inputs_are_read_by_a_thread(name: str) -> None:
    begin = begun(name)
    assert children() == []
    with pytest.raises(SourceError):
        begin.result()


def test_closing_ends_the_process_at_once(made: dict[str, Path]) -> None:
    path = made["many.mp4"]
    files = len(list(Path("/proc/self/fd").iterdir()))
    for used in (False, True):
        begin = begun(path)
        (process,) = children()
        if used:
            next(iter(begin.result()))
        begin.close()
        begin.close()
        assert children() == []
        assert not Path(f"/proc/{process}").exists()
        del begin
    gc.collect()
    assert len(list(Path("/proc/self/fd").iterdir())) == files


def test_closing_while_a_thread_waits_for_a_picture(made: dict[str, Path]) -> None:
    path = made["many.mp4"]
    for _ in range(5):
        video = begun(path).result()
        frames = iter(video)
        next(frames)
        (process,) = children()
        os.kill(process, signal.SIGSTOP)
        thread = threading.Thread(target=lambda frames=frames: _drained(frames))
        thread.start()
        time.sleep(0.005)
        video.close()
        thread.join(60)
        assert not thread.is_alive()


def _drained(frames: Iterator[Frame]) -> None:
    with suppress(SourceError):
        deque(frames)


def _ends(process: int) -> bool:
    """Return whether a process ends, perhaps as a zombie, within two minutes."""
    for _ in range(6000):
        try:
            stat = Path(f"/proc/{process}/stat").read_text()
        except (FileNotFoundError, ProcessLookupError):
            return True
        if stat.rpartition(")")[2].split()[0] in "ZX":
            return True
        time.sleep(0.02)
    return False


@pytest.mark.long
def test_it_ends_with_the_process_that_started_it(made: dict[str, Path]) -> None:
    path = made["many.mp4"]
    code = (
        "import os, signal, sys; from fractions import Fraction\n"
        "from oppload_cli.video.opening import Opening\n"
        "from oppload_cli.video.span import Reading, Span\n"
        "o = Opening(sys.argv[1], height=24, span=Span(), reading=Reading(Fraction(30)),"
        " own_process=True)\n"
        "o.result()\n"
        "print(open(f'/proc/thread-self/children').read(), flush=True)\n"
        "os.kill(os.getpid(), signal.SIGKILL)\n"
    )
    done = python(code, path)
    assert done.stderr == ""
    assert _ends(int(done.stdout))


def test_a_process_with_threads_is_not_forked(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.undo()
    release = threading.Event()
    thread = threading.Thread(target=release.wait)
    thread.start()
    assert not opening._can_fork()
    release.set()
    thread.join()


@pytest.fixture(scope="module")
def film(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("film")
    return write_film(folder / "film.avi", 96, 64, times=30)


@pytest.mark.long
def test_the_height_is_known_before_the_settings_are_resolved(film: Path, tmp_path: Path) -> None:
    cases: list[tuple[dict[str, str], str]] = [
        ({}, ""),
        ({"model": "opplod_paper"}, ""),
        ({}, 'models = ["opplod", "opplod_paper"]\n'),
        ({"model": "opplod_reference"}, "height = 50\n"),
        ({"height": "30"}, "height = 50\n"),
        ({"height": "native"}, 'models = ["opplod_paper"]\nheight = 50\n'),
        ({}, 'height = "native"\n'),
    ]
    commands: list[tuple[str | Path, ...]] = []
    heights = []
    for number, (options, content) in enumerate(cases):
        out, config = tmp_path / str(number), tmp_path / f"{number}.toml"
        config.write_text(content)
        words = [word for name, value in options.items() for word in (f"--{name}", value)]
        commands.append(("run", film, "-o", out, "--end", "f2", "--config", config, *words))
        models = [options["model"]] if "model" in options else []
        settings = resolve(models=models, config=config, height=options.get("height"))
        heights.append((settings.pixels or 64, not settings.other_heights))
    assert in_turn(*commands).returncodes == [0] * len(cases)
    paths = [tmp_path / str(number) / "film.oppload.json" for number in range(len(cases))]
    sidecars = [json.loads(path.read_text()) for path in paths]
    assert [sidecar["working"]["height"] for sidecar in sidecars] == [px for px, _ in heights]
    # Pictures of several sizes are too large for the memory that two processes share.
    several = len(os.sched_getaffinity(0)) > 1
    apart = [several and of_one_size for _, of_one_size in heights]
    assert [sidecar["threads"]["decoder_apart"] for sidecar in sidecars] == apart


@pytest.mark.long
@pytest.mark.skipif(
    not hasattr(os, "sched_getaffinity") or len(os.sched_getaffinity(0)) < 2,
    reason="NOT MEASURED: with one core a thread decodes",
)
@pytest.mark.parametrize("name", [pytest.param("SIGSEGV", marks=pytest.mark.slow), "SIGKILL"])
def test_a_run_whose_decoder_ends(film: Path, tmp_path: Path, name: str) -> None:
    with start("run", film, "-o", tmp_path, "--height", "24") as run:
        part = tmp_path / "film.frames.csv.part"
        wait_for_rows(run, part)
        (decoder,) = Path(f"/proc/{run.pid}/task/{run.pid}/children").read_text().split()
        os.kill(int(decoder), getattr(signal, name))
        said = run.communicate(timeout=120)[1]
    if name == "SIGKILL":
        rows = part.read_text().count("\n") - 1
        assert run.returncode == 3
        assert said.strip() == (
            f"oppload: {film}: its decoder was ended (SIGKILL) after frame {rows - 1}; check the "
            f"memory, and run it again; the first {rows} rows are in {part}"
        )
        return
    # A crash comes from the file: the frames before it are a result, said to be incomplete.
    rows = (tmp_path / "film.frames.csv").read_text().count("\n") - 1
    assert 1 < rows < 1800
    assert run.returncode == 4
    reason = f"the decoder crashed (SIGSEGV) after frame {rows - 1}"
    assert reason in said
    decode = json.loads((tmp_path / "film.oppload.json").read_text())["decode"]
    assert (decode["decoded"], decode["failures"], decode["complete"]) == (rows, 1, False)
    assert decode["messages"] == [reason]
