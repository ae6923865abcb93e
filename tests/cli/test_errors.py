"""Every wrong use: one sentence, the right exit code, nothing half-written."""

from __future__ import annotations

import io
import json
import os
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from contextlib import redirect_stderr, redirect_stdout, suppress
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

from oppload_cli.cli import main, say
from tests.cli import process
from tests.cli.inside import oppload

if TYPE_CHECKING:
    from collections.abc import Iterator


def prepared(folder: Path) -> None:
    (folder / "text.mp4").write_text("not a video\n" * 100)
    (folder / "empty").mkdir()
    (folder / "other.csv").write_text("a,b\n1,2\n")
    (folder / "file").write_text("in the way")
    (folder / "binary.csv").write_bytes(b"a\xff\n")
    (folder / "preset.toml").write_text('preset = "reference"\nheight = 60\n')
    old: dict[str, object] = {"schema": "oppload.result/2", "preset": "lplc2", "parameters": {}}
    (folder / "old.oppload.json").write_text(json.dumps(old))


WRONG = [
    (["run", "missing.mp4"], 3, "missing.mp4: no such file; check the path"),
    (["run", "0"], 3, "0: no such file; write camera:0 for a camera"),
    (["run", "camera1"], 3, "camera1: no such file; write camera:1 for a camera"),
    (["run", "text.mp4"], 3, "text.mp4: not a video that can be read"),
    (["run", "text.mp4", "-o", "out"], 3, "text.mp4: not a video that can be read"),
    (["report", "other.csv", "-o", "out"], 2, "other.csv: has no column 'frame'"),
    (["run", "empty"], 3, "empty: no video and no image in this folder"),
    (["run", "CLIP", "--model", "dlgdm"], 2, "no model 'dlgdm'; did you mean 'dlgmd'?"),
    (["run", "CLIP", "--preset", "papr"], 2, "there are no presets since 1.0, and no detector"),
    (["run", "CLIP", "--preset", "paper"], 2, "in place of 'paper' write --model opplod_paper (in"),
    (["run", "CLIP", "--preset", "robust"], 2, "in place of 'robust' write --model opplod (in"),
    (["config", "--preset", "default"], 2, "in place of 'default' write --model opplod (in"),
    (["tune", "controls/plaid", "--preset", "lplc2"], 2, "write --model opplod_lplc2 (in"),
    (["run", "CLIP", "--model", "opplod:paper"], 2, "of 'paper' write --model opplod_paper (in"),
    (["run", "CLIP", "--model", "dlgmd:paper"], 2, "in place of 'paper' write --model dlgmd (in"),
    (["tune", "controls/plaid", "--model", "hua:literal"], 2, "did you mean 'hua_literal'?"),
    (["plot", "file", "--model", "opplod:paper"], 2, "write --model opplod_paper (in"),
    (["evaluate", "file", "--model", "opplod:lplc2"], 2, "write --model opplod_lplc2 (in"),
    (["run", "CLIP", "--config", "preset.toml"], 2, "write --model opplod_reference (in"),
    (["config", "--config", "old.oppload.json"], 2, "write --model opplod_lplc2 (in Python"),
    (["run", "CLIP", "--set", "opplod.receptive_feild=9"], 2, "did you mean 'receptive_field'?"),
    (["run", "CLIP", "--set", "opplod.cell=0"], 2, "must be at least 1, not 0"),
    (["run", "CLIP", "--height", "0"], 2, "height must be 'auto', 'native' or a whole number"),
    (["run", "CLIP", "--start", "soon"], 2, "--start: 'soon' is no position"),
    (["run", "CLIP", "--start", ""], 2, "--start: '' is no position"),
    (["run", "CLIP", "--end", ""], 2, "--end: '' is no position"),
    (["run", "CLIP", "--duration", ""], 2, "--duration: '' is no position"),
    (["run", "CLIP", "--image-rate", "0"], 2, "--image-rate must be a number above 0"),
    (["run", "CLIP", "--true-rate", "1/0"], 2, "--true-rate must be a number above 0"),
    (["run", "camera:7", "--true-rate", "30"], 3, "camera:7: it is a camera, so that its times"),
    (["run", "CLIP", "--config", "none.toml"], 2, "none.toml: cannot be read"),
    (["run", "CLIP", "-o", "file"], 2, "file: cannot be written (not a directory)"),
    (["run", "CLIP", "-o", "file/inside"], 2, f"file{os.sep}inside: cannot be written (not a"),
    (["tune", "controls/plaid", "-o", "-"], 2, "'-' is standard output, which cannot hold the f"),
    (["run", "CLIP", "-o", "result.csv"], 2, "'result.csv' is the name of a file; give a folder"),
    (["stimuli", "generate", "looming-disk-centre", "-o", "a.MP4"], 2, "'a.MP4' is the name of a"),
    (["run", "CLIP", "CLIP2", "-o", "-"], 2, "'-o -' streams one input"),
    (
        ["run", "looming-disk-centre"],
        3,
        "'oppload stimuli generate opplod2023/looming-disk-centre'",
    ),
    (["run", "controls/plade"], 3, "'oppload stimuli generate controls/plaid' makes"),
    (["stimuli", "generate", "looming-disk-center"], 2, "did you mean 'looming-disk-centre'?"),
    (["evaluate", "empty"], 2, "empty: is a folder; give its manifest"),
    (["run", "CLIP", "--model", "lgmd1"], 2, "no model 'lgmd1'; did you mean 'lgmd1_group'?"),
    (["plot", "text.mp4"], 2, "text.mp4: is a video, not a result; run it first"),
    (["report", "text.mp4"], 2, "text.mp4: is a video, not a result; run it first"),
    (["evaluate", "text.mp4"], 2, "text.mp4: has no ground truth beside it (text.stimulus.json)"),
    (["run", "-"], 3, "-: give /dev/stdin to read from standard input"),
    (["run", "-", "-o", "-"], 3, "-: give /dev/stdin to read from standard input"),
    (["plot", "binary.csv"], 2, "is not valid text in UTF-8 (byte 2 cannot be read as text)"),
    (["run"], 2, "Missing argument 'INPUT...'"),
    (["stimuli", "generate"], 2, "GLOB...'; 'oppload stimuli list' has the names"),
    (
        ["run", "CLIP", "--load", "a.py"],
        2,
        "--load stands before the command: oppload --load FILE.py",
    ),
    (["run", "CLIP", "--boxes", "all"], 2, "--boxes has no effect without --annotate"),
    (
        ["run", "CLIP", "--model", "dlgmd", "--set", "opplod.gain=2"],
        2,
        "setting opplod.gain=2 has no effect, as 'opplod' does not run; give --model opplod (in",
    ),
    (
        ["run", "CLIP", "--model", "dlgmd", "--set", "alarm.opplod_floor=2"],
        2,
        "setting alarm.opplod_floor=2 has no effect, as 'opplod' does not run; give --m",
    ),
    (
        ["run", "CLIP", "--no-rmo", "--set", "rmo.grid=8"],
        2,
        "setting rmo.grid=8 has no effect, as RMO is not measured; leave it out",
    ),
    (
        ["run", "CLIP", "--repeats", "keep", "--set", "repeats.handling=near"],
        2,
        "--repeats and --set repeats.handling are the same; give one",
    ),
    (["run", "CLIP", "--model", "opplod:defualt"], 2, "no model 'opplod:defualt'; did you mean"),
    (["run", "CLIP", "-q", "-v"], 2, "--quiet and --verbose exclude each other"),
    (["run", "CLIP", "-o", "-", "--dry-run"], 2, "leave out --recursive, --files-from, --shard,"),
    (["models", "--measure", "--json"], 2, "--measure prints no JSON; leave out --json"),
    (["reproduce", "--only", "up-down,diagnals"], 2, "no figure 'diagnals'; did you mean"),
    (["evaluate", "a.csv", "--model", "opplod, dlgdm"], 2, "no model 'dlgdm';"),
    (["run", "CLIP", "--null"], 2, "--null has no effect without --files-from"),
    (["--height", "60", "run", "CLIP"], 2, "no option '--height' before the command; write"),
    (["rnu"], 2, "no command 'rnu'; did you mean 'run'?"),
    (["text.mp4"], 2, "no command 'text.mp4'; did you mean 'oppload run text.mp4'?"),
    (["plot", "missing.csv"], 2, "missing.csv: cannot be read"),
    (["plot", "file"], 2, "file: has no column 'frame'; give a frames.csv of 'oppload run'"),
    (["plot", "other.csv"], 2, "has no column 'frame'"),
]


