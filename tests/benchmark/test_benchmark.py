"""The benchmark of all detectors: its battery, its figures, and going on where it stopped."""

from __future__ import annotations

import itertools
import re
import shutil
import sys
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pytest

from oppload_cli.benchmark import battery
from oppload_cli.benchmark.battery import (
    BATTERY,
    CONTROL,
    LOOMING,
    TABLES,
    Measured,
    Shown,
    columns_of,
    show,
)
from oppload_cli.benchmark.output import Benchmark, _drawn, _limits
from oppload_cli.detection.alarm import alarm_params
from oppload_cli.errors import ParameterError
from oppload_cli.evaluation.detectors import chosen_detectors
from oppload_cli.files.atomic import claimed
from oppload_cli.models import registry
from oppload_cli.models.opplod import Opplod
from tests.cli import inside
from tests.media import grey_frames, write_video
from tests.results.make import rows_of

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

NAMES = ("frame_difference", "lgmd1_single")


@pytest.fixture(autouse=True, scope="module")
def each_arithmetic() -> None:
    """Once is enough: no compiled loops take part."""


def small(kind: str) -> battery.BatteryColumn:
    """A stimulus of few pixels and frames."""
    settings = {
        "display.width": 72,
        "display.height": 72,
        "display.pixels_per_degree": 1.0,
        "timing.motion_s": 0.8,
    }
    if kind == "bright":
        return battery.BatteryColumn(
            "polarity", kind, "klapoetke2017/loom-bright", settings | {battery.L_OVER_V: 40}
        )
    return battery.BatteryColumn("polarity", kind, battery.LOOM, settings | {battery.L_OVER_V: 40})


def test_every_column_shows_stimuli_and_every_table_has_columns() -> None:
    for column in BATTERY:
        protocols = column.protocols()
        assert 1 <= len(protocols) <= 8, column.label
        assert {each.display.frame_rate for each in protocols} == {30}
    assert {column.table for column in BATTERY} == {table.name for table in TABLES}
    labels = [(column.table, column.label) for column in BATTERY]
    assert len(set(labels)) == len(labels)
    looming = {column.kind for column in BATTERY if column.table != battery.SELECTIVITY}
    assert looming == {LOOMING}


def test_contrast_is_that_of_the_disk_to_its_ground() -> None:
    for column in columns_of(["contrast"])[1:]:
        (protocol,) = column.protocols()
        ground, disk = protocol.display.background, protocol.objects[0].luminance
        assert disk is not None
        assert (ground - disk) / ground == pytest.approx(float(column.label))


def test_some_tables_are_shown_with_the_looming_disk() -> None:
    found = columns_of(["noise"])
    assert found[0] is BATTERY[0]
    assert {column.table for column in found[1:]} == {"noise"}
    with pytest.raises(ParameterError, match="no table 'loud'; choose from selectivity"):
        columns_of(["loud"])


def test_measures_are_kept_and_taken_up_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    columns = [small("dark"), small("bright")]
    detectors = chosen_detectors(NAMES)
    seen: list[tuple[int, int]] = []
    first = show(columns, detectors, tmp_path, progress=lambda *counts: seen.append(counts))
    assert seen == [(0, 2), (1, 2), (2, 2)]
    bytes_of = {path.name: path.read_bytes() for path in tmp_path.iterdir()}
    assert len(bytes_of) == 2
    dark, bright = first
    # lgmd1_single sees brightening rather than darkening.
    change, lgmd1 = NAMES
    assert (bright.measured[lgmd1].peak or 0) > 2 * (dark.measured[lgmd1].peak or 0) > 0
    assert dark.measured[change].peak == pytest.approx(bright.measured[change].peak or 0, rel=0.02)

    next(tmp_path.iterdir()).write_text("cut off")
    seen.clear()
    assert show(columns, detectors, tmp_path, progress=lambda *counts: seen.append(counts)) == first
    assert seen == [(1, 2), (2, 2)]
    assert {path.name: path.read_bytes() for path in tmp_path.iterdir()} == bytes_of
    monkeypatch.setattr(battery, "outputs_of", None)  # nothing is shown any more
    assert show(columns, detectors, tmp_path) == first


