from __future__ import annotations

import base64
import json
import math
import shutil
from dataclasses import replace
from html.parser import HTMLParser
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any

import cv2
import numpy as np
import pytest

from oppload_cli.evaluation.metrics.intervals import Measurement
from oppload_cli.evaluation.output import FILES, _responses, _windows, printed_table
from oppload_cli.evaluation.page import MEASURES, NO_VALUE, number
from tests.cli import process
from tests.cli.inside import oppload
from tests.evaluation import make
from tests.evaluation.conftest import CONTACT, ONSET
from tests.results.make import rows_of

if TYPE_CHECKING:
    from pathlib import Path

    from tests.browser import Browser
DETECTORS = ["opplod_reference", "dlgmd", "frame_difference", "flow_divergence"]


class Page(HTMLParser):
    """Sources and links to other files of a page, and the cells of its table of figures."""

    def __init__(self) -> None:
        super().__init__()
        self.sources: list[str] = []
        self.values: dict[str, list[str]] = {}
        self._section = ""
        self._is_value = False

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        values = {name: value or "" for name, value in attrs}
        self.sources += [values[name] for name in ("src", "href") if name in values]
        self.sources = [source for source in self.sources if not source.startswith("#")]
        if tag == "section":
            self._section = values["id"]
        self._is_value = values.get("class") in {"value", "spread"}

    def handle_data(self, data: str) -> None:
        if self._is_value:
            self.values.setdefault(self._section, []).append(data)
        self._is_value = False