@pytest.mark.parametrize(("arguments", "code", "sentence"), WRONG)
def test_wrong_use(
    arguments: list[str], code: int, sentence: str, clip: Path, tmp_path: Path
) -> None:
    prepared(tmp_path)
    before = sorted(tmp_path.rglob("*"))
    named = [str(clip) if word == "CLIP" else word for word in arguments]
    done = oppload(*named, cwd=tmp_path)
    assert done.returncode == code
    assert sentence in done.stderr
    assert "Traceback" not in done.stderr
    assert len(done.stderr.strip().splitlines()) <= 4
    assert done.stdout == ""
    assert sorted(tmp_path.rglob("*")) == before


@pytest.mark.skipif(sys.platform == "win32" or os.geteuid() == 0, reason="root may write anywhere")
def test_a_folder_that_cannot_be_written(clip: Path, tmp_path: Path) -> None:
    tmp_path.chmod(0o500)
    done = oppload("run", clip, "-o", tmp_path)
    assert (done.returncode, "cannot be written" in done.stderr) == (2, True)


@pytest.mark.long
@pytest.mark.skipif(sys.platform == "win32", reason="no POSIX pipes")
def test_a_reader_that_goes_is_no_bug(clip: Path) -> None:
    read, write = os.pipe()
    os.close(read)
    try:
        done = process.in_turn(("run", clip, "-o", "-", "-q"), ("models",), stdout=write)
    finally:
        os.close(write)
    assert done == ([130, 130], "")


