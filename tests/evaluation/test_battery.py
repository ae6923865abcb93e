"""The battery of stimuli: its labels, the selectivity of detectors, its matrix and its files."""

from __future__ import annotations

import itertools
import json
import math
from dataclasses import replace
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

from oppload_cli.evaluation import battery
from oppload_cli.evaluation.battery import (
    BATTERY,
    TABLES,
    BatteryColumn,
    BatteryResponses,
    battery_stimuli,
)
from oppload_cli.evaluation.manifest import ClipEntry, Manifest
from oppload_cli.evaluation.metrics.alarms import SHIPPED
from oppload_cli.evaluation.metrics.measures import KIND
from oppload_cli.evaluation.output import ALL_FILES, BATTERY_FILES
from oppload_cli.evaluation.plots import _limits, battery_figure
from oppload_cli.models.registry import detectors
from tests.cli.inside import oppload
from tests.evaluation.make import NAME, clip, peaks
from tests.media import grey_frames, write_video
from tests.results.make import rows_of

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

DISK = BATTERY[0].label


@pytest.fixture(scope="module")
def stimuli() -> Manifest:
    return battery_stimuli()


def test_the_ground_truth_agrees_with_every_table(stimuli: Manifest) -> None:
    assert not stimuli.faults
    labels = [entry.label for entry in stimuli.entries]
    looming = [label for label in labels if label.looming]
    assert (len(looming), len(labels)) == (40, 84)
    kinds = {label.conditions[KIND] for label in looming if KIND in label.conditions}
    assert kinds == {"looming disk", "looming square", "looming patch"}
    assert {label.motion for label in labels if not label.looming}.isdisjoint(kinds)
    assert len({label.name for label in labels}) == len(labels)
    shown = {(table, text) for label in labels for table, text in label.conditions.items()}
    assert shown == {(column.table, column.label) for column in BATTERY}
    assert {table for table, _ in shown} == set(TABLES)
    assert len(shown) == len(BATTERY)
    for column in BATTERY:
        assert {protocol.display.frame_rate for protocol in column.protocols()} == {30}


def test_a_stimulus_of_several_tables_counts_once(stimuli: Manifest) -> None:
    several = {
        entry.label.name: entry.label.conditions
        for entry in stimuli.entries
        if len(entry.label.conditions) > 1
    }
    disk = {KIND: DISK, "polarity": "dark", "speed": "40 ms", "size": "60 deg"}
    assert several == {DISK: disk}


def test_contrast_is_that_of_the_disk_to_its_ground() -> None:
    columns = [column for column in BATTERY if column.table == "contrast"]
    for column in columns:
        (protocol,) = column.protocols()
        ground, disk = protocol.display.background, protocol.objects[0].luminance
        assert disk is not None
        assert (ground - disk) / ground == pytest.approx(float(column.label))


def responses(values: Sequence[tuple[str, float, int]], *, alarms: bool = True) -> BatteryResponses:
    """Make the responses of one detector from kinds of motion, peaks and alarms (1 or 0)."""
    clips, entries, name = [], [], "lgmd2"
    protocol = BATTERY[0].protocols()[0]
    for row, (kind, peak, _) in enumerate(values):
        looming = kind.startswith("looming")
        frames = {"onset": 10, "contact": 20} if looming else {"motion": kind}
        made: Any = clip(peaks(30, {15: peak}), **frames)
        label = replace(made.label, conditions={KIND: kind})
        clips.append(replace(made, label=label, outputs={name: made.outputs[NAME]}))
        entries.append(ClipEntry(row, protocol, label))
    is_looming = np.array([made.label.looming for made in clips])
    alarmed = np.array([on if alarms else math.nan for _, _, on in values])
    outcomes = SimpleNamespace(
        detected=np.where(is_looming, alarmed, math.nan),
        lead_s=np.where(is_looming, 0.5, math.nan),
        false_alarms=np.where(is_looming, 0.0, 2 * alarmed),
    )
    evaluation: Any = SimpleNamespace(
        clips=clips,
        entries=entries,
        detectors=[SimpleNamespace(name=name)],
        performances={
            name: SimpleNamespace(decisions={SHIPPED: SimpleNamespace(outcomes=outcomes)})
        },
    )
    return BatteryResponses(evaluation)


STATED = [(DISK, 4.0, 1), ("looming square", 1.0, 0), ("pan", 1.0, 1), ("roll", 0.0, 0)]


