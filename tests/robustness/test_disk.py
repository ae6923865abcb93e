"""Full, read-only and forbidden disks; names of every kind; nothing overwritten unasked."""

from __future__ import annotations

import json
import os
import re
import shutil
import subprocess
import sys
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

from oppload_cli.errors import OutputError
from oppload_cli.files.atomic import PartFile
from oppload_cli.stimulus import find
from tests.cli.inside import Done, oppload
from tests.cli.process import ENTRY, InTurn, in_turn, python
from tests.media import grey_frames, write_film, write_video

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence


@pytest.fixture(scope="module")
def clip(tmp_path_factory: pytest.TempPathFactory) -> Path:
    frames = grey_frames(12)
    return write_video(tmp_path_factory.mktemp("disk") / "clip.avi", frames, codec="ffv1")


@contextmanager
def mounted(folder: Path, options: str) -> Iterator[Path]:
    """Mount a small file system, if the system allows it."""
    if not shutil.which("mount"):
        pytest.skip("NOT TESTED: no command that mounts")
    folder.mkdir()
    done = subprocess.run(
        ["mount", "-t", "tmpfs", "-o", options, "tmpfs", str(folder)],
        capture_output=True,
        check=False,
    )
    if done.returncode:
        pytest.skip("NOT TESTED: mounting needs root")
    try:
        yield folder
    finally:
        subprocess.run(["umount", str(folder)], check=True)


@pytest.mark.long
def test_a_disk_that_fills_up(clip: Path, tmp_path: Path) -> None:
    film = write_film(tmp_path / "film.avi", times=4)
    with mounted(tmp_path / "small", "size=16k") as folder:
        done = oppload("run", film, "-o", folder, "--height", "60")
        assert done.returncode == 2
        part = folder / "film.frames.csv.part"
        assert "no space left on device" in done.stderr
        assert f"rows are in {part}" in done.stderr
        assert "Traceback" not in done.stderr
        assert "bug" not in done.stderr
        assert part.read_text().startswith("frame,time_s,")
        names = ["film.detections.jsonl.part", part.name]
        assert sorted(path.name for path in folder.iterdir()) == names


@pytest.mark.long
# While the video is written, and while it may be finished.
@pytest.mark.parametrize("size", ["100k", pytest.param("400k", marks=pytest.mark.slow)])
def test_a_disk_that_an_annotated_video_fills(tmp_path: Path, size: str) -> None:
    film = write_film(tmp_path / "film.avi", times=4)
    with mounted(tmp_path / size, f"size={size}") as folder:
        done = oppload("run", film, "-o", folder, "--height", "60", "--annotate", "--no-rmo")
        assert (done.returncode, done.stderr.strip().count("\n")) == (2, 0), done.stderr
        # The system decides which of the files is written when the disk is full.
        full = r"film\.(annotated\.mp4|detections\.jsonl|frames\.csv): cannot be written"
        assert re.search(full, done.stderr), done.stderr
        names = ["film.detections.jsonl.part", "film.frames.csv.part"]
        assert sorted(path.name for path in folder.iterdir()) == names


def test_a_disk_that_is_full_from_the_start_or_for_the_sidecar(clip: Path, tmp_path: Path) -> None:
    with mounted(tmp_path / "small", "size=8k") as folder:
        filler = folder / "filler"
        filler.write_bytes(bytes(8192))
        done = oppload("run", clip, "-o", folder)
        assert (done.returncode, done.stderr.count("\n")) == (2, 1)
        assert "no space left" in done.stderr
        assert list(folder.iterdir()) == [filler]
        filler.write_bytes(bytes(4096))  # now the rows fit, and the sidecar does not
        done = oppload("run", clip, "-o", folder)
        assert (done.returncode, done.stderr.count("\n")) == (2, 1)
        assert "clip.oppload.json: cannot be written (no space left" in done.stderr
        assert "the first 12 rows are in" in done.stderr
        names = ["clip.detections.jsonl.part", "clip.frames.csv.part", "filler"]
        assert sorted(path.name for path in folder.iterdir()) == names