@pytest.fixture(scope="module")
def evaluated(labelled: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("evaluated")
    done = oppload(
        "evaluate", labelled / "manifest.csv", "-o", folder, "--model", "opplod_reference",
        "--draws", "100", "-j", "1",
    )  # fmt: skip
    assert done.returncode == 0
    assert done.stderr.startswith("approaches: 2, clips without one: 2, minutes without an ")
    assert "the rule of three, 95 %" in done.stderr
    assert sorted(done.stdout.split()) == sorted(str(folder / name) for name in FILES)
    assert sorted(path.name for path in folder.iterdir()) == sorted(FILES)
    return folder


def test_a_rate_that_is_not_determined_is_a_dash() -> None:
    """A threshold for one false alarm per minute need not exist: then no clip counts."""
    nan = math.nan
    measurements = [
        Measurement("dlgmd", "detection_rate", "alarm as shipped", 0.5, 0.1, 0.9, 4),
        Measurement("dlgmd", "detection_rate", "at 1 per minute", nan, nan, nan, 0),
        Measurement("dlgmd", "false_alarms_per_minute", "at 1 per minute", nan, nan, nan, 0),
    ]
    told: Any = SimpleNamespace(
        measurements=measurements,
        clips=(),
        detectors=[SimpleNamespace(name="dlgmd")],
        battery=None,
    )
    _, _, shipped, _, chosen, *_ = printed_table(told)
    assert shipped.split() == ["D-LGMD", "2", "of", "4", "(0.1", "to", "0.9)", NO_VALUE, NO_VALUE]
    assert chosen.split() == ["D-LGMD", NO_VALUE, NO_VALUE, NO_VALUE]


def figures_of(folder: Path) -> dict[tuple[str, str, str], dict[str, str]]:
    return {
        (row["contender"], row["measure"], row["condition"]): row
        for row in rows_of(folder / "evaluation.csv")
    }


@pytest.mark.long
def test_the_figures_of_looming_and_moving_disks(evaluated: Path) -> None:
    found = figures_of(evaluated)
    one, last = "at 1 per minute", "last second before contact"
    for measure, condition, value in (
        ("detection_rate", one, 1),
        ("detection_rate", "held out at 1 per minute", 1),
        ("false_alarms_per_minute", one, 0),
        ("roc_auc", last, 1),
        ("average_precision", last, 1),
        ("ordered_pairs", "0 frames before contact", 1),
        ("place_inside", "within 15 frames of contact", 1),
    ):
        assert float(found["opplod_reference", measure, condition]["value"]) == value
    assert 0.3 < float(found["opplod_reference", "lead_time_s", one]["value"]) < 1.5
    near = found["opplod_reference", "place_distance_px", "within 15 frames of contact"]
    assert float(near["value"]) < 8
    assert near["n"] == "8"  # frames 75, 80, 85 and 88 of two clips
    # One disk is in the middle, the other 26 px to the side of it and 14 px above.
    middle = found["frame_centre", "place_distance_px", "all boxed frames"]
    assert float(middle["value"]) == pytest.approx(np.hypot(26, 14) / 2, abs=1)
    assert float(found["frame_difference", "roc_auc", last]["value"]) < 1
    assert {detector for detector, _, _ in found} == {*DETECTORS, "frame_centre"}
    of_truth = {"alarmed_share", "box_overlap", "contact_within", "contact_error"}
    assert {measure for _, measure, _ in found} == set(MEASURES) - of_truth
    for name in DETECTORS:
        assert (name, "detection_rate", "alarm as shipped") in found
    assert ("frame_difference", "place_inside", "all boxed frames") not in found


@pytest.mark.long
def test_responses_and_windows_give_the_figures_again(evaluated: Path) -> None:
    found = figures_of(evaluated)
    responses = rows_of(evaluated / "responses.csv")
    assert len(responses) == (90 + 90 + 60 + 36) * len(DETECTORS)
    own = [
        row
        for row in responses
        if (row["clip"], row["contender"]) == ("centre.avi", "opplod_reference")
    ]
    threshold = float(found["opplod_reference", "threshold", "at 1 per minute"]["value"])
    first = next(
        int(row["frame"])
        for row in own
        if int(row["frame"]) >= ONSET and float(row["evidence"] or 0) > threshold
    )
    report: dict[str, Any] = json.loads((evaluated / "report.json").read_text())
    outcome = report["clips"][0]["outcomes"]["opplod_reference"]["at 1 per minute"]
    assert outcome["lead_s"] == pytest.approx((CONTACT - first) / 30)
    windows = [
        row for row in rows_of(evaluated / "windows.csv") if row["contender"] == "frame_difference"
    ]
    above = [
        float(w["score"])
        for w in windows
        if w["frames_before_contact"] == "0" and w["use"] == "approach"
    ]
    below = [float(w["score"]) for w in windows if w["use"] == "without approach"]
    pairs = np.array([[(a > b) + 0.5 * (a == b) for b in below] for a in above])
    area = found["frame_difference", "roc_auc", "last second before contact"]
    assert float(area["value"]) == pytest.approx(pairs.mean())
    assert int(area["n"]) == len(above) + len(below)


def test_tables_and_report_agree_on_every_window_and_frame(evaluated: Path) -> None:
    """Each window has the largest response of its frames, and lies where its use says."""
    report = json.loads((evaluated / "report.json").read_text())
    assert report["manifest"]["looming"] == report["manifest"]["none"] == 2
    assert report["settings"]["silence_s"] == report["settings"]["window_s"] == 1
    responses: dict[tuple[str, str], list[str]] = {}
    for row in rows_of(evaluated / "responses.csv"):
        responses.setdefault((row["clip"], row["contender"]), []).append(row["response"])
        assert (row["alarm"] == "") is (row["response"] == "")
        if row["response"] == "":
            assert not any(row[name] for name in ("x", "y", "width", "height", "evidence"))
    firsts = {clip["file"]: clip["first_frame"] for clip in report["clips"]}
    assert set(firsts.values()) == {3}
    for clip in report["clips"]:
        outcomes = [one for by_rule in clip["outcomes"].values() for one in by_rule.values()]
        detected = {type(one["detected"]) for one in outcomes}
        assert detected == ({bool} if clip["label"] == "looming" else {type(None)})
    uses = set()
    for window in rows_of(evaluated / "windows.csv"):
        first, last = int(window["first_frame"]), int(window["last_frame"])
        own = responses[window["clip"], window["contender"]][first : last + 1]
        assert float(window["score"]) == max(map(float, own))
        assert firsts[window["clip"]] <= first
        assert 15 <= last + 1 - first <= 30  # half a second to a second
        uses.add(window["use"])
        if window["use"] == "approach":
            assert last == CONTACT - int(window["frames_before_contact"])
        else:
            assert last < CONTACT - 29
    assert uses == {"approach", "earlier", "without approach"}


def test_windows_have_responses_where_the_evidence_is_another() -> None:
    """Near a contact, evidence is a multiple of the response: it decides alarms, not scores."""
    response = make.peaks(60, {20: 2.0, 38: 0.3, 39: 0.5})
    made = make.clip(response, onset=30, contact=39)
    (name, output), nan = next(iter(made.outputs.items())), math.nan
    evidence = np.where(np.arange(60) >= 35, 10, 1) * output.response
    evaluation: Any = SimpleNamespace(
        clips=[replace(made, outputs={name: replace(output, evidence=evidence)})]
    )
    rows = list(_responses(evaluation))
    np.testing.assert_array_equal([row["response"] for row in rows], [nan] * 3 + response[3:])
    np.testing.assert_array_equal([row["evidence"] for row in rows], evidence)
    assert (rows[39]["response"], rows[39]["evidence"]) == (0.5, 5.0)
    scores = {
        (row["use"], row["last_frame"]): row["score"]
        for row in _windows(evaluation)
        if row["frames_before_contact"] == 0
    }
    assert scores["approach", 39] == 0.5
    assert scores["earlier", 29] == 2.0


def test_the_page_holds_every_figure_and_needs_no_other_file(evaluated: Path) -> None:
    page, text = Page(), (evaluated / "evaluation.html").read_text(encoding="utf-8")
    page.feed(text)
    assert "with 5.8 s of footage without an approach" in text
    assert all(source.startswith("data:image/") for source in page.sources)
    shown = page.values["figures"]
    rows = rows_of(evaluated / "evaluation.csv")
    assert len(shown) == 2 * len(rows)
    for row in rows:
        value, low, high = (float(row[key] or "nan") for key in ("value", "low", "high"))
        assert number(value) in shown
        assert any(
            text == f"{number(low)} to {number(high)}, n {row['n']}"
            or text in {f"no interval, n {row['n']}", f"n {row['n']}"}
            for text in shown
        )
    embedded = [base64.b64decode(source.partition(",")[2]) for source in page.sources]
    plots = [name for name in FILES if name.endswith(".png")]
    for name in plots:
        assert (evaluated / name).read_bytes() in embedded
    # No approach is missed: the stills show the two other clips, and footage before onset.
    assert 1 <= len(embedded) - len(plots) <= 4
    for data in embedded:
        picture = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_GRAYSCALE)
        assert picture is not None
        assert picture.std() > 1


