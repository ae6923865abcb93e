"""A detector that somebody adds: one class and one line, and every command knows of it."""

from __future__ import annotations

import inspect
import json
import shutil
from dataclasses import dataclass
from fractions import Fraction
from typing import TYPE_CHECKING, Any, ClassVar

import av
import numpy as np
import pytest

import oppload_cli
from oppload_cli import AlarmParams, AlarmRule, Box, Column, Detector, Response, alarm_params
from oppload_cli.annotation.frame import Layout
from oppload_cli.cli import main
from oppload_cli.errors import DetectorError, ParameterError
from oppload_cli.models import registry
from oppload_cli.models.bank import DetectorBank
from oppload_cli.palette import bgr
from oppload_cli.schema import Parameters, parameter
from tests.annotation.records import facts
from tests.cli.inside import oppload
from tests.media import disk, write_video
from tests.results.make import rows_of
from tests.tuning.test_tuning import DISK

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

    from numpy.typing import NDArray

    from oppload_cli.models.dpc import Map
Row = dict[str, str]


@dataclass(frozen=True, kw_only=True)
class ToyParams(Parameters):
    least: float = parameter(0.1, "darkening from which a pixel counts", low=0, high=1)


@dataclass(frozen=True)
class ToyResponse(Response):
    darkest: float = 0.0
    count: int = 0


class Toy(Detector):
    name, label, colour = "toy", "Toy", "#AA00AA"
    meaning = "share of the pixels that darkened since the frame before"
    columns = (Column("darkest", "0 to 1", "largest darkening of a pixel"),)
    details = (Column("count", "px", "how many pixels darkened"),)
    parameters, responses, places = ToyParams, ToyResponse, True
    year, reference, answers_to, made_for, cost_ms = 2021, "Somebody", "darkening", "tests", 0.5
    alarm: ClassVar = AlarmRule(0.02)
    before: Map | None = None

    def reset(self) -> None:
        self.before = None

    def step(self, luma: Map) -> Response | None:
        before, self.before = self.before, luma.copy()
        if before is None:
            return None
        y, x = np.nonzero(before - luma > self.params.least)  # type: ignore[attr-defined]
        if len(x) == 0:
            return ToyResponse(0.0)
        box = Box(*map(float, (x.min(), y.min(), np.ptp(x) + 1, np.ptp(y) + 1)))
        return ToyResponse(len(x) / luma.size, box, float((before - luma).max()), len(x))


SIDE, STILL, FRAMES = 120, 4, 44
FLOOR = 0.02
CX, CY = 50, 66


def approach() -> list[NDArray[np.uint8]]:
    """A speck that moves, stands still, moves on, and then a disk that grows."""
    shown = []
    for t in range(FRAMES):
        at = 10 + (t if t < 8 else max(8, t - STILL))
        frame = disk(SIDE, CX, CY, max(0, 3 * (t - 30)))
        frame[100:106, at : at + 6] = 0
        shown.append((frame * 255).round().astype(np.uint8))
    return shown


@pytest.fixture(scope="module", autouse=True)
def _registered() -> Iterator[None]:
    registry.register(Toy)
    yield
    registry.forget("toy")


def done(*arguments: str | Path) -> None:
    with pytest.raises(SystemExit) as ended:
        main([str(argument) for argument in arguments])
    assert ended.value.code == 0


