"""The examples of ``docs/scale.md`` and ``docs/howto/cluster.md`` do what the pages say."""

from __future__ import annotations

import importlib.util
import os
import re
import shutil
import socket
import subprocess
import sys
from pathlib import Path

import pytest

from tests.cli.inside import oppload
from tests.cli.test_batch import tables
from tests.media import grey_frames, write_video

ROOT = Path(__file__).parents[2]
PAGES = "\n".join(
    (ROOT / "docs" / name).read_text(encoding="utf-8") for name in ("scale.md", "howto/cluster.md")
)
BLOCKS = re.findall(r"^```(\w+)\n(.*?)^```$", PAGES, re.MULTILINE | re.DOTALL)

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="shell scripts")


def example(language: str, word: str) -> str:
    """The only code block of a language that contains a word."""
    (block,) = [text for kind, text in BLOCKS if kind == language and word in text]
    return str(block)


@pytest.fixture
def project(tmp_path: Path) -> Path:
    """A folder with videos, and a script that runs the tested oppload."""
    for number in range(5):
        (tmp_path / "videos").mkdir(exist_ok=True)
        write_video(tmp_path / "videos" / f"clip{number}.avi", grey_frames(6, seed=number))
    (tmp_path / "bin").mkdir()
    command = tmp_path / "bin" / "oppload"
    command.write_text(f'#!/bin/sh\nexec "{sys.executable}" -m oppload_cli "$@"\n')
    command.chmod(0o755)
    (tmp_path / "inputs.txt").write_text("".join(f"videos/clip{n}.avi\n" for n in range(5)))
    done = oppload("run", "videos", "-o", "expected", "-q", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    return tmp_path


def run(project: Path, *words: str, **more: str) -> None:
    own = os.pathsep.join([str(project / "bin"), str(Path(sys.executable).parent)])
    path = os.pathsep.join([own, os.environ["PATH"]])
    done = subprocess.run(
        words,
        cwd=project,
        env={**os.environ, "PATH": path, "PYTHONPATH": str(ROOT), **more},
        capture_output=True,
        text=True,
        check=False,
        timeout=120,
    )
    assert done.returncode == 0, done.stderr


def check(project: Path) -> None:
    assert len(tables(project / "results")) == 5
    assert tables(project / "results") == tables(project / "expected")
    assert not list((project / "results").glob("*.part"))


@pytest.mark.slow
def test_the_shards_by_plain_shell(project: Path) -> None:
    run(project, "sh", "-ec", example("sh", "--shard"))
    check(project)


@pytest.mark.slow
def test_the_array_script(project: Path) -> None:
    (project / "array.sh").write_text(example("bash", "SBATCH"))
    for number in ("2", "1"):
        variables = {"SLURM_ARRAY_TASK_ID": number, "SLURM_ARRAY_TASK_COUNT": "2"}
        run(project, "bash", "-e", "array.sh", **variables, SLURM_CPUS_PER_TASK="1")
    check(project)


@pytest.mark.slow
def test_the_dask_example(project: Path) -> None:
    if importlib.util.find_spec("distributed") is None:
        pytest.skip("NOT TESTED: dask.distributed is missing; pip install 'oppload[distributed]'")
    with socket.create_server(("127.0.0.1", 0)) as free:
        port = str(free.getsockname()[1])
    run(project, "bash", "-ec", example("sh", "dask scheduler").replace("8786", port))
    check(project)


@pytest.mark.slow
def test_the_snakemake_rule(project: Path) -> None:
    snakemake = os.environ.get("SNAKEMAKE") or shutil.which("snakemake")
    if not snakemake:
        pytest.skip("NOT TESTED: snakemake is missing; pip install snakemake")
    (project / "Snakefile").write_text(example("python", "rule all"))
    for folder, name in (("videos", "clip4.avi"), ("expected", "clip4.frames.csv")):
        (project / folder / "cam 1").mkdir()
        (project / folder / name).rename(project / folder / "cam 1" / name)
    run(project, snakemake, "--cores", "2", "--quiet", "all")
    for folder, count in ((".", 4), ("cam 1", 1)):
        made = tables(project / "results" / folder)
        assert len(made) == count
        assert made == tables(project / "expected" / folder)