@pytest.mark.long
def test_a_browser_shows_every_picture(evaluated: Path, browser: Browser) -> None:
    page = evaluated / "evaluation.html"
    browser.open(page)
    assert browser.pictures() == page.read_text().count("<img ")


CUT = """return [...document.querySelectorAll('.wide')].filter(
    e => e.scrollWidth > e.clientWidth && getComputedStyle(e).overflowX !== 'visible').length"""


@pytest.mark.long
def test_no_table_is_cut_on_paper(evaluated: Path, browser: Browser) -> None:
    """On a phone, a table scrolls; paper cannot scroll."""
    for media, cut in (("screen", True), ("print", False)):
        browser.open(evaluated / "evaluation.html", wide=380, media=media)
        assert (browser.run(CUT) > 0) == cut, media


@pytest.mark.slow
def test_the_same_clips_give_the_same_bytes(
    evaluated: Path, labelled: Path, tmp_path: Path
) -> None:
    done = process.oppload(
        "evaluate", labelled / "manifest.csv", "-o", tmp_path, "--model", "opplod_reference",
        "--draws", "100", "-j", "2", "-q",
    )  # fmt: skip
    assert done.returncode == 0
    for name in FILES:
        if name != "report.json":
            assert (tmp_path / name).read_bytes() == (evaluated / name).read_bytes(), name
    reports = [json.loads((folder / "report.json").read_text()) for folder in (tmp_path, evaluated)]
    for report in reports:
        assert report.pop("timing")["wall_s"] > 0
    assert reports[0] == reports[1]


