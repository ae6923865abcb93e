"""Tables are read as they are in R (``readr``) and MATLAB (``readtable``), by their rules."""

from __future__ import annotations

import csv
import re
import shutil
import subprocess
from typing import TYPE_CHECKING

import pytest

from oppload_cli import stimulus
from tests.cli.inside import oppload

if TYPE_CHECKING:
    from pathlib import Path

# readr's col_double and readtable's double; scientific notation is read by both.
NUMBER = re.compile(r"-?\d+(\.\d+)?(e[+-]\d+)?")
# MATLAB's isvarname, and R's make.names without its leading dots: such names are kept as they are.
NAME = re.compile(r"[A-Za-z]\w{0,62}")
WORDS = {"for", "if", "end", "function", "break", "next", "while", "case", "NA", "TRUE", "Inf"}
TEXTS = {"video", "model", "input", "stem", "error"}


@pytest.fixture(scope="module")
def results(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Results of two videos; one has a comma, a quote and an umlaut in its name."""
    folder: Path = tmp_path_factory.mktemp("readers")
    for name, shown in (
        ("a", "controls/looming-perspective"),
        ('b, "ü"', "controls/receding-patch"),
    ):
        protocol = stimulus.load(shown, {"display.width": 120, "display.height": 96})
        stimulus.write(protocol, folder).video.rename(folder / f"{name}.avi")
    words = ("--height", "96", "--fov", "90", "-j", "1")
    done = oppload("run", str(folder), "-o", str(folder), *words)
    assert done.returncode == 0, done.stderr
    return folder


def rows(path: Path) -> list[list[str]]:
    """The cells of a table; the file is UTF-8 without a mark, lines end in LF, none is empty."""
    content = path.read_bytes()
    assert not content.startswith(b"\xef\xbb\xbf")
    assert b"\r" not in content
    assert content.endswith(b"\n")
    return list(csv.reader(content.decode("utf-8").splitlines(), strict=True))


def check(path: Path) -> int:
    """Check header and cells; return how many cells are empty."""
    header, *body = rows(path)
    assert len(set(header)) == len(header)
    assert [name for name in header if not NAME.fullmatch(name) or name in WORDS] == []
    assert body
    empty = 0
    for row in body:
        assert len(row) == len(header)
        for name, cell in zip(header, row, strict=True):
            assert name in TEXTS or cell == "" or NUMBER.fullmatch(cell), f"{name}: {cell}"
            empty += cell == ""
    return empty


def test_frames_and_alarms_keep_the_rules(results: Path) -> None:
    tables = sorted(results.glob("*.frames.csv"))
    assert len(tables) == 2
    assert all(check(table) > 30 for table in tables)  # warm-up, and boxes where nothing looms
    assert 0 <= check(results / "alarms.csv") < 20


def test_a_long_number_and_a_second_header_are_found(tmp_path: Path) -> None:
    for wrong in ("a,a\n1,2\n", "a,b\n1,nan\n", "a,b\n1,1 000\n", "a b\n1\n", "a\n"):
        path = tmp_path / "wrong.csv"
        path.write_text(wrong)
        with pytest.raises(AssertionError):
            check(path)


def test_r_reads_them(results: Path) -> None:
    if shutil.which("Rscript") is None:
        pytest.skip("NOT TESTED: R is missing; apt-get install r-base-core")
    code = """
    frames <- read.csv("a.frames.csv")
    stopifnot(all(sapply(frames, is.numeric)), is.na(frames$opplod_response[1]))
    alarms <- read.csv("alarms.csv", encoding = "UTF-8")
    stopifnot(is.character(alarms$video), is.numeric(alarms$start_s))
    if (requireNamespace("readr", quietly = TRUE)) {
        other <- readr::read_csv("a.frames.csv", col_types = readr::cols(.default = "d"))
        stopifnot(nrow(readr::problems(other)) == 0, all.equal(frames, as.data.frame(other),
                  check.attributes = FALSE))
    }
    cat(nrow(frames), min(frames$time_s[frames$opplod_alarm == 1]), names(frames)[4])
    """
    done = subprocess.run(
        ["Rscript", "-e", code], cwd=results, capture_output=True, text=True, check=False
    )
    header, *body = rows(results / "a.frames.csv")
    on = header.index("opplod_alarm")
    first = min(float(row[1]) for row in body if row[on] == "1")
    assert done.stdout.split() == [str(len(body)), f"{first:.7g}", "opplod_response"], done.stderr