@pytest.fixture(scope="module")
def clip(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_video(tmp_path_factory.mktemp("clips") / "clip.avi", approach())


@pytest.fixture(scope="module")
def result(clip: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("result")
    done("run", clip, "-o", folder, "-q", "--model", "toy", "--height", "native", "--annotate")
    return folder


def rows(folder: Path) -> list[Row]:
    return rows_of(folder / "clip.frames.csv")


def test_it_is_one_short_class() -> None:
    parts = (ToyParams, ToyResponse, Toy)
    assert sum(len(inspect.getsourcelines(part)[0]) for part in parts) <= 30


def test_its_columns_stand_in_the_table(result: Path) -> None:
    table = rows(result)
    own = [name for name in table[0] if name.startswith("toy_")]
    assert own == [
        *("toy_response", "toy_threshold", "toy_alarm"),
        *("toy_x", "toy_y", "toy_width", "toy_height"),
        *("toy_unit_x", "toy_unit_y", "toy_contact_s", "toy_darkest"),
    ]
    assert not any("opplod" in name for name in table[0])
    model = Toy((SIDE, SIDE))
    for row, frame in zip(table, approach(), strict=True):
        answer = model.step(frame.astype(np.float32) / np.float32(255))
        if answer is None:
            assert [row[name] for name in own] == ["", str(FLOOR), "0", *[""] * (len(own) - 3)]
            continue
        assert isinstance(answer, ToyResponse)
        assert float(row["toy_response"]) == pytest.approx(answer.response, rel=1e-8)
        assert float(row["toy_darkest"]) == pytest.approx(answer.darkest, rel=1e-8)
        box = [row[f"toy_{side}"] for side in ("x", "y", "width", "height")]
        expected = [""] * 4 if answer.box is None else [f"{side:g}" for side in answer.box]
        if row["toy_response"] != "0":  # a repeat has no object
            assert box == expected
    # Where the speck stands still frames repeat: nothing answers there.
    assert [row["toy_response"] for row in table[9 : 8 + STILL]] == ["0"] * (STILL - 1)


def test_its_inner_values_have_columns_where_all_are_wanted(
    clip: Path, tmp_path: Path, result: Path
) -> None:
    shown = oppload(
        "run", clip, "-o", tmp_path, "-q", "--model", "toy,frame_difference", "--height",
        "native", "--no-rmo", "--columns", "all",
    )  # fmt: skip
    assert (shown.returncode, shown.stderr) == (0, "")
    table = rows(tmp_path)
    usual = [name for name in rows(result)[0] if name.startswith("toy_")]
    own = [name for name in table[0] if name.startswith("toy_")]
    assert own == [
        *(*usual, "toy_count", "toy_over_threshold"),
        *("toy_evidence_over_threshold", "toy_contact_error_s"),
    ]
    over = [float(row["toy_over_threshold"]) for row in table[1:]]
    at_floor = [float(row["toy_response"]) / FLOOR for row in table[1:]]
    assert max(over) > 1
    assert over[:10] == pytest.approx(at_floor[:10])
    assert "frame_difference_response" in table[0]
    for row in table[1:]:
        assert int(row["toy_count"]) == round(float(row["toy_response"]) * SIDE**2)
    assert json.loads((tmp_path / "clip.oppload.json").read_text())["columns"] == "all"
    frames = tmp_path / "frames.csv"
    assert oppload("collect", tmp_path, "--frames", "-o", frames).returncode == 0
    assert [row["toy_count"] for row in rows_of(frames)] == [row["toy_count"] for row in table]


def test_wrong_columns_and_models_are_refused() -> None:
    wrong = oppload("run", "clip.avi", "--columns", "most")
    assert wrong.returncode == 2
    assert "columns must be 'usual' or 'all', not 'most'" in wrong.stderr
    wrong = oppload("run", "clip.avi", "--model", "opplod,tooy")
    assert wrong.returncode == 2
    assert "no model 'tooy'; did you mean 'toy'" in wrong.stderr


def test_all_models_have_one_name() -> None:
    shown = oppload("config", "--model", "all", "--model", "toy").stdout
    assert f"models = {json.dumps(list(registry.detectors()))}  # command line" in shown


def test_frames_that_are_too_small_are_refused(
    clip: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(Toy, "least_size", (64, 96))
    wrong = oppload("run", clip, "-o", tmp_path, "-q", "--model", "toy", "--height", "63")
    reason = (
        "model 'toy' needs frames of at least 96 x 64 px, not 63 x 63; raise the working height"
    )
    assert (wrong.returncode, reason in wrong.stderr) == (2, True)
    assert list(tmp_path.iterdir()) == []


def test_its_settings_and_its_summary_stand_in_the_sidecar(result: Path) -> None:
    sidecar: dict[str, Any] = json.loads((result / "clip.oppload.json").read_text())
    assert sidecar["models"] == ["toy"]
    assert sidecar["parameters"]["toy"] == {"least": 0.1}
    assert sidecar["parameters"]["alarm"]["toy_floor"] == FLOOR
    responses = [float(row["toy_response"] or 0) for row in rows(result)]
    summary = sidecar["summary"]["toy"]
    assert summary["frames"] == FRAMES - 1
    assert summary["peak"] == pytest.approx(max(responses), rel=1e-8)
    assert summary["peak_frame"] == int(np.argmax(responses))
    assert summary["alarm_frames"] == sum(row["toy_alarm"] == "1" for row in rows(result)) > 0


def test_its_alarm_goes_on_above_its_own_floor(result: Path) -> None:
    table = rows(result)
    above = [row for row in table if float(row["toy_response"] or 0) > FLOOR]
    first = next(row for row in table if row["toy_alarm"] == "1")
    assert first == above[0]
    assert int(first["frame"]) > 30  # not the speck's


@pytest.mark.parametrize(("floor", "code"), [("0.5", 0), ("0.02", 5)])
def test_the_floor_is_a_setting(clip: Path, tmp_path: Path, floor: str, code: int) -> None:
    shown = oppload(
        "run", clip, "-o", tmp_path, "-q", "--model", "toy", "--height", "native",
        "--no-rmo", "--fail-on", "alarm", "--set", f"alarm.toy_floor={floor}",
    )  # fmt: skip
    assert (shown.returncode, shown.stderr) == (code, "")
    on = [row["frame"] for row in rows(tmp_path) if row["toy_alarm"] == "1"]
    assert bool(on) == (code == 5)


def test_its_parameters_are_settings(clip: Path, tmp_path: Path) -> None:
    arguments = ("run", clip, "-o", tmp_path, "-q", "--model", "toy", "--height", "native")
    assert oppload(*arguments, "--set", "toy.least=1").returncode == 0
    assert {row["toy_response"] for row in rows(tmp_path)} == {"", "0"}
    wrong = oppload(*arguments, "--set", "toy.lest=1")
    assert "no parameter 'lest' of toy; did you mean 'least'" in wrong.stderr


@dataclass(frozen=True, kw_only=True)
class KindsParams(ToyParams):
    grid: tuple[int, int] = parameter((3, 4), "rows and columns", unit="px", low=1)
    rate: Fraction = parameter(Fraction(1, 30), "rate")
    polarity: str = parameter("dark", "what counts", choices=("dark", "bright"))
    on: bool = parameter(True, "whether")
    word: str = parameter("", "a word")


class Kinds(Toy):
    name, label, parameters = "kinds", "Kinds", KindsParams


def test_its_parameters_may_be_of_several_kinds(clip: Path, tmp_path: Path) -> None:
    changed = {"grid": [5, 6], "rate": "1/25", "polarity": "bright", "on": False, "word": "λ 😀"}
    texts = ("grid=5,6", "rate=1/25", "polarity=bright", "on=false", "word=λ 😀")
    words = [word for text in texts for word in ("--set", f"kinds.{text}")]
    given = {f"kinds.{name}": value for name, value in changed.items()}
    given["kinds.grid"] = np.array([5, 6])
    registry.register(Kinds)
    try:
        assert oppload("models", "kinds").stdout.splitlines()[-7:] == [
            "  least        0.1     darkening from which a pixel counts (0 to 1)",
            "  grid      [3, 4] px  rows and columns (at least 1)",
            "  rate        1/30     rate",
            "  polarity    dark     what counts (dark, bright)",
            "  on          True     whether",
            "  word                 a word",
            "",
        ]
        described = json.loads(oppload("models", "kinds", "--json").stdout)["parameters"]["kinds"]
        assert [entry["default"] for entry in described] == [0.1, [3, 4], "1/30", "dark", True, ""]
        printed = oppload("config", "--model", "kinds", *words).stdout
        (tmp_path / "kinds.toml").write_text(printed, encoding="utf-8")
        for settings in (words, ["--config", tmp_path / "kinds.toml"]):
            folder = tmp_path / str(settings[0])
            done("run", clip, "-o", folder, "-q", "--model", "kinds", "--fov", "60", *settings)
            sidecar = json.loads((folder / "clip.oppload.json").read_text())
            assert sidecar["parameters"]["kinds"] == {"least": 0.1, **changed}
        result = oppload_cli.run(clip, models=["kinds"], settings=given)
        assert result.sidecar["parameters"]["kinds"] == {"least": 0.1, **changed}
    finally:
        registry.forget("kinds")


def test_its_curve_has_its_label_and_its_colour(result: Path, tmp_path: Path) -> None:
    figure = tmp_path / "curve.svg"
    assert oppload("plot", result / "clip.frames.csv", "-o", figure).returncode == 0
    drawn = figure.read_text()
    assert "<!-- Toy, " in drawn
    assert f"stroke: {Toy.colour.lower()}" in drawn
    assert "OppLoD" not in drawn


def test_its_box_is_drawn_in_its_colour(result: Path) -> None:
    layout = Layout.of(facts(SIDE, SIDE))
    paint = np.array(bgr(Toy.colour))
    with av.open(str(result / "clip.annotated.mp4")) as container:
        frames = [picture.to_ndarray(format="bgr24") for picture in container.decode(video=0)]
    for row, frame in zip(rows(result), frames, strict=True):
        picture = frame[layout.picture.slices]
        painted = np.abs(picture.astype(int) - paint).max(axis=2) < 60
        assert painted.any() == (row["toy_alarm"] == "1" and row["toy_x"] != "")
        if not painted.any():
            continue
        left, top = (float(row[f"toy_{side}"]) for side in ("x", "y"))
        right, bottom = left + float(row["toy_width"]), top + float(row["toy_height"])
        scale, middle = layout.scale_x, round(layout.scale_y * (top + bottom) / 2) + 20
        across = np.flatnonzero(painted[middle]) / scale
        assert (across.min(), across.max()) == pytest.approx((left, right), abs=1.5)
        down = np.flatnonzero(painted[:, round(scale * (left + right) / 2) + 20]) / scale
        assert down.max() == pytest.approx(bottom, abs=1.5)


def test_its_detections_are_listed(result: Path) -> None:
    lines = (result / "clip.detections.jsonl").read_text().splitlines()
    found = {listed["frame"]: listed for listed in map(json.loads, lines)}
    for row in rows(result):
        assert (int(row["frame"]) in found) == (row["toy_x"] != "")
    last = found[FRAMES - 1]
    assert (last["centre_x"], last["centre_y"]) == pytest.approx((CX, CY), abs=1)
    assert last["alarm"] is True


def test_it_has_a_line_in_a_tuning(tmp_path: Path) -> None:
    held = "motion_s = 0.6\nafter_s = 0.1"  # a curve of peaks in the last frame would be grey
    (tmp_path / "disk.toml").write_text(DISK.format(before=0).replace("motion_s = 0.6", held))
    done = oppload(
        "tune", tmp_path / "disk.toml", "-o", tmp_path, "--height", "native", "--jobs",
        "1", "--model", "toy", "--plot", "svg",
    )  # fmt: skip
    assert (done.returncode, done.stderr) == (0, "")
    found = rows_of(tmp_path / "disk.tuning.csv")
    assert [row["model"] for row in found] == ["toy"] * 3
    peaks = [float(row["peak"]) for row in found]
    assert 0 < peaks[0] < peaks[1] < peaks[2]  # the faster the disk, the more
    assert found[0]["centre_x"] != ""
    content = json.loads((tmp_path / "disk.tuning.json").read_text())
    assert content["parameters"]["toy"] == {"least": 0.1}
    drawn = (tmp_path / "disk.tuning.svg").read_text()
    assert "<!-- Toy" in drawn
    assert f"stroke: {Toy.colour.lower()}" in drawn


@pytest.mark.usefixtures("undrawn")
def test_it_has_rows_in_an_evaluation(clip: Path, tmp_path: Path) -> None:
    write_video(tmp_path / "speck.avi", approach()[:30])
    shutil.copy(clip, tmp_path / "clip.avi")
    (tmp_path / "manifest.csv").write_text(
        "file,label,onset_frame,contact_frame\nclip.avi,looming,31,43\nspeck.avi,none,,\n"
    )
    done = oppload(
        "evaluate", tmp_path / "manifest.csv", "-o", tmp_path / "out", "-j", "1",
        "--draws", "100", "--model", "opplod_reference",
    )  # fmt: skip
    assert (done.returncode, "Toy" in done.stderr) == (0, True)
    own = {
        (row["measure"], row["condition"]): float(row["value"])
        for row in rows_of(tmp_path / "out" / "evaluation.csv")
        if row["contender"] == "toy" and row["value"]
    }
    assert own["detection_rate", "alarm as shipped"] == 1
    assert own["false_alarms_per_minute", "alarm as shipped"] == 0
    responses = rows_of(tmp_path / "out" / "responses.csv")
    last = [row for row in responses if row["contender"] == "toy" and row["clip"] == "clip.avi"][-1]
    assert last["alarm"] == "true"
    assert float(last["x"]) + float(last["width"]) / 2 == pytest.approx(CX, abs=1)
    report = json.loads((tmp_path / "out" / "report.json").read_text())
    assert report["contenders"]["toy"]["meaning"] == Toy.meaning
    assert report["contenders"]["toy"]["parameters"] == {"least": 0.1}
    assert report["contenders"]["toy"]["alarm"]["toy_floor"] == FLOOR
    assert ">Toy<" in (tmp_path / "out" / "evaluation.html").read_text()


def test_one_model_is_described_and_measured() -> None:
    text = oppload("models", "toy").stdout
    assert "source: Somebody, 2021\n" in text
    assert "responds to: darkening\n" in text
    assert "made for: tests\n" in text
    assert "cost: about 0.5 ms per frame of its working size on one core\n" in text
    assert "opplod" not in text
    assert "working height: 240 px\n" in text
    name, cost, unit = oppload("models", "toy", "--measure").stdout.split(maxsplit=2)
    assert (name, unit) == ("toy", "ms per frame\n")
    assert float(cost) >= 0
    unknown = oppload("models", "tooy")
    assert "no detector or settings 'tooy'; did you mean 'toy'" in unknown.stderr


def test_it_is_among_the_models() -> None:
    text = oppload("models").stdout
    assert [line.split() for line in text.splitlines() if "toy" in line] == [
        ["toy", "0.5", "darkening"]
    ]
    text = oppload("models", "toy", "alarm").stdout
    assert f"toy  ({Toy.meaning})" in text
    assert "darkening from which a pixel counts" in text
    assert f"alarm: above {FLOOR}, and 8 times the median of the background\n" in text
    described = json.loads(oppload("models", "--json").stdout)
    assert described["models"]["toy"] == {
        "label": "Toy", "meaning": Toy.meaning, "by_default": False, "places": True,
        "year": 2021, "reference": "Somebody", "answers_to": "darkening", "made_for": "tests",
        "cost_ms": 0.5, "height": 240, "interval": "1/30",
        "alarm": {
            "floor": FLOOR, "factor": 8.0, "enough_s": 0.0, "window_s": 0.0, "why_none": "",
        },
    }  # fmt: skip
    (entry,) = described["parameters"]["toy"]
    assert (entry["name"], entry["default"]) == ("least", 0.1)


def test_its_settings_are_printed_and_read_again(tmp_path: Path) -> None:
    printed = oppload("config", "--model", "toy", "--set", "toy.least=0.25").stdout
    assert 'models = ["toy"]  # command line' in printed
    assert "[toy]\nleast = 0.25  # command line\n" in printed
    assert f"toy_floor = {FLOOR}  # default" in printed
    (tmp_path / "toy.toml").write_text(printed)
    again = oppload("config", "--config", tmp_path / "toy.toml").stdout
    assert f"least = 0.25  # {tmp_path / 'toy.toml'}" in again


def test_it_runs_beside_the_others(clip: Path, tmp_path: Path) -> None:
    names = list(registry.detectors())
    done = oppload(
        "run", clip, "-o", tmp_path, "-q", "--height", "native", "--no-rmo",
        *(word for name in names for word in ("--model", name)),
    )  # fmt: skip
    assert (done.returncode, done.stderr) == (0, "")
    header = list(rows(tmp_path)[0])
    responses = [name for name in header if name.endswith("_response")]
    assert responses == [f"{name}_response" for name in names]
    # OppLoD comes first among the detectors with places: its objects are listed.
    assert registry.placing_detector(names) is registry.detector_named("opplod")


def test_without_its_line_nothing_knows_of_it() -> None:
    registry.forget("toy")
    try:
        assert "toy" not in oppload("models").stdout
        assert "toy" not in oppload("config").stdout
        unknown = oppload("run", "clip.avi", "--model", "toy")
        assert (unknown.returncode, "no model 'toy'" in unknown.stderr) == (2, True)
        assert alarm_params().rule_of("opplod") == AlarmParams().rule_of("opplod")
    finally:
        registry.register(Toy)


def test_a_column_that_its_answers_lack_is_an_error(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(Toy, "responses", Response)
    with pytest.raises(
        ParameterError, match="its column 'darkest' must be a field of its responses"
    ):
        registry.register(Toy)


def test_an_answer_of_another_class_is_an_error(monkeypatch: pytest.MonkeyPatch) -> None:
    bank = DetectorBank((9, 9), [ToyParams()])
    monkeypatch.setattr(Toy, "step", lambda *_: Response(0.0))
    with pytest.raises(DetectorError, match="step returned Response, not a ToyResponse or None"):
        bank.step(np.zeros((9, 9), np.float32))


@dataclass(frozen=True, kw_only=True)
class LowParams(Parameters):
    pass


class Low(Detector):
    """It is made for frames of 120 rows, and says what it got."""

    name, label, colour, parameters = "low", "Low", "#00AAAA", LowParams
    meaning, height, places = "the darkest place of a small frame", 120, True
    alarm: ClassVar = AlarmRule(0.5, factor=0.0)
    columns = (Column("rows", "px", "height of the frame"),)

    @dataclass(frozen=True)
    class LowResponse(Response):
        rows: int = 0

    responses = LowResponse

    def reset(self) -> None:
        pass

    def step(self, luma: Map) -> Response:
        rows, columns = luma.shape
        row, column = divmod(int(luma.argmin()), columns)
        return self.LowResponse(1 - float(luma.min()), Box(column, row, 1, 1), rows)


def test_a_detector_may_have_a_working_height_of_its_own(tmp_path: Path) -> None:
    """OppLoD beside it gets its own frames, and answers as it does alone."""
    registry.register(Low)
    try:
        grey = [np.full((360, 480), 200 - 10 * t, np.uint8) for t in range(20)]
        for t, frame in enumerate(grey):
            frame[180 : 180 + 6 * t, 240 : 240 + 6 * t] = 0 if t > 5 else 150
        path = write_video(tmp_path / "clip.mkv", grey)
        for name in ("opplod", "opplod,low"):
            shown = oppload("run", path, "-o", tmp_path / name, "-q", "--model", name)
            assert (shown.returncode, shown.stderr) == (0, "")
        alone, beside = (
            rows_of(tmp_path / name / "clip.frames.csv") for name in ("opplod", "opplod,low")
        )
        for row, other in zip(alone, beside, strict=True):
            assert row == {name: other[name] for name in row}
        assert max(float(row["opplod_response"] or 0) for row in alone) > 0
        for t, row in enumerate(beside):
            assert row["low_rows"] == "120"
            if t > 5:  # a black square of t x t working pixels; a working pixel has 3 x 3
                place = [float(row[f"low_{side}"]) for side in ("x", "y", "width", "height")]
                assert place == [240, 180, 3, 3]
                assert (row["low_unit_x"], row["low_unit_y"]) == ("241.5", "181.5")
        assert [row["low_alarm"] for row in beside] == ["0"] * 11 + ["1"] * 9  # not while blind
        sidecar = json.loads((tmp_path / "opplod,low" / "clip.oppload.json").read_text())
        assert sidecar["height"] == "auto"
    finally:
        registry.forget("low")