WRITERS = {
    "run": ("run", "{clip}", "-o", "{place}"),
    "run --annotate": ("run", "{clip}", "-o", "{place}", "--annotate"),
    "run, a batch": ("run", "{clip}", "{copy}", "-o", "{place}", "-j", "1"),
    "collect csv": ("collect", "{results}", "-o", "{place}/all.csv"),
    "collect parquet": ("collect", "{results}", "-o", "{place}/all.parquet"),
    "plot png": ("plot", "{table}", "-o", "{place}/a.png"),
    "plot svg": ("plot", "{table}", "-o", "{place}/a.svg"),
    "plot pdf": ("plot", "{table}", "-o", "{place}/a.pdf"),
    "demo": ("demo", "-o", "{place}"),
    "tune": ("tune", "klapoetke2017/bar-expand-10", "--over", "speed=40", "-o", "{place}"),
    "evaluate": ("evaluate", "{manifest}", "-o", "{place}"),
    "reproduce": ("reproduce", "-o", "{place}"),
    **{
        f"stimuli {form}": (
            *("stimuli", "generate", "controls/appearing-disk", "--format", form),
            *("-o", "{place}", "--preview"),
        )
        for form in ("ffv1", "mkv", "mp4", "png", "npz", "gif")
    },
}


@pytest.fixture(params=list(WRITERS.values()), ids=list(WRITERS))
def command(request: pytest.FixtureRequest) -> tuple[str, ...]:
    words: tuple[str, ...] = request.param
    if "{place}/all.parquet" in words:
        pytest.importorskip("pyarrow", reason="NOT TESTED: pip install 'oppload[parquet]'")
    return words