def test_the_summary_counts_pairs_and_alarms() -> None:
    found = responses(STATED).summary("lgmd2")
    assert found.auc == pytest.approx((1 + 1 + 0.5 + 1) / 4)
    assert (found.approaches_detected, found.approaches) == (1, 2)
    assert (found.controls_alarmed, found.controls) == (1, 2)
    assert (found.largest_control_over_loom, found.largest_control) == (0.25, "pan")
    assert found.cost_ms == detectors()["lgmd2"].cost_ms
    silent = responses(STATED, alarms=False).summary("lgmd2")
    assert (silent.approaches_detected, silent.controls_alarmed) == (None, None)
    alone = responses(STATED[:1]).summary("lgmd2")
    assert math.isnan(alone.auc)
    assert alone.largest_control == ""


def test_a_row_has_what_was_measured_in_a_clip() -> None:
    rows = list(responses(STATED).rows())
    assert [(row["table"], row["column"], row["peak"]) for row in rows] == [
        (KIND, kind, peak)
        for kind, peak in [(DISK, 4.0), ("looming square", 1.0), ("pan", 1.0), ("roll", 0.0)]
    ]
    assert [row["peak_over_loom"] for row in rows] == [1, 0.25, 0.25, 0]
    assert [row["detected"] for row in rows] == [True, False, None, None]
    assert [row["false_alarms"] for row in rows] == [0, 0, 2, 0]
    assert (rows[0]["peak_time_s"], rows[0]["motion_end_s"]) == (1.5, 2.2)


def test_a_detector_without_a_response_to_the_disk_or_without_the_disk() -> None:
    found = responses([(DISK, 0.0, 0), ("pan", 0.0, 0), ("roll", 3.0, 1)])
    assert found.over_loom["lgmd2"].tolist() == [0, 0, math.inf]
    assert shades_of(battery_figure(found))[1:4] == pytest.approx([1e-3, 1e-3, 2e-3])
    assert math.isnan(responses(STATED[1:]).summary("lgmd2").largest_control_over_loom)


def shades_of(figure: Any) -> list[float]:
    """The shades of the only detector on the left side, from the top."""
    shades: list[float] = figure.axes[0].images[0].get_array()[:, 0].tolist()
    return shades


def test_the_shades_end_at_the_responses_and_the_dots_are_alarms() -> None:
    stated = [(DISK, 4.0, 1), ("pan", 2.0, 1), ("pan", 1.0, 0), ("roll", 2.0, 0)]
    panel, _, bar = battery_figure(responses(stated)).axes
    assert [(dot.get_ydata()[0], dot.get_fillstyle()) for dot in panel.lines] == [  # type: ignore[index]
        (1, "full"),
        (2, "left"),
    ]
    labels = [label.get_text() for label in panel.get_yticklabels()]
    assert labels[:4] == ["Kind of motion", DISK, "pan", "roll"]
    assert shades_of(panel.figure)[1:4] == [1, 0.5, 0.5]
    assert panel.images[0].get_clim() == (0.25, 1.0)
    figure = battery_figure(responses([*STATED[:1], ("pan", 0.1, 0)]))
    figure.draw_without_rendering()
    numbers = [label.get_window_extent() for label in figure.axes[2].get_yticklabels()]
    assert len(numbers) > 1
    assert not any(first.overlaps(second) for first, second in itertools.pairwise(numbers))
    assert bar.get_ylabel() == "largest response / that to the looming disk"
    assert _limits(np.array([0.0, np.inf, 50, 2e-4])) == (1e-3, 10.0)
    assert _limits(np.array([1.0, 1.0])) == (0.5, 1.0)
    assert _limits(np.array([0.0])) == (1e-3, 2e-3)


def small(table: str, label: str, stimulus: str) -> BatteryColumn:
    """A stimulus of few pixels and frames."""
    settings = {
        "display.width": 72,
        "display.height": 72,
        "display.pixels_per_degree": 1.0,
        "timing.motion_s": 0.8,
        battery._L_OVER_V: 40,
    }
    return BatteryColumn(table, label, stimulus, settings)


@pytest.fixture
def _small_battery(monkeypatch: pytest.MonkeyPatch) -> None:
    columns = [
        small(KIND, DISK, battery._LOOM),
        small(KIND, "receding disk", "controls/receding-disk"),
        small("polarity", "bright", "klapoetke2017/loom-bright"),
    ]
    monkeypatch.setattr(battery, "BATTERY", tuple(columns))