def test_measurements_are_kept_only_while_their_code_is_the_same(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    read: set[str] = set()

    def read_bytes(path: Path) -> bytes:
        read.add(path.name)
        return b""

    monkeypatch.setattr(Path, "read_bytes", read_bytes)
    battery._code_checksum(chosen_detectors(NAMES))
    assert {"lgmd1_single.py", "alarm.py", "zhou_lrf.csv", "presynaptic.c"} <= read
    assert {"battery.py", "evaluate.py"} <= read  # a peak, and the response after a gap


def test_alarms_are_counted_where_they_start() -> None:
    times, nan = np.arange(5) / 10, np.nan
    alarm = np.array([1, 1, 0, 1, 0], bool)
    found = battery._measure("a", times, np.array([nan, 1, 3, 3, 2]), alarm)
    assert found == Measured("a", 3.0, 0.2, 2, 0.0)
    assert battery._measure("a", times, np.full(5, nan), None) == Measured("a", None, None, 0, None)


def shown(values: Sequence[tuple[str, float, int]]) -> list[Shown]:
    """Make a benchmark of one detector with stated peaks and alarms."""
    (protocol,) = BATTERY[0].protocols()
    columns = [BATTERY[0]]
    columns += [
        battery.BatteryColumn("selectivity", "x", "x", {}, kind) for kind, _, _ in values[1:]
    ]
    return [
        Shown(column, str(i), protocol, {"lgmd2": Measured("lgmd2", peak, 0.5, alarms, None)})
        for i, (column, (_, peak, alarms)) in enumerate(zip(columns, values, strict=True))
    ]


def test_the_summary_counts_pairs_and_alarms() -> None:
    stated = [(LOOMING, 4.0, 1), (LOOMING, 1.0, 0), (CONTROL, 1.0, 2), (CONTROL, 0.0, 0)]
    found = Benchmark(shown(stated), chosen_detectors(["lgmd2"])).summary("lgmd2")
    assert found.auc == pytest.approx((1 + 1 + 0.5 + 1) / 4)
    assert (found.looming_alarmed, found.looming) == (1, 2)
    assert (found.controls_alarmed, found.controls) == (1, 2)
    assert (found.largest_control_over_loom, found.largest_control) == (0.25, "x")
    (lgmd2,) = chosen_detectors(["lgmd2"])
    off = replace(lgmd2, alarm=alarm_params("paper"))
    silent = Benchmark(shown(stated), [off])
    found = silent.summary("lgmd2")
    assert (found.looming_alarmed, found.controls_alarmed) == (None, None)


def test_a_cost_belongs_to_the_preset_under_which_it_was_measured() -> None:
    both = chosen_detectors(["opplod:default", "opplod:reference"])
    rows = [
        each._replace(measured={one.name: Measured(one.name, 1.0, 0.5, 0, None) for one in both})
        for each in shown([(LOOMING, 4.0, 1), (CONTROL, 1.0, 0)])
    ]
    found = Benchmark(rows, both)
    assert found.summary("opplod:default").cost_ms == Opplod.cost_ms
    assert found.summary("opplod:reference").cost_ms is None


def test_a_stimulus_of_several_tables_counts_once() -> None:
    stated = [(LOOMING, 4.0, 1), (LOOMING, 1.0, 0), (LOOMING, 4.0, 1), (CONTROL, 2.0, 0)]
    rows = shown(stated)
    rows[2] = rows[2]._replace(key=rows[0].key)
    found = Benchmark(rows, chosen_detectors(["lgmd2"])).summary("lgmd2")
    assert (found.looming_alarmed, found.looming, found.auc) == (1, 2, 0.5)


def test_a_disk_of_several_tables_is_one_stimulus(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(battery, "results", lambda *_, **__: None)  # nothing is shown
    looming = [column for column in BATTERY if column.kind == LOOMING]
    keys = {
        (each.column.table, each.column.label): each.key
        for each in show(looming, chosen_detectors(NAMES), tmp_path)
    }
    disk = {("selectivity", "looming disk"), ("polarity", "dark"), ("speed", "40"), ("size", "60")}
    assert {place for place, key in keys.items() if key == keys["polarity", "dark"]} == disk
    assert len(set(keys.values())) == len(keys) - 3


SOURCE = """
import oppload_cli

@oppload_cli.register
class Constant(oppload_cli.Detector):
    name, label, colour, meaning = "constant", "Constant", "#445566", "always the same"
    alarm_floors = {"default": 0.0}

    def reset(self):
        pass

    def step(self, luma):
        return oppload_cli.Response(1.0)
"""


@pytest.mark.usefixtures("same_detectors_after")
def test_an_edited_detector_is_shown_again(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(registry, "_loaded", {})  # which every sidecar states
    file = tmp_path / "constant.py"
    peaks = []
    for source in (SOURCE, SOURCE.replace("1.0", "20.0")):
        file.write_text(source)
        registry.load(str(file))
        (found,) = show([small("dark")], chosen_detectors(["constant"]), tmp_path)
        peaks.append(found.measured["constant"].peak)
    assert peaks == [1.0, 20.0]


def test_a_detector_without_a_response_to_the_disk() -> None:
    stated = [(LOOMING, 0.0, 0), (CONTROL, 0.0, 0), (CONTROL, 3.0, 1)]
    benchmark = Benchmark(shown(stated), chosen_detectors(["lgmd2"]))
    assert benchmark.over_loom("lgmd2", 0.0) == 0
    assert np.isinf(benchmark.summary("lgmd2").largest_control_over_loom)


@pytest.fixture
def _small_battery() -> Iterator[None]:
    with small_battery():
        yield


@contextmanager
def small_battery() -> Iterator[None]:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(battery, "BATTERY", (small("dark"), small("bright")))
        yield


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A benchmark of two detectors on the small battery."""
    folder = tmp_path_factory.mktemp("benchmark")
    with small_battery():
        done = inside.oppload(*benchmark_in(folder, *NAMES))
    assert (done.returncode, done.stderr) == (0, "")
    names = "stimuli.csv", "summary.csv", "polarity.pdf", "benchmark.json", "benchmark.html"
    assert done.stdout.split() == [str(folder / name) for name in names]
    return folder


def benchmark_in(folder: Path, *names: str) -> tuple[str | Path, ...]:
    return "benchmark", "-o", folder, "-q", "-j", "1", "--model", ",".join(names)


@pytest.mark.long
@pytest.mark.usefixtures("_small_battery")
def test_the_command_writes_tables_figures_and_a_page(made: Path) -> None:
    rows = rows_of(made / "stimuli.csv")
    assert [(row["column"], row["detector"]) for row in rows] == [
        (column, name) for column in ("dark", "bright") for name in NAMES
    ]
    assert rows[0]["peak_over_loom"] == "1"
    page = (made / "benchmark.html").read_text()
    assert "LGMD1" in page
    assert "https://" not in page
    first = {path.name: path.read_bytes() for path in made.iterdir() if path.is_file()}
    told = inside.oppload(*benchmark_in(made, *NAMES)).stderr
    assert told.startswith("2 of 2 stimuli kept from an earlier run")
    again = {path.name: path.read_bytes() for path in made.iterdir() if path.is_file()}
    assert again == first


@pytest.mark.long
@pytest.mark.skipif(sys.platform == "win32", reason="no locks")
@pytest.mark.usefixtures("_small_battery")
def test_of_two_benchmarks_in_one_folder_the_second_is_refused(tmp_path: Path) -> None:
    with claimed(tmp_path / "benchmark.json", "overwrite"):
        refused = inside.oppload(*benchmark_in(tmp_path, *NAMES))
    assert refused.returncode == 2
    assert "benchmark.json: another run is writing it; wait for that one" in refused.stderr
    assert not list(tmp_path.iterdir())


@pytest.mark.long
@pytest.mark.usefixtures("_small_battery", "undrawn")
def test_a_benchmark_with_other_settings_is_replaced_on_request_only(
    made: Path, tmp_path: Path
) -> None:
    shutil.copytree(made, tmp_path, dirs_exist_ok=True)
    call = benchmark_in(tmp_path, NAMES[0])
    (tmp_path / "speed.pdf").write_text("of an earlier benchmark")
    (tmp_path / "mine.pdf").write_text("of the user")
    before = (tmp_path / "summary.csv").read_bytes()
    refused = inside.oppload(*call)
    assert refused.returncode == 2
    assert "is a benchmark with other detectors; choose --if-exists overwrite" in refused.stderr
    assert (tmp_path / "summary.csv").read_bytes() == before
    assert inside.oppload(*call, "--if-exists", "overwrite").returncode == 0
    assert (tmp_path / "summary.csv").read_bytes() != before
    assert sorted(path.name for path in tmp_path.glob("*.pdf")) == ["mine.pdf", "polarity.pdf"]
    (tmp_path / "benchmark.json").write_text("damaged")
    assert "with other detectors and tables" in inside.oppload(*call).stderr
    (tmp_path / "benchmark.json").unlink()
    refused = inside.oppload(*call)
    assert (refused.returncode, "stimuli.csv: exists already" in refused.stderr) == (2, True)


@pytest.mark.long
@pytest.mark.usefixtures("_small_battery", "undrawn")
def test_faults_of_the_clips_are_told(tmp_path: Path) -> None:
    write_video(tmp_path / "a.avi", grey_frames(10))
    manifest = tmp_path / "clips.csv"
    manifest.write_text("file,label,onset_frame,contact_frame\na.avi,none,,\nb.avi,none,,\n")
    words = *benchmark_in(tmp_path / "b", NAMES[0]), "--manifest", manifest
    done = inside.oppload(*words)
    assert done.returncode == 4
    assert done.stderr == (
        f"oppload: {manifest}: row 3: b.avi: there is no such file; give its path from the "
        "manifest's folder\n"
    )
    page = (tmp_path / "b" / "benchmark.html").read_text()
    assert "Clips with an approach: 0; without: 1; with" in page
    assert re.search(r"0 \(0 to \d+\)", page)  # false alarms per minute, with the interval
    assert "oppload 1" in page


def test_the_title_of_a_narrow_table_is_not_cut() -> None:
    found = Benchmark(shown([(LOOMING, 4.0, 1), (CONTROL, 2.0, 0)]), chosen_detectors(["lgmd2"]))
    figure = _drawn(found, TABLES[0])
    figure.draw_without_rendering()
    words = [*figure.texts, *(each.title for each in figure.axes)]
    assert any("shades" in each.get_text() for each in words)
    for each in words:
        assert each.get_window_extent().x1 <= figure.bbox.x1


def test_the_shades_end_at_the_responses_and_the_dots_are_alarms() -> None:
    stated = [(LOOMING, 4.0, 1), (CONTROL, 2.0, 1), (CONTROL, 2.0, 0)]
    figure = _drawn(Benchmark(shown(stated), chosen_detectors(["lgmd2"])), TABLES[0])
    panel, bar = figure.axes
    assert [dot.get_fillstyle() for dot in panel.lines] == ["full", "left"]
    assert panel.images[0].get_clim() == (0.5, 1.0)
    assert bar.get_ylabel() == "response / disk"
    wide = Benchmark(shown([(LOOMING, 4.0, 1), (CONTROL, 0.1, 0)]), chosen_detectors(["lgmd2"]))
    figure = _drawn(wide, TABLES[0])
    _, bar = figure.axes
    figure.draw_without_rendering()
    numbers = [label.get_window_extent() for label in bar.get_yticklabels()]
    assert not any(first.overlaps(second) for first, second in itertools.pairwise(numbers))
    assert _limits(np.array([0.0, np.inf, 50, 2e-4])) == (1e-3, 10.0)
    assert _limits(np.array([1.0, 1.0])) == (0.5, 1.0)
    assert _limits(np.array([0.0])) == (1e-3, 2e-3)


@pytest.mark.parametrize(
    ("option", "value", "message"),
    [
        ("--model", "lgmd3", "no model 'lgmd3'; did you mean"),
        ("--model", "opplod:robust", "no model 'opplod:robust'"),
        ("--only", "sped", "no table 'sped'"),
        ("--manifest", "no.csv", "no.csv: cannot be read"),
    ],
)
def test_wrong_names_are_refused(option: str, value: str, message: str, tmp_path: Path) -> None:
    done = inside.oppload("benchmark", "-o", tmp_path / "new", option, value)
    assert done.returncode == 2
    assert message in done.stderr
    assert not (tmp_path / "new").exists()
