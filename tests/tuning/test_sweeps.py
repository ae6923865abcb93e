"""The sweeps of the classic figures, with detectors whose answers are known."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

import numpy as np
import pytest

from oppload_cli import Detector, Response
from oppload_cli.errors import OpploadError, ParameterError
from oppload_cli.models import registry
from oppload_cli.pipeline.settings import resolve
from oppload_cli.plots.peak_times import PeakTimes
from oppload_cli.plots.tuning_plots import KINDS
from oppload_cli.schema import Parameters, parameter
from oppload_cli.tuning.measuring import doubts_about, tune, tuning_text
from oppload_cli.tuning.present import Responses, low_passed, present
from oppload_cli.tuning.sweeps import FIGURES, Sweep, parsed_over, sweeps
from tests.assigned import assigned
from tests.results.make import rows_of
from tests.tuning.test_tuning import disk, swept

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence
    from pathlib import Path

    from oppload_cli.models.dpc import Map
    from oppload_cli.pipeline.settings import Settings
    from oppload_cli.stimulus.catalogue import Entry
    from oppload_cli.tuning.present import Condition

FIELD_DEG = 72  # of the displays
SMALL = {"display.width": 144, "display.height": 144, "display.pixels_per_degree": 2.0}
RATE = 120
DELAY = 6  # frames


@dataclass(frozen=True, kw_only=True)
class ThetaParams(Parameters):
    alpha: float = parameter(0.0, "0: the size itself; else of the eta function", low=0, high=20)


class Theta(Detector):
    """The angular size of a dark disk, or the eta function of it, some frames late."""

    name, label, colour = "theta", "Theta", "#AA00AA"
    meaning = "angular size of all that is dark"
    parameters = ThetaParams
    alarm_floors: ClassVar = {"default": 0.0}
    params: ThetaParams
    seen: tuple[float, ...] = ()

    def reset(self) -> None:
        self.seen = ()

    def step(self, luma: Map) -> Response | None:
        dark = float(np.mean(1 - luma)) * FIELD_DEG**2
        self.seen = (*self.seen, math.radians(2 * math.sqrt(dark / math.pi)))
        if len(self.seen) < DELAY + 2:
            return None
        if not self.params.alpha:
            return Response(self.seen[-1])
        before, late = self.seen[-DELAY - 2 : -DELAY]
        return Response(
            max(0.0, late - before) * math.exp(-self.params.alpha * (before + late) / 2)
        )


@dataclass(frozen=True, kw_only=True)
class TiredParams(Parameters):
    share: float = parameter(0.5, "of its answer that is left the next time", low=0, high=1)


class Tired(Detector):
    """Answers to darkening, less each time after the picture has become brighter."""

    name, label, colour = "tired", "Tired", "#00AAAA"
    meaning = "darkening, less and less"
    parameters = TiredParams
    alarm_floors: ClassVar = {"default": 0.0}
    params: TiredParams
    dark, shows = 0.0, 0

    def reset(self) -> None:
        self.dark, self.shows = 0.0, 0

    def step(self, luma: Map) -> Response | None:
        before, self.dark = self.dark, float(np.mean(1 - luma))
        self.shows += self.dark < before
        return Response(max(0.0, self.dark - before) * self.params.share**self.shows)


@pytest.fixture(scope="module", autouse=True)
def _registered() -> Iterator[None]:
    for each in (Theta, Tired):
        registry.register(each)
    yield
    for each in (Theta, Tired):
        registry.forget(each.name)


def times(conditions: list[Condition], model: str) -> np.ndarray:
    found = [each.measures[model].peak_before_contact_s for each in conditions]
    return np.array(found, float)


def entry_of(name: str, changes: dict[str, float], over: Sequence[str] = ()) -> Entry:
    (one,) = sweeps(None, [name], dict(changes), parsed_over(over), {})
    return one.entry


def at_native_size(models: list[str], *assignments: str) -> Settings:
    return resolve(models=models, height="native", assignments=assigned(*assignments))


L_OVER_V = [20, 40, 60, 80]


@pytest.mark.long
def test_the_line_finds_threshold_and_delay_of_the_eta_function() -> None:
    entry = entry_of("peak-time", SMALL, ["l/v=20,40,60,80"])
    settings = at_native_size(["theta"], "theta.alpha=3", "time.interval=frame")
    shown = times(tune(Sweep(entry, settings)), "theta")
    fit = PeakTimes.through(np.array(L_OVER_V) / 1000, shown, 1 / RATE)
    # The derivative is that between two frames, half a frame before the last of them.
    late = (DELAY + 0.5) / RATE
    assert fit.slope == pytest.approx(3, abs=fit.slope_error)
    assert fit.delay_s == pytest.approx(late, abs=fit.delay_error_s)
    assert fit.slope_error < 0.4
    low, high = fit.angle_limits_deg
    assert low < math.degrees(2 * math.atan(1 / 3)) < high


@pytest.mark.long
def test_the_size_itself_peaks_where_the_disk_stops_growing() -> None:
    entry = entry_of("peak-time", {**SMALL, "disk.growth.most_deg": 50}, ["l/v=20,60"])
    settings = at_native_size(["theta"], "time.interval=frame")
    shown = tune(Sweep(entry, settings))
    end = np.array([20, 60]) / 1000 / math.tan(math.radians(25))
    late = end - times(shown, "theta")
    assert ((late >= -1e-9) & (late < 1 / RATE)).all()
    sizes = [each.measures["theta"].size_at_peak_deg for each in shown]
    assert sizes == pytest.approx([50, 50])


def test_every_figure_makes_its_stimuli() -> None:
    assert list(FIGURES) == [
        "peak-time", "size-speed", "position", "bar-ends", "contrast", "habituation",
    ]  # fmt: skip
    for name, figure in FIGURES.items():
        shown = entry_of(name, {}).protocols()
        assert figure.kind in KINDS
        assert {each.name.partition("/")[0] for each in shown} == {name}
        # One scale in all figures, so that fields in pixels are the same angle.
        assert {(each.display.height, each.display.scale) for each in shown} == {(360, 5)}


def test_a_sweep_tells_the_changes_of_the_user_alone() -> None:
    changes = {"speed": 30, "timing.motion_s": 0.4}
    full = {"bar.growth.speed_deg_s": 30, "timing.motion_s": 0.4}
    (figure,) = sweeps(None, ["bar-ends"], dict(changes), {}, {})
    (own,) = sweeps("klapoetke2017/bar-expand-10", (), changes | {"axis": [0, 90]}, {}, {})
    assert figure.changes == own.changes == full


@pytest.mark.long
@pytest.mark.parametrize(
    ("name", "over"),
    [
        ("position", ["position=[[-12,0],[0,0],[12,12]]"]),
        ("bar-ends", ["bar.axis_deg=0,45,180,225", "bar.growth.sides"]),
    ],
)
def test_a_figure_shows_tuning_and_no_start_of_the_motion(name: str, over: list[str]) -> None:
    (sweep,) = sweeps(None, [name], {}, parsed_over(over), {})
    entry, settings = sweep.entry, sweep.settings
    assert settings.models == ("opplod_reference", "dlgmd")
    shown = tune(Sweep(entry, settings))
    assert [each.detector for each in doubts_about(shown, Sweep(entry, settings))] == []
    # The first response is in frame 3: no peak is cut off there.
    measured = [condition.measures["opplod_reference"] for condition in shown]
    best = max(measured, key=lambda measures: measures.peak or 0)
    assert best.peak_frame is not None
    assert best.peak_frame > 3


def test_other_values_of_what_a_figure_sweeps() -> None:
    assert entry_of("peak-time", {}, ["l/v=5,15"]).sweep == {"disk.growth.l_over_v_ms": [5, 15]}
    two = entry_of("size-speed", {}, ["speed=30"]).sweep
    assert two["disk.growth.speed_deg_s"] == [30]
    assert len(two["disk.growth.end_deg"]) == 7
    sizes = entry_of("size-speed", {}, ["size=15,30"]).sweep  # the size that the figure sweeps
    assert sizes["disk.growth.end_deg"] == [15, 30]
    assert len(sizes["disk.growth.speed_deg_s"]) == 5
    for key in ("l/v", "disk.growth.l_over_v_ms"):
        (slow,) = entry_of("habituation", {key: 80}).protocols()
        assert slow.objects[0].growth is not None
        assert slow.objects[0].growth.l_over_v_ms == 80


@pytest.mark.parametrize(
    ("name", "changes", "over", "message"),
    [
        (
            "peak-time",
            {"disk.growth.l_over_v_ms": 3},
            [],
            "figure peak-time sweeps it; give --over",
        ),
        (
            "peak-time",
            {},
            ["disk.luminance=0,1"],
            "sweeps disk.growth.l_over_v_ms; make a figure .* with --change disk.luminance=VALUE",
        ),
        ("peak-time", {"l/v": 3}, [], "--change disk.growth.l_over_v_ms: figure peak-time sweeps"),
        ("habituation", {}, ["disk.luminance=0,1"], "figure habituation sweeps nothing"),
        ("contrast", {"disc.size_deg": 3}, [], "did you mean 'disk'"),
    ],
)
def test_wrong_values_of_a_figure(
    name: str, changes: dict[str, float], over: list[str], message: str
) -> None:
    with pytest.raises(OpploadError, match=message):
        entry_of(name, changes, over)


def test_a_wrong_figure() -> None:
    with pytest.raises(ParameterError, match=r"no such figure; did you mean 'contrast'\?$"):
        sweeps(None, ["contrst"], {}, {}, {})
    with pytest.raises(ParameterError, match=r"no such figure; choose all, .*size-speed$"):
        sweeps(None, ["xyz"], {}, {}, {})
    found = sweeps(None, ["contrast", "all", "contrast"], {}, {}, {})
    names = [each.figure["name"] for each in found]
    assert names == ["contrast", *(name for name in FIGURES if name != "contrast")]


def test_without_adaptation_every_presentation_is_the_first(tmp_path: Path) -> None:
    entry = swept(str(disk(tmp_path, 0.4).path), ["speed=25"])
    settings = at_native_size(["opplod_reference", "tired"], "opplod_reference.receptive_field=24")
    shown = tune(Sweep(entry, settings, 3))
    assert [each.values["presentation"] for each in shown] == [1, 2, 3]
    peaks = [each.measures["opplod_reference"].peak or 0 for each in shown]
    assert peaks[0] > 0
    assert peaks == pytest.approx([peaks[0]] * 3, rel=0.01)
    first, *others = (each.measures["opplod_reference"] for each in shown)
    for other in others:  # frames and times count from the start of each presentation
        assert (other.peak_frame, other.onset_frame) == (first.peak_frame, first.onset_frame)
        assert (other.peak_time_s, other.onset_time_s) == (first.peak_time_s, first.onset_time_s)
        assert other.peak_before_contact_s == first.peak_before_contact_s
    tired = [each.measures["tired"].peak or 0 for each in shown]
    assert tired == pytest.approx([tired[0], tired[0] / 2, tired[0] / 4], rel=1e-6)
    (tmp_path / "a.csv").write_text(tuning_text(shown))
    rows = rows_of(tmp_path / "a.csv")
    assert list(rows[0])[:4] == ["stimulus", "disk.growth.speed_deg_s", "presentation", "model"]
    assert rows[3]["stimulus"] == "disk/speed-25/presentation-2"
    times = [float(row["peak_time_s"]) for row in rows if row["model"] == "opplod_reference"]
    assert times == pytest.approx([float(rows[0]["peak_frame"]) / 25] * 3)


def test_a_pause_before_the_motion_is_no_part_of_a_presentation(tmp_path: Path) -> None:
    protocol = disk(tmp_path, 0.12).protocols()[0]  # 3 of 18 frames
    count = protocol.frame_count
    frames = np.arange(2.0 * count)
    responses = Responses(frames, frames / 25, frames, np.tile(frames, (4, 1)).T)
    first, second = responses.presentations(protocol)
    assert np.isnan(second.response).tolist() == [True] * 3 + [False] * (count - 3)
    assert second.response[3] == count + 3
    np.testing.assert_array_equal(first.time_s, second.time_s)
    assert second.centre[-1].tolist() == [1.5 * (2 * count - 1)] * 2


def test_a_setting_of_the_user_replaces_that_of_a_figure() -> None:
    for values, units in (({}, "1x1"), ({"opplod_reference.units": "3x3"}, "3x3")):
        (found,) = sweeps(None, ["position"], {}, {}, {"assignments": values})
        assert found.settings.groups["opplod_reference"].as_dict()["units"] == units


def test_a_setting_of_a_figure_is_that_of_every_version_of_opplod() -> None:
    models = ["opplod", "opplod_lplc2", "opplod_paper", "dlgmd"]
    (found,) = sweeps(None, ["position"], {}, {}, {"models": models})
    units = {name: found.settings.groups[name].as_dict().get("units") for name in models}
    assert units == {**dict.fromkeys(models[:3], "1x1"), "dlgmd": None}


@pytest.mark.long
def test_the_map_of_positions_peaks_where_the_unit_is() -> None:
    over = ["position=[[-12,0],[0,0],[12,0],[0,12],[0,-12]]"]
    (sweep,) = sweeps(None, ["position"], {}, parsed_over(over), {"models": ["opplod_reference"]})
    peaks = [each.measures["opplod_reference"].peak or 0 for each in tune(sweep)]
    assert int(np.argmax(peaks)) == 1
    assert max(peaks[:1] + peaks[2:]) < 0.2 * peaks[1]


def test_sizes_in_degrees_are_those_of_the_display_of_the_stimulus(tmp_path: Path) -> None:
    """The display has 2 px/deg."""
    protocol = disk(tmp_path).protocols()[1]
    name, fields = "opplod_reference", ("12deg", "24")
    settings = [at_native_size([name], f"{name}.receptive_field={field}") for field in fields]
    found = [present(protocol, each)[name] for each in settings]
    np.testing.assert_allclose(found[0].response, found[1].response)
    assert np.nanmax(found[0].response) > 0


def test_an_indicator_approaches_a_constant_exponentially_whatever_the_steps() -> None:
    times = np.array([0.0, 0.1, 0.35, 1.0])
    signal = low_passed(np.array([np.nan, 1, 1, 1]), times, 0.5)
    np.testing.assert_allclose(signal, 1 - np.exp(-times / 0.5))
    assert low_passed(np.array([np.nan, 2.0]), times[:2], 0).tolist() == [0, 2]  # no indicator


def test_an_indicator_shows_the_response_low_passed(tmp_path: Path) -> None:
    protocol = disk(tmp_path).protocols()[1]
    name = "opplod_reference"
    settings = at_native_size([name], f"{name}.receptive_field=24")
    plain, seen = (present(protocol, settings, 1, constant_s)[name] for constant_s in (0.0, 0.5))
    expected = low_passed(plain.response, plain.time_s, 0.5)
    unknown = np.isnan(plain.response)
    assert unknown.any()
    np.testing.assert_array_equal(np.isnan(seen.response), unknown)
    np.testing.assert_array_equal(seen.response[~unknown], expected[~unknown])
    assert np.nanmax(seen.response) < 0.7 * np.nanmax(plain.response)
