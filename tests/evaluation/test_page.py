from __future__ import annotations

import json
import re
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pytest

from oppload_cli import OpplodReferenceParams
from oppload_cli.detection.alarm import alarm_params
from oppload_cli.evaluation.detectors import EvaluatedDetector
from oppload_cli.evaluation.engine import Evaluation
from oppload_cli.evaluation.manifest import STIMULI, ClipEntry, Manifest
from oppload_cli.evaluation.metrics.intervals import draws_of
from oppload_cli.evaluation.metrics.measures import measured
from oppload_cli.evaluation.output import FILES, printed_table, report_of, write_evaluation
from oppload_cli.evaluation.page import number, page_of
from oppload_cli.evaluation.plots import PLOTS
from oppload_cli.files.atomic import claimed
from tests.evaluation.make import NAME, clip, peaks

if TYPE_CHECKING:
    from oppload_cli.evaluation.metrics.clips import Clip

OPPLOD = "opplod_reference"
WIDTH, HEIGHT = 300, 56  # of the strips


def renamed(made: Clip, name: str) -> Clip:
    return replace(made, label=replace(made.label, name=name), outputs={OPPLOD: made.outputs[NAME]})


FIELDS = np.full((100, 4), np.nan)
FIELDS[84] = 50, 60, 100, 80
BOXES = {84: (1.0, 2.0, 3.0, 4.0)}
CLIPS = [
    renamed(clip(peaks(100, {85: 9.0}), 80, 90), "found.avi"),
    renamed(
        clip(peaks(100, {84: 1.0}), 80, 90, boxes=BOXES, winner=FIELDS.tolist()),
        "<missed>.avi",
    ),
    renamed(clip(peaks(603, {100: 5.0, 130: 3.0, 160: 2.0}), motion="still"), "false.avi"),
    renamed(clip(peaks(603, {200: 1.0})), "quiet.avi"),
    renamed(clip([0.0] * 603), "silent.avi"),
]  # fmt: skip


@pytest.fixture(scope="module")
def evaluation() -> Evaluation:
    found = measured(CLIPS, OPPLOD, draws_of([clip.label.looming for clip in CLIPS], 100))
    entries = [ClipEntry(at, Path(clip.label.name), clip.label) for at, clip in enumerate(CLIPS, 2)]
    manifest = Manifest(Path("clips.csv"), entries, ["row 9: <gone>"], 6)
    detector = EvaluatedDetector(
        OPPLOD, "made by hand", 240, OpplodReferenceParams(), alarm_params()
    )
    return Evaluation(
        manifest,
        [detector],
        entries,
        CLIPS,
        {OPPLOD: found},
        found.measurements,
        manifest.faults,
        100,
    )


def page(evaluation: Evaluation) -> str:
    return page_of(evaluation, report_of(evaluation), dict.fromkeys(PLOTS, b"png"))


def captions(page: str) -> list[str]:
    """The words below each picture of a moment."""
    return re.findall(r"<figcaption><strong>(.*?)</figcaption>", page)


def test_the_printed_table_bounds_what_no_alarm_can_show(evaluation: Evaluation) -> None:
    """Twice 7.7 s before an onset, and three times 60 s: 3.26 minutes; 3 / 3.26 is 0.92."""
    first, *between, last = printed_table(evaluation)
    assert "In brackets: 95 % intervals" in "".join(between)
    # By kind of motion: 3 / 1 minute for the clip that stands still.
    assert between[-5].startswith("false alarms per minute by kind of motion, alarm as shipped")
    assert between[-1].split(maxsplit=1) == ["still", "0 (0 to 3)"]
    assert first.endswith("clips without one: 3, minutes without an approach: 3.26")
    assert last.startswith("A detector without a false alarm in 3.26 minutes may")
    assert "up to 0.92 per minute" in last
    (found, *_) = report_of(evaluation)["clips"]
    assert found["seconds_without_approach"] == pytest.approx(7.7)


def test_the_worst_moments(evaluation: Evaluation) -> None:
    # In 3.3 minutes three alarms are allowed: above 1 there are three, above 0 four.
    assert captions(page(evaluation)) == [
        "&lt;missed&gt;.avi</strong>, frame 84 (0.6 s before contact): 1 times the threshold",
        "false.avi</strong>, frame 100 (still): 5 times the threshold",
        "quiet.avi</strong>, frame 200 (not stated): 1 times the threshold",
    ]


