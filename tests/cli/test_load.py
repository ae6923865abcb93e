"""Detectors of the user's own, by ``--load``."""

from __future__ import annotations

import csv
import hashlib
import json
import pickle
import sys
from itertools import pairwise
from typing import TYPE_CHECKING

import pytest

from oppload_cli.errors import ParameterError
from oppload_cli.models import LOAD, registry
from tests.cli import inside
from tests.cli.process import ENTRY, oppload, python
from tests.media import grey_frames, write_video

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

DETECTOR = """
from typing import ClassVar

import numpy as np

import oppload_cli as oppload


@oppload.register
class Darkening(oppload.Detector):
    name, label, colour = "darkening", "Darkening", "#33AA00"
    meaning = "share of pixels that darkened"
    alarm: ClassVar = oppload.AlarmRule(0.1)
    before = None

    def reset(self):
        self.before = None

    def step(self, luma):
        before, self.before = self.before, luma.copy()
        return None if before is None else oppload.Response(np.mean(before > luma))
"""


@pytest.fixture
def own(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """The file of a user's detector, to be loaded into this process until the test ends."""
    monkeypatch.setattr(registry, "_loaded", {})
    path = tmp_path / "own.py"
    path.write_text(DETECTOR)
    yield path
    registry.forget("darkening")
    sys.modules.pop("loaded_own", None)


@pytest.mark.long
@pytest.mark.usefixtures("undrawn")
def test_a_loaded_detector_runs_also_in_other_processes(own: Path, tmp_path: Path) -> None:
    frames = grey_frames(9)
    for name in ("a.avi", "b.avi"):
        write_video(tmp_path / name, frames)
    words = ("run", "a.avi", "b.avi", "none.avi", "-j", "2", "-o", "out", "--model", "darkening")
    # No process may take a script of the user for a module of Python.
    (tmp_path / "signal.py").write_text("raise SystemExit('a script was run')")
    entry = f"import sys; del sys.path[0]; {ENTRY}"  # the installed script has no such path
    more = ("--no-rmo", "--height", "native")
    done = python(entry, "--load", "own.py", *words, *more, cwd=tmp_path)
    assert done.returncode == 4, done.stderr
    shares = [float((before.astype(int) > now).mean()) for before, now in pairwise(frames)]
    for stem in ("a", "b"):
        table = (tmp_path / "out" / f"{stem}.frames.csv").read_text().splitlines()
        found = [float(row["darkening_response"]) for row in csv.DictReader(table[0:1] + table[2:])]
        assert [round(each, 6) for each in found] == [round(each, 6) for each in shares]
        sidecar = json.loads((tmp_path / "out" / f"{stem}.oppload.json").read_text())
        checksum = hashlib.sha256(own.read_bytes()).hexdigest()
        assert sidecar["loaded"] == [{"name": str(own), "sha256": checksum}]
    result = tmp_path / "out" / "a.frames.csv"
    refused = inside.oppload("plot", result)
    assert refused.returncode == 2
    assert "its detector 'darkening' is not known here; load it, as in" in refused.stderr
    registry.load(str(own))
    assert inside.oppload("plot", result).returncode == 0


def test_a_result_of_a_changed_detector_is_not_kept(own: Path, tmp_path: Path) -> None:
    write_video(tmp_path / "a.avi", grey_frames(9))
    words = ["run", "a.avi", "--no-rmo", "--height", "native", "--if-exists", "skip", "--model"]
    registry.load(str(own))
    assert inside.oppload(*words, "darkening", cwd=tmp_path).returncode == 0
    assert "skipped" in inside.oppload(*words, "darkening", cwd=tmp_path).stderr
    assert inside.oppload(*words, "dlgmd", "-o", "other", cwd=tmp_path).returncode == 0
    own.write_text(DETECTOR.replace("before > luma", "before < luma"))
    registry.load(str(own))
    refused = inside.oppload(*words, "darkening", cwd=tmp_path)
    assert refused.returncode == 2
    assert "is a result with other settings" in refused.stderr
    # Detectors of oppload stay the same.
    assert "skipped" in inside.oppload(*words, "dlgmd", "-o", "other", cwd=tmp_path).stderr


def test_a_detector_without_a_floor_is_told_once(own: Path, tmp_path: Path) -> None:
    own.write_text(DETECTOR.replace("    alarm: ClassVar = oppload.AlarmRule(0.1)\n", ""))
    registry.load(str(own))
    for name in ("a.avi", "b.avi"):
        write_video(tmp_path / name, grey_frames(9))
    words = ["run", "a.avi", "b.avi", "-o", "out", "--model", "darkening,dlgmd", "--no-rmo"]
    words += ["--if-exists", "overwrite", "--height", "native", "-j", "1"]
    done = inside.oppload(*words, cwd=tmp_path)
    said = "oppload: darkening has no floor: any response above 0 may cause an alarm; set its "
    assert (done.returncode, done.stderr.count(said), done.stderr.count("no floor")) == (0, 1, 1)
    for more in (("--set", "alarm.darkening_floor=0.1"), ("--set", "alarm.on=false")):
        assert "no floor" not in inside.oppload(*words, *more, cwd=tmp_path).stderr


def test_a_file_that_cannot_be_loaded_is_named(
    own: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "broken.py").write_text("x = (")
    (tmp_path / "leaves.py").write_text("raise SystemExit(0)")
    (tmp_path / "idle.py").write_text(DETECTOR.replace("@oppload.register\n", ""))
    monkeypatch.setenv(LOAD, "")  # which the command sets
    for how, name, fault in (
        (oppload, "broken.py", "broken.py: cannot be imported (SyntaxError: '(' was never closed"),
        (inside.oppload, "none.py", "--load none.py: no such file; check the name"),
        (inside.oppload, "idle.py", "--load idle.py: registers no detector; write @oppload.regis"),
    ):
        done = how("--load", name, "models", cwd=tmp_path)
        assert (done.returncode, fault in done.stderr) == (2, True), done.stderr
        assert done.stderr.count("\n") == 1
    own.write_text(DETECTOR.replace('"darkening"', '"dlgmd"'))
    for name, fault in (
        ("a/b.txt", r"--load a/b.txt: is neither a file that ends in .py nor the name of a mod"),
        (".", r"--load .: is neither a file that ends in .py nor the name of a module"),
        (str(tmp_path / "leaves.py"), r"leaves.py: cannot be imported \(SystemExit: 0\)"),
        ("no_such_module", r"no_such_module: cannot be imported \(ModuleNotFoundError: "),
        (str(own), r"detector 'dlgmd' \(loaded_own\.Darkening\): its name is taken"),
    ):
        with pytest.raises(ParameterError, match=fault):
            registry.load(name)


def test_a_detector_without_parameters_is_described(own: Path) -> None:
    registry.load(str(own))
    done = inside.oppload("models", "darkening")
    assert (done.returncode, done.stderr) == (0, "")
    assert done.stdout.startswith("darkening  (share of pixels that darkened)\n")


def test_files_of_any_name_have_modules_of_their_own(own: Path, tmp_path: Path) -> None:
    """Other processes find the classes in them, also if two files have one name or a dot."""
    names = ["darkening", *(f"own_{letter}" for letter in "abc")]
    files = [own, *(tmp_path / name / "own.py" for name in "ab"), tmp_path / "own.v2.py"]
    modules = dict(zip(names, registry.modules_of(map(str, files)).values(), strict=True))
    try:
        for name, file in zip(names, files, strict=True):
            file.parent.mkdir(exist_ok=True)
            file.write_text(DETECTOR.replace('"darkening"', f'"{name}"'))
            registry.load(str(file))
        for name, module in modules.items():
            detector = registry.detector_named(name)
            assert detector.__module__ == module
            sent = pickle.loads(pickle.dumps(detector.parameters()))  # noqa: S301
            assert type(sent) is detector.parameters
    finally:
        for name, module in modules.items():
            registry.forget(name)
            sys.modules.pop(module, None)


@pytest.mark.skipif(sys.platform == "win32", reason="no name has a colon there")
def test_a_path_that_separates_names_is_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder = tmp_path / "a:b"
    folder.mkdir()
    (folder / "own.py").write_text(DETECTOR)
    monkeypatch.chdir(folder)
    done = inside.oppload("--load", "own.py", "models")
    assert done.returncode == 2
    assert "--load own.py: its path holds ':', which separates the names" in done.stderr


def test_a_step_that_fails_names_the_detector_and_leaves_no_file(own: Path, tmp_path: Path) -> None:
    own.write_text(DETECTOR.replace("np.mean(before > luma)", "[][0]"))
    registry.load(str(own))
    write_video(tmp_path / "a.avi", grey_frames(9))
    words = ("run", "a.avi", "-o", "out", "--model", "darkening", "--no-rmo")
    done = inside.oppload(*words, cwd=tmp_path)
    assert done.returncode == 2
    line = 1 + DETECTOR.splitlines().index(DETECTOR.splitlines()[-1])
    assert "detector 'darkening': its step failed (IndexError: list index" in done.stderr
    assert f"own.py, line {line}); correct the detector" in done.stderr
    assert not (tmp_path / "out").exists()
    both = inside.oppload(words[0], "none.avi", *words[1:], "-j", "1", cwd=tmp_path)
    assert "oppload: a.avi: detector 'darkening': its step failed" in both.stderr


@pytest.mark.long
def test_a_detector_that_another_file_registers_is_enough(tmp_path: Path) -> None:
    """A file of --load may only import the modules that register detectors."""
    (tmp_path / "study.py").write_text(DETECTOR)
    (tmp_path / "all.py").write_text("import study")
    done = oppload("--load", "all.py", "models", cwd=tmp_path, PYTHONPATH=str(tmp_path))
    assert done.returncode == 0, done.stderr
    assert "darkening" in done.stdout


@pytest.mark.long
@pytest.mark.usefixtures("undrawn")
def test_the_tuning_of_a_detector_that_is_not_loaded_is_told(
    own: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    registry.load(str(own))
    words = ("tune", "bar-expand-60", "--over", "axis=0,90", "--model", "darkening", "--height",
             "60", "-j", "1", "--plot", "none")  # fmt: skip
    done = inside.oppload(*words)
    assert done.returncode == 0, done.stderr
    table = next(tmp_path.glob("*.tuning.csv"))
    registry.forget("darkening")
    refused = inside.oppload("plot", table.name)
    assert refused.returncode == 2
    assert refused.stderr == (
        f"oppload: {table.name}: its detector 'darkening' is not known here; load it, as in "
        "'oppload --load FILE.py ...', or register its class\n"
    )
    for command in (("plot", table.name), ("tune", "bar-expand-60"), ("run", "a.avi")):
        unknown = inside.oppload(*command, "--model", "darkening")
        assert unknown.returncode == 2
        assert "no model 'darkening'; choose " in unknown.stderr
        assert f"'oppload --load FILE.py {command[0]} ...'" in unknown.stderr
    registry.load(str(own))
    assert inside.oppload("plot", table.name).returncode == 0
