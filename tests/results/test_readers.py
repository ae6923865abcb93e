"""Tables are read as they are in R (``readr``), MATLAB (``readtable``) and Octave."""

from __future__ import annotations

import csv
import json
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pandas as pd
import pytest

import oppload_cli
from oppload_cli import stimulus
from tests.cli.inside import oppload

# readr's col_double and readtable's double; scientific notation is read by both.
NUMBER = re.compile(r"-?\d+(\.\d+)?(e[+-]\d+)?")
# MATLAB's isvarname, and R's make.names without its leading dots: such names are kept as they are.
NAME = re.compile(r"[A-Za-z]\w{0,62}")
WORDS = {"for", "if", "end", "function", "break", "next", "while", "case", "NA", "TRUE", "Inf"}
TEXTS = {"result", "video", "model", "input", "stem", "error", "blind"}


@pytest.fixture(scope="module")
def results(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Results of two videos; one has a comma, a quote and an umlaut in its name."""
    folder: Path = tmp_path_factory.mktemp("readers")
    for name, shown in (
        ("a", "controls/looming-perspective"),
        ("b, ü" if sys.platform == "win32" else 'b, "ü"', "controls/receding-patch"),
    ):
        protocol = stimulus.load(shown, {"display.width": 120, "display.height": 96})
        stimulus.write(protocol, folder).video.rename(folder / f"{name}.avi")
    words = ("--height", "96", "--fov", "90", "--columns", "all", "-j", "1")
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


@pytest.mark.long
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


def first_alarm(results: Path) -> float:
    header, *body = rows(results / "a.frames.csv")
    on = header.index("opplod_alarm")
    return min(float(row[1]) for row in body if row[on] == "1")


@pytest.mark.long
def test_r_reads_them(results: Path) -> None:
    if shutil.which("Rscript") is None:
        pytest.skip("NOT TESTED: R is missing; apt-get install r-base-core")
    code = """
    frames <- read.csv("a.frames.csv")
    stopifnot(is.character(frames$blind))
    frames$blind <- NULL
    stopifnot(all(sapply(frames, is.numeric)), is.na(frames$opplod_response[1]))
    alarms <- read.csv("alarms.csv", encoding = "UTF-8")
    stopifnot(is.character(alarms$video), is.numeric(alarms$start_s))
    if (requireNamespace("readr", quietly = TRUE)) {
        types <- readr::cols(.default = "d", blind = "c")
        other <- readr::read_csv("a.frames.csv", col_types = types)
        stopifnot(nrow(readr::problems(other)) == 0)
        other$blind <- NULL
        stopifnot(all.equal(frames, as.data.frame(other), check.attributes = FALSE))
    }
    cat(nrow(frames), min(frames$time_s[frames$opplod_alarm == 1]), names(frames)[4])
    """
    done = subprocess.run(
        ["Rscript", "-e", code], cwd=results, capture_output=True, text=True, check=False
    )
    count, first = len(rows(results / "a.frames.csv")) - 1, first_alarm(results)
    assert done.stdout.split() == [str(count), f"{first:.7g}", "opplod_response"], done.stderr


def test_octave_reads_them(results: Path) -> None:
    if shutil.which("octave-cli") is None:
        pytest.skip("NOT TESTED: Octave is missing; apt-get install octave")
    page = (Path(__file__).parents[2] / "docs" / "howto" / "matlab.md").read_text(encoding="utf-8")
    code = page.split("```octave\n")[1].split("```")[0].replace('"video.', '"a.')
    code += """
    assert(isequaln(column("opplod_response")(1), NA))
    printf("%d ", numel(detections), detections{1}.frame, settings.summary.opplod.frames)
    """
    done = subprocess.run(
        ["octave-cli", "--eval", code], cwd=results, capture_output=True, text=True, check=False
    )
    lines = (results / "a.detections.jsonl").read_text().splitlines()
    summary = json.loads((results / "a.oppload.json").read_text())["summary"]["opplod"]
    numbers = f"{len(lines)} {json.loads(lines[0])['frame']} {summary['frames']}"
    expected = f"first alarm at {first_alarm(results):.2f} s\n{numbers} "
    assert done.stdout == expected, done.stderr


def written_back(table: Path, by: str) -> Path:
    """Write a table as R's write.csv, MATLAB's writetable or pandas do."""
    with table.open(newline="") as file:
        header, *rows = list(csv.reader(file))
    empty = {"R": "NA", "MATLAB": "NaN", "pandas": ""}[by]
    texts = {index for index, name in enumerate(header) if name in TEXTS}
    filled = [
        [value or ("" if by == "MATLAB" and at in texts else empty) for at, value in enumerate(row)]
        for row in rows
    ]
    if by != "MATLAB":  # both write the numbers of rows first, under no name
        header = ["", *header]
        filled = [[str(number), *row] for number, row in enumerate(filled, by == "R")]
    place = table.parent / by / table.name
    place.parent.mkdir(exist_ok=True)
    with place.open("w", newline="") as file:
        file.write(",".join(f'"{name}"' for name in header) + "\n")  # as R does
        csv.writer(file, lineterminator="\n").writerows(filled)
    shutil.copy(table.with_name(table.name.replace(".frames.csv", ".oppload.json")), place.parent)
    return place


@pytest.mark.parametrize("by", ["R", "MATLAB", "pandas"])
def test_tables_that_other_programs_write_back_are_read(by: str, results: Path) -> None:
    place = written_back(results / "a.frames.csv", by)
    given, found = (
        oppload_cli.read_result(path).frames for path in (results / "a.frames.csv", place)
    )
    for name in given.columns:
        pd.testing.assert_series_equal(given[name], found[name], check_dtype=False)
    figure = place.with_suffix(".png")
    assert oppload("plot", place, "-o", figure).returncode == 0
    assert figure.exists()
    assert oppload("report", place, "-o", place.parent).returncode == 0
    collected = oppload("collect", place.parent, "-o", place.parent / "all.csv", "--frames")
    assert collected.returncode == 0, collected.stderr