@pytest.mark.long
@pytest.mark.usefixtures("undrawn")
def test_faults_are_reported_and_the_rest_runs(labelled: Path, tmp_path: Path) -> None:
    for name in ("centre.avi", "moving.avi"):
        shutil.copy(labelled / name, tmp_path / name)
    (tmp_path / "text.avi").write_text("no video")
    manifest = tmp_path / "clips.csv"
    manifest.write_text(
        "file,label,onset_frame,contact_frame,wheather\n"
        "centre.avi,looming,45,89,\n"
        "moving.avi,none,,,\n"
        "moving.avi,none,,,\n"
        "gone.avi,none,,,\n"
        "text.avi,none,,,\n"
    )
    done = oppload(
        "evaluate", manifest, "-o", tmp_path / "out", "--model", "opplod_reference",
        "--draws", "100", "-j", "1",
    )  # fmt: skip
    assert done.returncode == 4
    lines = [line for line in done.stderr.splitlines() if line.startswith("oppload: ")]
    note, *lines = lines
    assert note.endswith("clips.csv: these columns are not known and are ignored: 'wheather'")
    assert [line.split(": ")[2] for line in lines] == ["row 4", "row 5", "row 6"]
    report = json.loads((tmp_path / "out" / "report.json").read_text())
    assert [clip["row"] for clip in report["clips"]] == [2, 3]
    assert [f"oppload: {fault}" for fault in report["faults"]] == lines
    page = (tmp_path / "out" / "evaluation.html").read_text()
    assert "gone.avi: there is no such file" in page


def test_wrong_use(evaluated: Path, labelled: Path, tmp_path: Path) -> None:
    manifest = labelled / "manifest.csv"
    for code, reason, arguments in (
        (2, "cannot be read", (tmp_path / "no.csv",)),
        (2, "did you mean 'opplod_reference'", (manifest, "--model", "opplod_refrence")),
        (2, "did you mean 'opplod'?", (manifest, "--model", "opplood")),
        (2, "write --model opplod_paper", (manifest, "--model", "opplod:paper")),
        (2, "check --boxes", (manifest, "--boxes", tmp_path / "no.json")),
    ):
        done = oppload("evaluate", *arguments)
        assert (done.returncode, reason in done.stderr) == (code, True), done.stderr
    again = oppload("evaluate", manifest, "-o", evaluated)
    assert (again.returncode, "exists already" in again.stderr) == (2, True)
    empty = tmp_path / "empty.csv"
    empty.write_text("file,label,onset_frame,contact_frame\nno.avi,none,,\n")
    one_process = "-o", tmp_path / "out", "-j", "1"
    done = oppload("evaluate", empty, *one_process)
    assert (done.returncode, "names no clip that can be used" in done.stderr) == (3, True)
    empty.write_text("file,label,onset_frame,contact_frame\n")
    done = oppload("evaluate", empty, "-o", tmp_path / "out")
    assert done.stderr.endswith("names no clip that can be used; add a row for each clip\n")
    for name in ("a.avi", "b.avi"):
        (tmp_path / name).write_text("no video")
    empty.write_text("file,label,onset_frame,contact_frame\na.avi,none,,\nb.avi,none,,\n")
    said = oppload("evaluate", empty, *one_process).stderr
    for row, name in ((2, "a.avi"), (3, "b.avi")):
        assert f"; row {row}: {tmp_path / name}: not a video" in said
    assert not list((tmp_path / "out").glob("*"))