@pytest.fixture(scope="module")
def words(clip: Path, tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """The files that the commands of `WRITERS` read, by their names there."""
    folder = tmp_path_factory.mktemp("results")
    assert oppload("run", clip, "-o", folder, "--height", "48").returncode == 0
    copy, manifest = folder / "copy.avi", folder / "manifest.csv"
    copy.write_bytes(clip.read_bytes())
    manifest.write_text(f"file,label,onset_frame,contact_frame\n{clip},looming,2,9\n")
    table = folder / "clip.frames.csv"
    return {"clip": clip, "copy": copy, "manifest": manifest, "results": folder, "table": table}


def one_sentence(done: Done, sentence: str) -> None:
    assert done.returncode == 2, done
    assert sentence in done.stderr
    assert "; check the folder and the space on its disk, or choose another --output" in done.stderr
    lines = [line for line in done.stderr.splitlines() if not line.startswith("note: ")]
    assert (len(lines), done.stdout) == (1, "")


@pytest.mark.usefixtures("undrawn")
def test_every_command_says_in_one_sentence_that_it_cannot_write(
    command: tuple[str, ...],
    words: dict[str, Path],
    tmp_path: Path,
) -> None:
    (tmp_path / "file").write_text("in the way")
    places = {
        tmp_path / "file": "not a directory",
        tmp_path / "file" / "within": "not a directory",
    }
    if sys.platform != "win32":  # Windows says otherwise that a name is too long
        places[tmp_path / ("n" * 300)] = "file name too long"
    if sys.platform == "linux":
        places |= {
            Path("/dev/full"): "not a directory",
            Path("/proc/x"): "no such file or directory",
        }
    for place, reason in places.items():
        named = [word.format(place=place, **words) for word in command]
        one_sentence(oppload(*named), f": cannot be written ({reason})")
    assert [path.name for path in tmp_path.iterdir()] == ["file"]


@pytest.fixture(scope="module")
def read_only(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    with mounted(tmp_path_factory.mktemp("disk") / "fixed", "ro") as folder:
        yield folder


@pytest.mark.usefixtures("undrawn")
def test_every_command_on_a_read_only_disk(
    command: tuple[str, ...],
    words: dict[str, Path],
    read_only: Path,
) -> None:
    named = [word.format(place=read_only, **words) for word in command]
    if command[1] != "{clip}" or command[2] == "-o":
        one_sentence(oppload(*named), ": cannot be written (read-only file system)")
        return
    done = oppload(*named)  # each input says so, and failures.csv
    assert (done.returncode, "bug" in done.stderr) == (2, False)
    assert done.stderr.count("cannot be written (read-only file system)") == 3


@pytest.mark.long
def test_no_folder_for_the_cache_of_matplotlib(tmp_path: Path) -> None:
    code = (
        "import sys, tempfile\n"
        "from oppload_cli.cli import main\n"
        "tempfile.tempdir = sys.argv[1]  # a file, no folder\n"
        "main(['plot', sys.argv[1]])\n"
    )
    table = tmp_path / "clip.frames.csv"
    table.write_text("frame,time_s,luma_change\n0,0,\n1,0.1,0.5\n")
    done = python(code, table, MPLCONFIGDIR=str(table))
    assert done.returncode == 2
    *_, last = done.stderr.splitlines()
    assert last == (
        "oppload: matplotlib finds no folder that it can write for its cache; "
        "set the environment variable MPLCONFIGDIR to one"
    )


@pytest.mark.usefixtures("undrawn")
def test_a_plot_beside_its_result_on_a_read_only_disk(
    words: dict[str, Path], tmp_path: Path
) -> None:
    with mounted(tmp_path / "fixed", "rw") as folder:
        shutil.copy(words["table"], folder)
        subprocess.run(["mount", "-o", "remount,ro", str(folder)], check=True)
        done = oppload("plot", folder / words["table"].name)
        one_sentence(done, "clip.frames.png: cannot be written (read-only file system)")


def put(kind: str, part: Path, target: Path) -> None:
    """Make the named kind of file, such as a link, in place of a part file."""
    target.write_text("mine")
    if kind == "symbolic link":
        part.symlink_to(target)
    elif kind == "hard link":
        part.hardlink_to(target)
    elif kind == "pipe":
        os.mkfifo(part)
    else:
        part.mkdir()


@pytest.mark.skipif(sys.platform == "win32", reason="no pipes with names")
@pytest.mark.parametrize("kind", ["symbolic link", "hard link", "pipe", "folder"])
def test_something_else_in_the_place_of_a_part_file(kind: str, clip: Path, tmp_path: Path) -> None:
    target, part = tmp_path / "mine.txt", tmp_path / "clip.frames.csv.part"
    put(kind, part, target)
    reason = "clip.frames.csv.part is a link, a folder or a device"
    with pytest.raises(OutputError, match=re.escape(reason)):
        PartFile(tmp_path / "clip.frames.csv")
    done = oppload("run", clip, "-o", tmp_path, "--if-exists", "overwrite")
    one_sentence(done, f"clip.frames.csv: cannot be written ({reason})")
    assert target.read_text() == "mine"
    assert sorted(path.name for path in tmp_path.iterdir()) == [part.name, target.name]


def test_a_link_that_is_put_there_at_the_last_moment(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    if not hasattr(os, "O_NOFOLLOW"):
        pytest.skip("NOT TESTED: this system follows links")
    put("symbolic link", tmp_path / "a.csv.part", tmp_path / "mine.txt")
    monkeypatch.setattr(os, "lstat", lambda _: Path(__file__).stat())
    with pytest.raises(OutputError, match="cannot be written"):
        PartFile(tmp_path / "a.csv")
    assert (tmp_path / "mine.txt").read_text() == "mine"


def test_a_folder_in_the_place_of_a_result(clip: Path, tmp_path: Path) -> None:
    (tmp_path / "clip.frames.csv").mkdir()
    done = oppload("run", clip, "-o", tmp_path, "--if-exists", "overwrite")
    one_sentence(done, "clip.frames.csv: cannot be written (is a directory)")
    assert [path.name for path in tmp_path.iterdir()] == ["clip.frames.csv"]


def without_privilege(*commands: Sequence[str | Path]) -> InTurn:
    """Run commands without the right of root to read and write all files."""
    rights = "-dac_override,-dac_read_search"
    drop = ["setpriv", "--bounding-set", rights, "--"] if os.geteuid() == 0 else []
    if drop and not shutil.which("setpriv"):
        pytest.skip("NOT TESTED: root may read everything, and there is no setpriv")
    return in_turn(*commands, prefix=drop)


@pytest.mark.long
@pytest.mark.skipif(sys.platform == "win32", reason="rights are of POSIX")
def test_files_without_permission(clip: Path, tmp_path: Path) -> None:
    secret, closed, out = tmp_path / "secret.avi", tmp_path / "closed", tmp_path / "out"
    secret.write_bytes(clip.read_bytes())
    secret.chmod(0)
    closed.mkdir(mode=0)
    names = [secret, closed / "a.avi", closed / "b_%d.png", closed]
    done = without_privilege(
        ("plot", closed / "a.avi"),
        ("--load", closed / "a.py", "models"),
        ("run", *names, "-o", out, "-j", "1"),
        ("run", closed, clip, "-o", tmp_path / "mixed", "-j", "1"),
        ("run", clip, "-o", closed),
        ("run", clip, "-o", closed / "a.csv"),
    )
    closed.chmod(0o700)
    assert done.returncodes == [2, 2, 3, 4, 2, 2], done.stderr
    assert "bug" not in done.stderr
    denied = [line for line in done.stderr.splitlines() if "permission denied" in line]
    assert len(denied) == 1 + len(names) + 1 + 1
    assert f"oppload: {closed}{os.sep}clip.frames.csv: cannot be written" in denied[-1]
    assert "is the name of a file" in done.stderr.splitlines()[-1]
    assert [path.name for path in out.iterdir()] == ["failures.csv"]
    assert not list(closed.iterdir())


LONG = "n" * 251


@pytest.mark.skipif(
    sys.platform == "win32", reason="Windows says otherwise that a name is too long"
)
@pytest.mark.parametrize(
    ("words", "sentence"),
    [
        (("plot", f"{LONG * 2}.mp4"), "cannot be read (file name too long)"),
        (("plot", f"{LONG}.toml"), "cannot be read (file name too long)"),
        (("--load", f"{LONG * 2}.py", "models"), "no such file"),
        (("tune", f"{LONG}/bar"), f"no stimulus '{LONG}/bar' in the catalogue"),
        (("evaluate", f"{LONG}.avi"), "has no ground truth beside it"),
        (("run", f"{LONG * 2}/%d.png"), "cannot be read (file name too long)"),
    ],
)
def test_names_that_are_too_long(
    words: tuple[str, ...],
    sentence: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Also a name that is too long only with another suffix, or with ``.stimulus.json``."""
    monkeypatch.chdir(tmp_path)
    Path(f"{LONG}.avi").touch()
    done = oppload(*words)
    assert done.returncode in {2, 3}
    assert (sentence in done.stderr, "bug" in done.stderr) == (True, False), done.stderr


NAMES = [
    "with space.avi",
    "quo'te\".avi",
    "new\nline.avi",
    "-o.avi",
    "--help",
    "a:b.avi",
    "%.avi",
    "frame_%d.avi",
    "ünï çödé.avi",
    "esc\x1b[31mape.avi",
    "n" * 251 + ".avi",
    "no suffix",
]
if sys.platform == "win32":
    NAMES = [name for name in NAMES if not set(name) & set(':"\n\x1b')]


@pytest.mark.long
def test_names_of_every_kind(clip: Path, tmp_path: Path) -> None:
    inputs = tmp_path / "in"
    inputs.mkdir()
    for name in NAMES:
        (inputs / name).write_bytes(clip.read_bytes())
    done = oppload("run", "-o", tmp_path / "out", "--no-rmo", "-j", "1", "--", *NAMES, cwd=inputs)
    assert done.returncode == 0, done.stderr
    assert re.search(rf"^done +{len(NAMES)} +{12 * len(NAMES)} *$", done.stderr, re.MULTILINE)
    assert "\x1b" not in done.stderr
    sidecars = list((tmp_path / "out").glob("*.oppload.json"))
    named = [json.loads(path.read_text())["input"]["name"] for path in sidecars]
    assert sorted(named) == sorted(NAMES)
    assert len(list((tmp_path / "out").glob("*.frames.csv"))) == len(NAMES)


@pytest.mark.long
@pytest.mark.skipif(sys.platform == "win32", reason="each name is text there")
def test_a_name_that_is_no_utf_8(clip: Path, tmp_path: Path) -> None:
    name = os.fsencode(tmp_path) + b"/\xff\xfe.avi"
    try:
        Path(os.fsdecode(name)).write_bytes(clip.read_bytes())
    except OSError:
        pytest.skip("NOT TESTED: this file system takes no such name")
    done = python(ENTRY, "run", os.fsdecode(name), "-o", tmp_path / "out", "--annotate")
    assert done.returncode == 0, done.stderr
    assert r"\xff\xfe" in done.stderr or r"\udcff" in done.stderr
    assert len(list((tmp_path / "out").iterdir())) == 4
    # As in de_DE.UTF-8; in C.UTF-8, Python prints any bytes by itself.
    table = next((tmp_path / "out").glob("*.csv"))
    done = python(ENTRY, "report", table, PYTHONIOENCODING="utf-8:strict")
    page = table.with_name(table.name.replace("frames.csv", "report.html"))
    assert (done.returncode, done.stdout) == (0, f"{page}\n"), done.stderr


@pytest.mark.long
def test_a_name_that_standard_output_cannot_show(clip: Path, tmp_path: Path) -> None:
    # As of `oppload stimuli generate > list` in a console of Windows with another code page.
    words = "stimuli", "generate", "controls/appearing-disk", "-o", tmp_path / "Θ"
    done = python(ENTRY, *words, PYTHONIOENCODING="latin-1:strict")
    assert (done.returncode, r"\u0398" in done.stdout) == (0, True), done.stderr


@pytest.mark.skipif(sys.platform == "win32", reason="each name is text there")
def test_a_stimulus_whose_name_is_no_utf_8(tmp_path: Path) -> None:
    path = tmp_path / os.fsdecode(b"\xff.toml")
    try:
        shutil.copy(find("controls/appearing-disk")[0].path, path)
    except OSError:
        pytest.skip("NOT TESTED: this file system takes no such name")
    done = oppload("stimuli", "generate", path, "-o", tmp_path, "--format", "npz")
    assert done.returncode == 0, done.stderr
    truth = json.loads((tmp_path / f"{path.stem}.stimulus.json").read_text())
    assert truth["name"] == path.stem


def test_two_inputs_with_one_stem_and_one_input_twice(clip: Path, tmp_path: Path) -> None:
    (tmp_path / "b").mkdir()
    paths = [tmp_path / "a.avi", tmp_path / "b" / "a.avi", tmp_path / "A.mkv"]
    for path in paths:
        path.write_bytes(clip.read_bytes())
    twice = tmp_path / "b" / ".." / "a.avi"
    done = oppload("run", *paths, twice, "-o", tmp_path / "out", "-j", "1")
    assert done.returncode == 4, done.stderr
    # Also on systems where "A" and "a" are one name.
    assert done.stderr.count("its results would have the same names as those of") == 2
    assert len(list((tmp_path / "out").glob("*.frames.csv"))) == 1
    failures = (tmp_path / "out" / "failures.csv").read_text().splitlines()
    assert len(failures) == 3


@pytest.mark.long
def test_an_output_is_never_an_input(clip: Path, tmp_path: Path) -> None:
    tricky = tmp_path / "x.frames.csv"
    tricky.write_bytes(clip.read_bytes())
    part = tmp_path / "x.frames.csv.part"
    part.write_bytes(clip.read_bytes())
    done = oppload("run", tricky, part, "-o", tmp_path, "-j", "1")
    assert done.returncode == 0, done.stderr
    assert tricky.read_bytes() == part.read_bytes() == clip.read_bytes()
    other = tmp_path / "x.avi"
    other.write_bytes(clip.read_bytes())
    refused = oppload("run", other, "-o", tmp_path)
    assert refused.returncode == 2
    assert tricky.read_bytes() == part.read_bytes() == clip.read_bytes()


@pytest.mark.skipif(sys.platform == "win32", reason="links need a right there")
def test_a_link_in_the_place_of_a_result_is_not_followed(clip: Path, tmp_path: Path) -> None:
    target = tmp_path / "mine.txt"
    target.write_text("mine")
    out = tmp_path / "out"
    out.mkdir()
    (out / "clip.frames.csv").symlink_to(target)
    assert oppload("run", clip, "-o", out).returncode == 2
    done = oppload("run", clip, "-o", out, "--if-exists", "overwrite")
    assert done.returncode == 0, done.stderr
    assert target.read_text() == "mine"
    assert not (out / "clip.frames.csv").is_symlink()