@pytest.mark.skipif(sys.platform == "win32", reason="no POSIX pipes")
def test_a_reader_that_is_slow_loses_no_row(clip: Path) -> None:
    read, write = os.pipe()
    os.set_blocking(write, False)
    with (
        ThreadPoolExecutor(1) as pool,
        io.TextIOWrapper(io.FileIO(read)) as reader,
        io.TextIOWrapper(io.FileIO(write, "w")) as stream,
        redirect_stdout(stream),
    ):
        rows = pool.submit(reader.readlines)
        with pytest.raises(SystemExit) as ended:
            main(["run", str(clip), "-o", "-", "-q"])
        waits = os.get_blocking(write)
        stream.close()
        assert (ended.value.code or 0, waits, len(rows.result())) == (0, True, 25)


@pytest.fixture
def full() -> Iterator[io.TextIOWrapper]:
    """A pipe that takes no further byte, as nobody reads it."""
    read, write = os.pipe()
    os.set_blocking(write, False)
    with suppress(BlockingIOError):
        while True:
            os.write(write, bytes(4096))
    with io.FileIO(read), io.TextIOWrapper(io.FileIO(write, "w")) as stream:
        yield stream


@pytest.mark.skipif(sys.platform == "win32", reason="no POSIX pipes")
def test_a_reader_that_never_reads_does_not_hold_back_an_interruption(
    clip: Path, full: io.TextIOWrapper, monkeypatch: pytest.MonkeyPatch
) -> None:
    def interrupted() -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr("oppload_cli.pipeline.execute.stop_if_asked", interrupted)
    err, ended = io.StringIO(), pytest.raises(SystemExit)
    with redirect_stdout(full), redirect_stderr(err), ended as code:
        main(["run", str(clip), "-o", "-", "-q"])
    assert (code.value.code, err.getvalue().strip()) == (130, "oppload: interrupted")


@pytest.mark.skipif(sys.platform == "win32", reason="no POSIX pipes")
def test_after_a_signal_no_message_waits_for_its_reader(
    full: io.TextIOWrapper, monkeypatch: pytest.MonkeyPatch
) -> None:
    printed: list[str] = []
    monkeypatch.setattr("click.echo", lambda line, **_: printed.append(line))
    monkeypatch.setattr("oppload_cli.processes.signals._received", [15])
    say("read")
    with redirect_stderr(full):
        say("not read")
    assert printed == ["read"]


@pytest.mark.skipif(sys.platform == "win32", reason="no POSIX pipes")
@pytest.mark.parametrize(
    "words",
    [
        ("run", "{clip}", "-o", "{place}", "-v", "--no-rmo"),
        ("stimuli", "generate", "controls/appearing-disk", "--format", "mp4", "-o", "{place}"),
    ],
)
def test_messages_that_nobody_reads_stop_no_work(
    clip: Path, tmp_path: Path, words: tuple[str, ...]
) -> None:
    read, write = os.pipe()
    os.close(read)
    with (
        io.TextIOWrapper(io.FileIO(write, "w"), write_through=True) as gone,
        redirect_stderr(gone),
        pytest.raises(SystemExit) as ended,
    ):
        main([word.format(clip=clip, place=tmp_path) for word in words])
    assert not ended.value.code
    assert list(tmp_path.iterdir())


def test_a_file_that_looks_like_an_option(clip: Path, tmp_path: Path) -> None:
    (tmp_path / "-dash.avi").write_bytes(clip.read_bytes())
    done = process.oppload("run", "-dash.avi", cwd=tmp_path)
    assert done.returncode == 2
    assert "'-dash.avi' begins with a dash, like an option; write ./-dash.avi" in done.stderr
    assert "begins with a dash" not in process.oppload("run", "-dish.avi", cwd=tmp_path).stderr


@pytest.mark.long
def test_a_disk_that_is_full(clip: Path) -> None:
    if not Path("/dev/full").exists():
        pytest.skip("no /dev/full here")
    with Path("/dev/full").open("w") as full:
        done = process.in_turn(("run", clip, "-o", "-"), ("models",), ("config",), stdout=full)
    assert done.returncodes == [2, 2, 2]
    lines = done.stderr.splitlines()
    assert ["no space left on device" in line for line in lines] == [True, True, True]
    assert ["standard output" in line for line in lines] == [True, True, True]


@pytest.mark.long
@pytest.mark.skipif(sys.platform == "win32", reason="no POSIX shell")
@pytest.mark.parametrize("closed", ["<&-", ">&-", "2>&-"])
def test_a_closed_standard_stream_is_refused(closed: str) -> None:
    words = ["sh", "-c", f'exec "$@" {closed}', "sh", sys.executable, "-m", "oppload_cli", "models"]
    done = subprocess.run(words, capture_output=True, text=True, check=False, timeout=60)
    told = "oppload: a standard stream is closed; open it, for example as /dev/null\n"
    assert (done.returncode, done.stdout) == (2, "")
    assert done.stderr == ("" if closed == "2>&-" else told)


def test_debugging_shows_the_traceback(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("OPPLOAD_DEBUG", "1")
    done = oppload("run", "missing.mp4")
    assert done.returncode == 3
    assert "Traceback" in done.stderr