def test_moments_are_those_of_the_largest_evidence(evaluation: Evaluation) -> None:
    """A false alarm of a near contact, whose response is smaller than others."""
    raised = np.nan_to_num(CLIPS[3].outputs[OPPLOD].response)
    raised[30] = 70.0
    near = replace(CLIPS[3].outputs[OPPLOD], evidence=raised)
    clips = [*CLIPS[:3], replace(CLIPS[3], outputs={OPPLOD: near}), *CLIPS[4:]]
    _, first, *_ = captions(page(replace(evaluation, clips=clips)))
    assert first == "quiet.avi</strong>, frame 30 (not stated): 70 times the threshold"


def test_the_page_has_the_figures_and_escapes_names(evaluation: Evaluation) -> None:
    text = page(evaluation)
    assert "&lt;missed&gt;.avi" in text
    assert "<missed>" not in text
    assert "row 9: &lt;gone&gt;" in text
    assert "with 3.26 minutes of footage" in text


def test_the_page_has_the_outcomes_of_each_clip_by_both_rules(evaluation: Evaluation) -> None:
    """The alarm as shipped is never on; at 1 per minute it finds one of two approaches."""
    _, table = page(evaluation).split("<h2>Clip by clip</h2>")
    shipped, at_one, *_ = re.split("<h3>.*?</h3>", table.partition("</section>")[0])[1:]
    missed = '<span class="no">missed</span>'
    assert (shipped.count(missed), at_one.count(missed)) == (2, 1)
    assert '<span class="no">3 false</span>' in at_one
    assert '<span class="yes">0.5 s</span>' in at_one
    assert "false</span>" not in shipped


def contrast(colour: str, ground: str) -> float:
    """The ratio of WCAG 2 for two colours as #RGB or #RRGGBB."""
    darker, lighter = sorted(map(luminance_of, (colour, ground)))
    return (lighter + 0.05) / (darker + 0.05)


def luminance_of(colour: str) -> float:
    digits = colour.removeprefix("#")
    digits = "".join(2 * digit for digit in digits) if len(digits) == 3 else digits
    share = np.frombuffer(bytes.fromhex(digits), np.uint8) / 255
    linear = np.where(share <= 0.04045, share / 12.92, ((share + 0.055) / 1.055) ** 2.4)
    return float(linear @ [0.2126, 0.7152, 0.0722])


def test_the_page_compares_each_pair_of_detectors() -> None:
    """ "first" detects six approaches that "second" misses, and misses one that it detects."""
    late, none = {85: 9.0}, dict[int, float]()
    peaks_of = {"first": [late] * 6 + [none], "second": [none] * 6 + [late]}
    clips = [
        replace(clip([0.0] * 100, 80, 90), outputs={
            name: clip(peaks(100, of_clips[at]), 80, 90).outputs[NAME]
            for name, of_clips in peaks_of.items()
        })
        for at in range(7)
    ]  # fmt: skip
    quiet = clip([0.0] * 603)
    clips.append(replace(quiet, outputs=dict.fromkeys(peaks_of, quiet.outputs[NAME])))
    draws = draws_of([clip.label.looming for clip in clips], 100)
    entries = [ClipEntry(at, Path(f"{at}.avi"), clip.label) for at, clip in enumerate(clips, 2)]
    evaluation = Evaluation(
        Manifest(Path("clips.csv"), entries, [], 8),
        [
            EvaluatedDetector(name, "", 240, OpplodReferenceParams(), alarm_params())
            for name in peaks_of
        ],
        entries,
        clips,
        {name: measured(clips, name, draws) for name in peaks_of},
        [],
        [],
        100,
    )
    report = report_of(evaluation)
    assert report["splits"][0] == {
        "condition": "held out at 1 per minute", "contenders": ["first", "second"],
        "only_first": 6, "only_second": 1, "p": pytest.approx(0.125),
    }  # fmt: skip
    page = page_of(evaluation, report, dict.fromkeys(PLOTS, b""))
    section = page[page.index('<section id="splits">') : page.index('<section id="figures">')]
    cells = re.findall(r"<td>(.*?)</td>", section)
    six, one = (
        f'<span class="value">{number}</span> <span class="spread">p 0.12</span>'
        for number in (6, 1)
    )
    assert cells[:4] == ["", six, one, ""]
    assert cells[4:] == ["", "\N{EN DASH}", "\N{EN DASH}", ""]  # no alarm of its own


def test_all_words_of_the_page_can_be_read(evaluation: Evaluation) -> None:
    style = re.search("<style>(.*)</style>", page(evaluation), re.DOTALL)
    assert style
    named = dict(re.findall(r"(--\w+): (#\w+)", style[1]))
    colours = re.findall(r"[{ ;]color: (?:var\((--\w+)\)|(#\w+))", style[1])
    assert len(colours) > 5
    for name, colour in colours:
        assert contrast(colour or named[name], "#fff") >= 4.5, name or colour