MODELS = "--model", "opplod,lgmd1_single", "--draws", "100", "-j", "1"


@pytest.mark.long
@pytest.mark.usefixtures("_small_battery")
def test_the_battery_alone_is_evaluated_like_any_stimuli(tmp_path: Path) -> None:
    done = oppload("evaluate", "--battery", "-o", tmp_path, *MODELS)
    assert done.returncode == 0
    assert "battery of stimuli, alarm as shipped" in done.stderr
    assert {path.name for path in tmp_path.iterdir()} == set(ALL_FILES)
    rows = rows_of(tmp_path / "battery.csv")
    names = list(dict.fromkeys(row["contender"] for row in rows))
    assert len(rows) == 3 * len(names)
    assert {"lgmd1_single", "dlgmd"} < set(names)
    peak = {(row["column"], row["contender"]): float(row["peak"]) for row in rows}
    # lgmd1_single sees brightening rather than darkening.
    assert peak["bright", "lgmd1_single"] > 2 * peak[DISK, "lgmd1_single"] > 0
    assert peak["bright", "frame_difference"] == pytest.approx(
        peak[DISK, "frame_difference"], rel=0.02
    )
    seen: dict[tuple[str, str], float] = {}
    for row in rows_of(tmp_path / "responses.csv"):
        key = row["clip"], row["contender"]
        seen[key] = max(seen.get(key, 0.0), float(row["response"] or 0))
    assert all(seen[row["clip"], row["contender"]] == float(row["peak"]) for row in rows)
    report = json.loads((tmp_path / "report.json").read_text())
    assert list(report["battery"]) == names
    assert {one["approaches"] for one in report["battery"].values()} == {2}
    page = (tmp_path / "evaluation.html").read_text()
    assert "approaches (2) and controls, which are other motions (1)" in page
    assert "LGMD1" in page
    assert "https://" not in page
    measured = {(row["measure"], row["condition"]) for row in rows_of(tmp_path / "evaluation.csv")}
    assert ("detection_rate", "alarm as shipped, polarity bright") in measured
    assert ("alarmed_share", "alarm as shipped, kind receding disk") in measured


@pytest.mark.long
@pytest.mark.usefixtures("_small_battery", "undrawn")
def test_clips_and_battery_stand_on_one_page(tmp_path: Path) -> None:
    write_video(tmp_path / "a.avi", grey_frames(10))
    manifest = tmp_path / "clips.csv"
    manifest.write_text("file,label,onset_frame,contact_frame\na.avi,none,,\nb.avi,none,,\n")
    folder = tmp_path / "out"
    done = oppload("evaluate", manifest, "--battery", "-o", folder, *MODELS)
    assert done.returncode == 4
    fault = f"{manifest}: row 3: b.avi: there is no such file; give its path from the manifest's"
    assert done.stderr.count(fault) == 1
    page = (folder / "evaluation.html").read_text()
    assert "Looming detectors on 1 labelled clip" in page
    assert 'id="battery"' in page
    assert {row["clip"] for row in rows_of(folder / "responses.csv")} == {"a.avi"}
    again = oppload("evaluate", manifest, "-o", folder, *MODELS)
    assert (again.returncode, "exists already" in again.stderr) == (2, True)
    oppload("evaluate", manifest, "-o", folder, *MODELS, "--if-exists", "overwrite")
    assert not any((folder / name).exists() for name in BATTERY_FILES)
    assert json.loads((folder / "report.json").read_text())["battery"] is None


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (("evaluate",), "name a manifest, stimuli or videos to evaluate, or give --battery"),
        (("evaluate", "--battery", "--change", "seed=1"), "--change go with a manifest, stimuli"),
        (("evaluate", "--battery", "--model", "lgmd3"), "no model 'lgmd3'; did you mean"),
        (("evaluate", "--battery", "no.csv"), "no.csv: cannot be read"),
        (("benchmark", "--only", "noise"), "no command 'benchmark'; write 'oppload evaluate --ba"),
    ],
)
def test_wrong_use_is_refused(words: tuple[str, ...], message: str, tmp_path: Path) -> None:
    done = oppload(*words, cwd=tmp_path)
    assert (done.returncode, message in done.stderr) == (2, True), done.stderr
    assert not list(tmp_path.iterdir())