def test_the_summary_says_what_each_number_is(evaluation: Evaluation) -> None:
    text = page(evaluation)
    summary = text[text.index('<section id="summary">') : text.index('<section id="plots">')]
    headings = re.findall("<th>(.*?)</th>", summary)
    assert len(set(headings)) == len(headings)
    assert "a share of the 2 approaches" in summary
    # No word needs a mouse that stays over another word.
    assert 'title="' not in text
    assert 'href="#parameters"' in summary
    # A number whose draws are all the same has no interval.
    assert '<span class="spread">no interval, n ' in text


def test_labels_of_stimuli_are_from_no_manifest(evaluation: Evaluation) -> None:
    assert "The labels are from <code>clips.csv</code>" in page(evaluation)
    stimuli = replace(evaluation, manifest=replace(evaluation.manifest, path=STIMULI))
    assert "The labels are from the ground truth of the stimuli" in page(stimuli)


def points_of(page: str) -> list[tuple[float, float]]:
    """The points of the first curve of responses."""
    line = page[page.index("<polyline") :].split("/>", 1)[0]
    return [(float(x), float(y)) for x, y in re.findall(r"([\d.]+),([\d.]+)", line)]


def test_boxes_and_strips_are_drawn_on_the_page(evaluation: Evaluation) -> None:
    _, missed, false, _ = page(evaluation).split('<figure class="still">')
    assert 'viewBox="0 0 400 200"' in missed
    assert f'viewBox="0 0 {WIDTH} {HEIGHT}"' in missed
    assert 'class="label" x="1.0" y="2.0" width="3.0" height="4.0"' in missed
    assert 'class="winner" x="50.0" y="60.0" width="100.0" height="80.0"' in missed
    # The approach, the threshold and the frame shown, and a point for each frame.
    top, now = HEIGHT - 2 - (HEIGHT - 6) / 1.2, 84.5 * WIDTH / 100
    assert points_of(missed)[84] == pytest.approx((now, top), abs=0.06)
    assert len(points_of(missed)) == 100
    at, wide = 80 * WIDTH / 100, 11 * WIDTH / 100
    assert f'class="approach" x="{at:.1f}" y="0.0" width="{wide:.1f}"' in missed
    assert f'class="threshold" x1="0.0" x2="{WIDTH:.1f}" y1="{top:.1f}" y2="{top:.1f}"' in missed
    assert f'class="now" x1="{now:.1f}" x2="{now:.1f}" y1="0.0"' in missed
    assert 'class="approach"' not in false
    assert 'class="winner"' not in false
    heights = [y for _, y in points_of(false)]
    assert (min(heights), heights.count(4)) == (4, 2)  # 5 and 3 times the threshold: cut at 3


@pytest.mark.long
@pytest.mark.usefixtures("undrawn")
def test_nan_and_infinity_are_null_in_the_report(evaluation: Evaluation, tmp_path: Path) -> None:
    with claimed(tmp_path / "report.json", "error") as claim:
        written = list(write_evaluation(evaluation, tmp_path, claim, lambda: 2.0))
    assert [path.name for path in written] == list(FILES)
    report = json.loads(claim.path.read_text("utf-8"), parse_constant=pytest.fail)
    values = {
        (figure["measure"], figure["condition"]): figure["value"] for figure in report["figures"]
    }
    assert values["distinct_ratio", "median over clips"] is None  # infinite
    assert values["place_distance_px", "within 15 frames of contact"] > 0
    assert report["clips"][0]["outcomes"][OPPLOD]["at 1 per minute"]["lead_s"] == 0.5
    assert report["clips"][1]["outcomes"][OPPLOD]["at 1 per minute"]["lead_s"] is None  # NaN
    assert report["timing"]["wall_s"] == 2.0
    outcome = report_of(evaluation)["clips"][2]["outcomes"][OPPLOD]["at 1 per minute"]
    assert outcome["detected"] is None
    assert outcome["false_alarms"] == 3


@pytest.mark.parametrize(
    ("value", "shown"),
    [
        (0.41666, "0.42"), (1 / 30, "0.033"), (0.9999, "1"), (1.7284, "1.73"), (12.0, "12"),
        (361.2, "361"), (11642.0, "11642"), (0.00060776, "0.00061"), (float("inf"), "\u221e"),
        (float("nan"), "\u2013"), (None, "\u2013"),
    ],
)  # fmt: skip
def test_numbers_of_the_page(value: float | None, shown: str) -> None:
    assert number(value) == shown
