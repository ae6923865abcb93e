"""What pages say, without a browser."""

from __future__ import annotations

import base64
import io
import json
import re
import shutil
import sys
import time
from typing import TYPE_CHECKING, Any

import av
import numpy as np
import pytest

from oppload_cli.cli import running
from oppload_cli.errors import OutputError, ResultError
from oppload_cli.models.registry import detector_named
from oppload_cli.pipeline.task import Interrupted, Outcome
from oppload_cli.processes import threads
from oppload_cli.report import writing
from oppload_cli.report.content import Content, RelativeCurve
from oppload_cli.report.writing import write_report
from oppload_cli.results.result_files import read_result
from oppload_cli.stimulus import ground_truth, load
from oppload_cli.video.source import source_of
from oppload_cli.video.writers import Recording
from tests.cli.inside import oppload
from tests.report.make import (
    ALARMS,
    BOX,
    FIRST,
    LAST,
    TIMES_MS,
    number_of,
    sidecar_of,
    write_clip,
    write_numbered_result,
    write_sidecar,
)
from tests.results.make import frame_rows, write_result, write_rows

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

    from oppload_cli.video.frames import Picture
ROWS = LAST - FIRST + 1


@pytest.fixture
def table(tmp_path: Path) -> Path:
    return write_numbered_result(tmp_path)


def data_of(page: Path) -> dict[str, Any]:
    found = re.search(r'<script type="application/json" id="data">(.*?)</script>', page.read_text())
    assert found
    data: dict[str, Any] = json.loads(found[1])
    return data


def film_of(page: Path) -> bytes:
    found = re.search(r'id="film">(.*?)</script>', page.read_text())
    return base64.b64decode(found[1]) if found else b""


def test_curves_alarms_and_boxes(table: Path) -> None:
    content = Content.of(read_result(table))
    opplod, dlgmd = content.curves
    assert (opplod.name, dlgmd.name) == ("opplod", "dlgmd")
    on = [any(first <= frame <= last for first, last in ALARMS) for frame in range(FIRST, LAST + 1)]
    np.testing.assert_allclose(opplod.values, np.where(on, 10, 0.04))
    np.testing.assert_allclose(dlgmd.values[1:], 0.01 * np.arange(FIRST + 1, LAST + 1))
    assert np.isnan(dlgmd.values[0])
    assert [(a.first, a.last, a.frame, a.peak) for a in content.alarms] == [
        (first - FIRST, last - FIRST, first, 10) for first, last in ALARMS
    ]
    assert content.alarms[0].start_s == TIMES_MS[8] / 1000
    assert [alarm.end_s for alarm in content.alarms[:-1]] == [
        TIMES_MS[last + 1] / 1000 for _, last in ALARMS[:-1]
    ]
    assert content.alarms[0].contact_s == (TIMES_MS[9] - TIMES_MS[8]) / 1000 + 0.5
    assert [alarm.contact_s for alarm in content.alarms[1:]] == [None] * (len(content.alarms) - 1)
    assert sorted(content.boxes) == [8 - FIRST, 9 - FIRST, 10 - FIRST]
    number, x, y, width, height, centre_x, centre_y, _, alarm = BOX
    assert content.boxes[9 - FIRST] == [
        [x, y, width, height, centre_x, centre_y, number, alarm, 0.5]
    ]
    assert content.strongest is opplod
    assert content.notes == []


def test_without_detections_the_boxes_are_those_of_the_table(table: Path) -> None:
    table.with_name("clip.detections.jsonl").unlink()
    boxes = Content.of(read_result(table)).boxes
    assert len(boxes) == ROWS
    assert boxes[0] == [[10, 20, 40, 30, None, None, None, False, None]]
    assert boxes[8 - FIRST][0][7]


def test_a_detector_without_an_alarm_is_drawn_over_its_peak(table: Path) -> None:
    lines = [line.split(",") for line in table.read_text().splitlines()]
    at = lines[0].index("dlgmd_threshold")
    assert lines[0][at + 1] == "dlgmd_alarm"
    table.write_text("".join(",".join(cells[:at] + cells[at + 2 :]) + "\n" for cells in lines))
    content = Content.of(read_result(table))
    assert [curve.thresholded for curve in content.curves] == [True, False]
    assert content.curves[1].peak == 1
    assert "no alarm of D-LGMD" in content.notes[0]
    table.write_text(table.read_text().replace(",0.5,0.05,1,", ",0.03,0.05,1,"))
    content = Content.of(read_result(table))
    assert content.strongest.name == "opplod"
    assert content.strongest.peak == pytest.approx(0.6)


def test_a_response_just_below_the_threshold_is_not_rounded_to_it(table: Path) -> None:
    table.write_text(table.read_text().replace(",0.5,0.05,1,", ",0.0499999,0.05,0,"))
    content = Content.of(read_result(table))
    assert content.strongest.peak == pytest.approx(0.999998, abs=1e-7)
    assert max(content.data()["curves"][0]["values"]) == 0.9999


def test_alarms_that_are_off_are_not_called_silent(table: Path) -> None:
    lines = [line.split(",") for line in table.read_text().splitlines()]
    kept = [at for at, name in enumerate(lines[0]) if not name.endswith(("_threshold", "_alarm"))]
    table.write_text("".join(",".join(cells[at] for at in kept) + "\n" for cells in lines))
    index = write_report([table, table], table.parent).first.read_text()
    assert index.count('<span class="none">off</span>') == 2
    assert index.count('data-peak=""') == 2
    assert "<line" not in index
    page = table.with_name("clip.report.html").read_text()
    assert "<p>alarms are off; each curve is divided by its peak." in page
    assert "<p>Alarms are off.</p>" in page


def test_a_response_above_the_threshold_without_an_alarm_is_explained(table: Path) -> None:
    table.write_text(table.read_text().replace(",0.5,0.05,1,", ",0.5,0.05,0,"))
    content = Content.of(read_result(table))
    assert content.alarms == []
    assert "did not count" in content.reason
    index = write_report([table, table], table.parent).first.read_text()
    reason = (
        "did not count: it came at the start, a cut, a flash, the end of a rest or after a gap, or "
        "was too short"
    )
    assert index.count(f'title="{reason}">not counted<') == 2


def test_a_peak_outside_the_alarms_is_explained(table: Path) -> None:
    rows = table.read_text().splitlines()
    rows[1] = rows[1].replace(",0.002,0.05,0,", ",0.9,0.05,0,")
    table.write_text("".join(f"{row}\n" for row in rows))
    content = Content.of(read_result(table))
    assert (len(content.alarms), content.strongest.peak) == (len(ALARMS), 18)
    assert content.reason.startswith(", which did not count: it came at the start, a cut,")
    assert content.reason.endswith(" or came soon after an alarm, or was too short")


def test_the_index_names_the_colours_of_the_detectors_once(table: Path) -> None:
    index = write_report([table, table], table.parent).first.read_text()
    legend = index[index.index('<p class="legend">') : index.index("</header>")]
    assert re.findall(r'fill="([^"]+)"[^>]*></svg> ([^<]+)<', legend) == [
        (detector_named(name).colour, detector_named(name).label) for name in ("opplod", "dlgmd")
    ]


@pytest.mark.parametrize(("left_out", "named"), [((), True), (("dlgmd",), False)])
def test_an_alarm_in_the_index_names_its_detector_if_there_are_several(
    left_out: tuple[str, ...], named: bool, tmp_path: Path
) -> None:
    rows = [
        {key: cell for key, cell in row.items() if not key.startswith(left_out)}
        for row in frame_rows()
    ]
    tables = [write_rows(tmp_path / f"{name}.frames.csv", rows) for name in "ab"]
    index = write_report(tables, tmp_path).first.read_text()
    chips = re.findall(r'class="chips"><a [^>]*>([^<]*)</a>', index)
    assert chips == ["OppLoD 1.35 s" if named else "1.35 s"] * 2


def test_the_index_is_in_the_order_of_alarms_and_peaks(tmp_path: Path) -> None:
    tables = []
    for name, response, alarm in (("a", 0.9, 0), ("b", 0.5, 1), ("c", 0.7, 1)):
        tables.append(write_numbered_result(tmp_path, name))
        written = tables[-1].read_text()
        tables[-1].write_text(written.replace(",0.5,0.05,1,", f",{response},0.05,{alarm},"))
    frames = read_result(tables[2]).frames
    frames.loc[:1, "dlgmd_alarm"] = 1  # before the alarms of the other detector
    frames.to_csv(tables[2], index=False)
    alarms = Content.of(read_result(tables[2])).alarms
    assert [span.curve.name for span in alarms] == ["dlgmd", "opplod", "opplod"]
    index = write_report(tables, tmp_path).first.read_text()
    found = re.findall(r'data-title="(.)\.mkv" data-count="(\d)"[^>]*data-duration="(.*?)"', index)
    assert [row[:2] for row in found] == [("c", "3"), ("b", "2"), ("a", "0")]
    steps_ms = np.diff(TIMES_MS[FIRST : LAST + 1])
    length_s = (steps_ms.sum() + np.median(steps_ms)) / 1000  # the last frame has a usual length
    assert [float(row[2]) for row in found] == pytest.approx([length_s] * 3)
    # 240 wide and 48 high, from 100 times the threshold at 2 to 0.01 of it at 46.
    times = np.array([0.0, 0.1, 1, 1.001, 2, 3])
    values = np.array([np.nan, 0.001, 1, 0.1, 100, 10])
    curve = RelativeCurve("opplod", "OppLoD", "#000000", values, thresholded=True)
    assert writing._spark(curve, times) == "M8 46.0L80 24.0L160 2.0L239 13.0"


def test_a_table_that_was_cut_is_told(table: Path) -> None:
    content = sidecar_of(table.with_name("clip.mkv"))
    content["decode"] = {"analysed": ROWS}
    write_sidecar(table, content)
    assert Content.of(read_result(table)).notes == []
    table.write_text("".join(table.read_text().splitlines(keepends=True)[:-3])[:-4])
    said = f"the table lacks 4 of the run's {ROWS} rows; run it again"
    for command in ("report", "plot"):
        done = oppload(command, table, *(["-j", "1"] if command == "report" else []))
        assert (done.returncode, said in done.stderr) == (0, True)
    assert said.replace("'", "&#39;") in table.with_name("clip.report.html").read_text()


def test_remarks_of_the_run_are_on_the_page(table: Path) -> None:
    content = sidecar_of(table.with_name("clip.mkv"))
    said = "5 frames/s are too few for the models"
    content["remarks"] = [said]
    write_sidecar(table, content)
    assert Content.of(read_result(table)).notes == [said]
    assert said in write_report([table], table.parent).first.read_text()
    content["remarks"] = "damaged"
    write_sidecar(table, content)
    assert Content.of(read_result(table)).notes == []


def test_settings_are_words(table: Path) -> None:
    content = sidecar_of(table.with_name("clip.mkv"))
    content["tool"] = {"libraries": {"numpy": "2.0", "av": "18"}}
    content["decode"] = {"complete": True, "messages": [], "damaged": False}
    write_sidecar(table, content)
    settings = Content.of(read_result(table)).settings()
    assert settings["tool"] == {"libraries": "numpy 2.0, av 18"}
    assert settings["decode"] == {"complete": "yes", "messages": "none", "damaged": "no"}


@pytest.mark.parametrize(
    "coding", [{}, {"codec": "libx264", "pixel_format": "yuv420p", "options": {"crf": "10"}}]
)
def test_the_copy_holds_the_frames_of_the_result_at_the_times_of_the_page(
    coding: dict[str, Any], table: Path
) -> None:
    clip = write_clip(table.with_name("clip.mkv"), **coding)
    write_sidecar(table, sidecar_of(clip))
    report = write_report([table], table.parent)
    assert (report.index, report.failures, report.notes) == (None, [], [])
    page = report.first
    times = data_of(page)["video"]["times"]
    assert times == pytest.approx(
        [(TIMES_MS[f] - TIMES_MS[FIRST]) / 1000 for f in range(FIRST, LAST + 1)]
    )
    film = page.with_name("film.mp4")
    film.write_bytes(film_of(page))
    with av.open(str(film)) as container:
        frames = list(container.decode(video=0))
    assert [frame.time for frame in frames] == pytest.approx(times)
    shown = [number_of(frame.to_ndarray(format="gray")[40]) for frame in frames]
    assert shown == list(range(FIRST, LAST + 1))


def test_the_same_result_gives_the_same_page(table: Path) -> None:
    first, second = (write_report([table], table.parent / name).first for name in ("a", "b"))
    assert first.read_bytes() == second.read_bytes()


def test_nothing_in_a_page_leads_to_a_network(table: Path) -> None:
    page = write_report([table], table.parent).first.read_text()
    assert "default-src 'none'" in page.replace("&#39;", "'")
    # In the notes of the chart's licence, and the name of SVG, which is not fetched.
    addresses = set(re.findall(r"https?://[^\s\"')]+", page))
    assert addresses <= {"https://github.com/leeoniya/uPlot", "http://www.w3.org/2000/svg"}
    assert "Copyright (c) 2022 Leon Sorokin" in page


def test_a_long_video_stands_beside_the_page(table: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(writing, "MOST_EMBEDDED", 100)
    page = write_report([table], table.parent / "out").first
    assert film_of(page) == b""
    assert data_of(page)["video"]["address"] == "./clip.report.mp4"
    assert page.with_name("clip.report.mp4").stat().st_size > 100
    assert not list(page.parent.glob("*.part"))


def test_the_copy_of_a_long_video_is_smaller(table: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def size() -> tuple[int, int]:
        with av.open(io.BytesIO(film_of(write_report([table], table.parent).first))) as copy:
            return copy.streams.video[0].width, copy.streams.video[0].height

    width, height = size()
    monkeypatch.setattr(writing, "MANY_FRAMES", LAST + 1 - FIRST)
    monkeypatch.setattr(writing, "SIDE_OF_MANY", width // 2)
    assert size() == (width // 2, height // 2)


def test_a_video_is_not_closed_while_a_thread_decodes_it(
    table: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Closing it under the thread would end the process by a signal."""
    used: list[bool] = []

    class Slow:
        def __init__(self, *arguments: Any) -> None:
            self._source, self._used, self.stopping = source_of(*arguments), False, False
            self.facts, self.decode = self._source.facts, self._source.decode

        def pictures(self) -> Iterator[Picture]:
            for picture in self._source.pictures():
                self._used = True
                while picture.index > FIRST and not self.stopping:
                    time.sleep(0.01)
                self._used = False
                yield picture

        def finish(self) -> None:
            self._source.finish()

        def close(self) -> None:
            used.append(self._used)
            self._source.close()

    def interrupt(*_: object) -> float:
        raise KeyboardInterrupt

    monkeypatch.setattr(writing, "source_of", Slow)
    monkeypatch.setattr(Recording, "write", interrupt)
    monkeypatch.setattr(threads, "_JOIN_WITHIN_S", 60)  # on a busy machine the thread ends late
    with pytest.raises(KeyboardInterrupt):
        write_report([table], table.parent)
    assert used == [False]
    assert not list(table.parent.glob("*.part"))


@pytest.mark.parametrize("kind", ["gone", "camera", "unknown", "broken", "another"])
def test_a_page_without_its_video_says_why(kind: str, table: Path) -> None:
    clip = table.with_name("clip.mkv")
    content = sidecar_of(clip)
    if kind == "gone":
        clip.unlink()
    elif kind == "camera":
        content["input"] |= {"kind": "camera", "name": "camera:0"}
    elif kind == "unknown":
        content = {}
    elif kind == "broken":
        clip.write_bytes(b"no video")
    else:
        content["input"]["bytes"] += 1
    write_sidecar(table, content)
    report = write_report([table], table.parent)
    expected = {
        "gone": f"the page has no video ({clip}: is not found; say where it is with --video (in ",
        "camera": "no video (camera:0: frames of a camera or a stream are not kept)",
        "unknown": "no video (no sidecar names the video of this result; name it with --video",
        "broken": f"no video ({clip}: not a video that can be read",
        "another": f"{clip}: is not the video of the run (bytes was",
    }[kind]
    assert any(expected in note for note in report.notes)
    assert expected.replace("'", "&#39;") in report.first.read_text()
    assert (data_of(report.first)["video"] is None) == (kind != "another")


def test_a_video_that_has_moved(table: Path) -> None:
    away = table.parent / "away"
    away.mkdir()
    shutil.move(table.with_name("clip.mkv"), away / "clip.mkv")
    for videos in (away, away / "clip.mkv"):
        page = write_report([table], table.parent, videos=videos).first
        assert data_of(page)["video"]["times"][0] == 0


def test_frames_that_are_not_there_any_more_have_no_time(table: Path) -> None:
    rows = table.read_text().splitlines()
    last = rows[-1].split(",")
    more = [",".join([str(19 + i), str(0.9 + i), *last[2:]]) for i in range(3)]
    table.write_text("\n".join([*rows, *more]) + "\n")
    report = write_report([table], table.parent)
    assert data_of(report.first)["video"]["times"][-2:] == [None, None]
    assert "2 frames of the result could not be decoded again" in report.notes[0]


def test_ground_truth_is_drawn(tmp_path: Path) -> None:
    truth = ground_truth(load("klapoetke2017/loom-l-over-v/l-over-v-40"))
    path = write_rows(tmp_path / "clip.frames.csv", frame_rows(50)[10:])  # as with --start
    (tmp_path / "clip.stimulus.json").write_text(json.dumps(truth))
    data = data_of(write_report([path], tmp_path).first)
    (sizes,) = data["truth"]["sizes"].values()
    for row in (0, 20, 39):
        assert sizes[row] == pytest.approx(
            truth["frames"][10 + row]["objects"][0]["angular_size_deg"], rel=1e-5
        )
    assert data["truth"]["contacts"] == pytest.approx([2.2])
    (tmp_path / "clip.stimulus.json").write_text('{"schema": "x"}')
    report = write_report([path], tmp_path)
    assert data_of(report.first)["truth"] is None
    assert "the ground truth of its stimulus cannot be read" in report.first.read_text()


def test_the_contact_of_each_object_is_marked(tmp_path: Path) -> None:
    truth = ground_truth(load("controls/two-looming-disks"))
    path = write_result(tmp_path / "clip.frames.csv")
    (tmp_path / "clip.stimulus.json").write_text(json.dumps(truth))
    data = data_of(write_report([path], tmp_path).first)
    assert data["truth"]["contacts"] == pytest.approx([1.6, 2.2])


def test_an_interrupted_run(table: Path) -> None:
    part = table.with_name("clip.frames.csv.part")
    part.write_text(table.read_text() + "18,0.4,0.")
    table.unlink()
    report = write_report([part], table.parent)
    assert report.first.name == "clip.report.html"
    assert "the run was interrupted" in report.first.read_text()
    assert len(data_of(report.first)["time"]) == ROWS


@pytest.mark.parametrize(
    ("name", "content", "message"),
    [
        ("clip.frames.csv", "frame,time_s\n1,x\n", "has no column 'opplod_response'"),
        ("clip.frames.csv", "\0\1", "run"),
        ("clip.oppload.json", '{"schema": "oppload.result/0"}', "is of schema oppload.result/0"),
        ("clip.oppload.json", "{", "is not a sidecar that can be read"),
        ("clip.detections.jsonl", "[]\n", "is not valid JSON Lines"),
        ("clip.detections.jsonl", '{"frame": 8}\n', "not a detection"),
        (
            "clip.detections.jsonl",
            '{"frame": 8, "x": 0, "y": 0, "width": NaN, "height": 9}\n',
            "not a detection",
        ),
    ],
)
def test_damaged_files(name: str, content: str, message: str, table: Path) -> None:
    table.with_name(name).write_text(content)
    with pytest.raises(ResultError, match=re.escape(message)) as caught:
        write_report([table], table.parent)
    assert name.partition(".")[0] in str(caught.value)


def test_one_damaged_result_does_not_stop_the_others(table: Path) -> None:
    table.with_name("broken.frames.csv").write_text("x\n")
    done = oppload("report", table.parent, "-j", "1")
    assert done.returncode == 4
    assert "broken.frames.csv: holds no row" in done.stderr
    index = table.with_name("index.html")
    assert done.stdout.splitlines() == [str(index)]
    assert "broken.frames.csv: holds no row" in index.read_text()
    assert index.read_text().count("<tr data-title") == 1


def test_wrong_use(table: Path, tmp_path: Path) -> None:
    empty = tmp_path / "empty"
    empty.mkdir()
    assert "holds no result" in oppload("report", empty).stderr
    other = write_numbered_result(empty)
    done = oppload("report", table, other)
    assert (done.returncode, "several folders" in done.stderr) == (2, True)
    mine = tmp_path / "out" / "index.html"
    mine.parent.mkdir()
    mine.write_text("<h1>my own page</h1>")
    call = ("report", table, other, "--output", mine.parent, "-j", "1")
    done = oppload(*call)
    assert (done.returncode, "was not made by oppload" in done.stderr) == (2, True)
    mine.unlink()
    for _ in range(2):  # the second replaces the first
        assert oppload(*call).returncode == 0
    pages = sorted(path.name for path in mine.parent.iterdir())
    assert pages == ["clip-2.report.html", "clip.report.html", "index.html"]
    with pytest.raises(OutputError, match="cannot be written"):
        write_report([table], table)


@pytest.mark.long
def test_a_run_with_a_report(tmp_path: Path) -> None:
    clip = write_numbered_result(tmp_path, "one").with_name("one.mkv")
    out = tmp_path / "out"
    done = oppload("run", clip, "-o", out, "--report", "--no-rmo", "-j", "1")
    assert (done.returncode, done.stdout) == (0, "")
    assert data_of(out / "one.report.html")["frames"] == list(range(20))
    shutil.copy(clip, tmp_path / "two.mkv")
    both = (clip, tmp_path / "two.mkv")
    more = ("--report", "--if-exists", "skip", "--no-rmo", "-j", "1")
    done = oppload("run", *both, "-o", out, *more)
    assert f"page: {out / 'index.html'}" in done.stderr
    assert (out / "index.html").read_text().count("<tr data-title") == 2
    if sys.platform == "linux":  # as with --show of `plot`
        assert "needs a display" in oppload("report", out, "--show").stderr
    for wrong in (("-o", "-"), ("--shard", "1/2")):
        assert oppload("run", clip, "--report", *wrong).returncode == 2


def test_a_run_that_is_too_short_for_a_page_keeps_its_files(tmp_path: Path) -> None:
    clip = write_numbered_result(tmp_path, "one").with_name("one.mkv")
    more = ("--end", "f2", "--report", "--no-rmo", "-j", "1")
    done = oppload("run", clip, "-o", tmp_path / "out", *more)
    assert done.returncode == 4
    assert "column 'opplod_response' is empty in every row" in done.stderr
    assert (tmp_path / "out" / "one.frames.csv").exists()


def test_an_interrupted_run_says_how_to_make_the_pages(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    table = write_numbered_result(tmp_path, "one")
    told = f"interrupted: all 7 rows are kept; 'oppload report {tmp_path}' makes the pages\n"

    def stopped(*_arguments: object, **_options: object) -> None:
        raise Interrupted("all 7 rows are kept", Outcome())  # as a camera is stopped

    monkeypatch.setattr(running, "run_task", stopped)
    command = ("run", table.with_name("one.mkv"), "-o", tmp_path, "--if-exists", "overwrite")
    assert told not in oppload(*command).stderr
    assert told in oppload(*command, "--report").stderr
    table.unlink()
    assert "makes the pages" not in oppload(*command, "--report").stderr


@pytest.mark.long
def test_a_retry_makes_an_index_of_all_results(tmp_path: Path) -> None:
    clip, out = write_numbered_result(tmp_path, "one").with_name("one.mkv"), tmp_path / "out"
    late = tmp_path / "two.mkv"
    more = ("--report", "--no-rmo", "-j", "1")
    done = oppload("run", clip, late, "-o", out, *more)
    assert done.returncode == 4
    shutil.copy(clip, late)
    assert oppload("run", clip, late, "-o", out, *more, "--if-exists", "skip").returncode == 0
    assert (out / "index.html").read_text().count("<tr data-title") == 2


@pytest.mark.long
def test_the_index_tells_of_inputs_that_failed_and_of_incomplete_ones(tmp_path: Path) -> None:
    (tmp_path / "clips").mkdir()
    for name in ("one", "two"):
        write_clip(tmp_path / "clips" / f"{name}.mkv")
    whole = (tmp_path / "clips" / "two.mkv").read_bytes()
    (tmp_path / "clips" / "two.mkv").write_bytes(whole[: len(whole) * 2 // 3])
    (tmp_path / "clips" / "three.mkv").write_bytes(b"no video")
    out, more = tmp_path / "out", ("--no-rmo", "-j", "1", "-q")
    assert oppload("run", tmp_path / "clips", "-o", out, "--report", *more).returncode == 4
    index = out / "index.html"
    assert "<summary>1 result without a page</summary>" in index.read_text()
    assert "three.mkv: not a video" in index.read_text()
    # Also later, and of the parts of a batch; an input with a result has a page.
    listed = (out / "failures.csv").read_text()
    (out / "failures-2-of-2.csv").write_text(listed.replace("three", "one"))
    assert oppload("report", out, "-j", "1", "-q").returncode == 0
    assert "<summary>1 result without a page</summary>" in index.read_text()
    found = re.findall(r">(\w+).mkv</a>(?: <span[^>]*>(\w+)</span>)?</td>", index.read_text())
    assert sorted(found) == [("one", ""), ("two", "incomplete")]
    # An index of chosen results holds these alone, and that of folders the failures of each.
    assert oppload("report", *out.glob("*.frames.csv"), "-j", "1", "-q").returncode == 0
    assert "without a page" not in index.read_text()
    (out / "failures.csv").rename(tmp_path / "clips" / "failures.csv")
    copied = tmp_path / "clips" / "one.frames.csv"
    copied.write_bytes((out / "one.frames.csv").read_bytes())
    (out / "failures-2-of-2.csv").unlink()
    assert oppload("report", out, copied.parent, "-o", out, "-j", "1", "-q").returncode == 0
    assert "<summary>1 result without a page</summary>" in index.read_text()


def titles_in(index: Path) -> dict[str, str]:
    """Return the title of each address in an index."""
    cells = re.findall(r'<td class="name"><a href="([^"]+)">([^<]+)</a>', index.read_text())
    return dict(sorted(cells))


@pytest.mark.long
def test_pages_lie_beside_their_results(tmp_path: Path) -> None:
    """Two videos of one name in two folders; a third one changes no name."""
    clips = tmp_path / "v"
    for place in ("x", "y"):
        (clips / place).mkdir(parents=True)
        write_clip(clips / place / "a.mkv")
    out, more = tmp_path / "rv", ("--report", "--if-exists", "skip", "--no-rmo", "-j", "1", "-q")
    assert oppload("run", "-r", clips, "-o", out, *more).returncode == 0
    both = {"./x/a.report.html": "x/a.mkv", "./y/a.report.html": "y/a.mkv"}
    assert titles_in(out / "index.html") == both
    for place in ("x", "y"):
        page = (out / place / "a.report.html").read_text()
        assert f"<h1>{place}/a.mkv</h1>" in page
        assert '<a href="./../index.html">All videos</a>' in page
        assert data_of(out / place / "a.report.html")["frames"] == list(range(20))
    (clips / "w").mkdir()
    shutil.copy(clips / "x" / "a.mkv", clips / "w" / "a.mkv")
    shutil.copy(clips / "x" / "a.mkv", clips / "w" / "only.mkv")
    assert oppload("run", "-r", clips, "-o", out, *more).returncode == 0
    joined = {"./w/a.report.html": "w/a.mkv", "./w/only.report.html": "only.mkv", **both}
    assert titles_in(out / "index.html") == joined
    assert len(list(out.rglob("*.report.html"))) == 4
    # The same of the results alone, here and elsewhere.
    for folder in (out, tmp_path / "pages"):
        assert oppload("report", out, "-o", folder, "-j", "1", "-q").returncode == 0
        assert titles_in(folder / "index.html") == joined
    assert sorted((tmp_path / "pages").iterdir()) == [
        tmp_path / "pages" / name for name in ("index.html", "w", "x", "y")
    ]
    two = tmp_path / "two"
    done = oppload("report", out / "x", out / "y", "-o", two, "-j", "1", "-q")
    assert (done.returncode, titles_in(two / "index.html")) == (0, both)
    # The page of a single table lies in the folder of the pages itself.
    mixed = tmp_path / "mixed"
    alone = out / "y" / "a.frames.csv"
    assert oppload("report", out / "x", alone, "-o", mixed, "-j", "1", "-q").returncode == 0
    assert sorted(titles_in(mixed / "index.html")) == ["./a-2.report.html", "./a.report.html"]


def test_pages_in_one_folder_have_the_inputs_as_titles(table: Path, tmp_path: Path) -> None:
    (tmp_path / "other").mkdir()
    other = write_numbered_result(tmp_path / "other")
    index = write_report([table, other], tmp_path / "out").index
    assert index
    assert titles_in(index) == {
        "./clip-2.report.html": str(tmp_path / "other" / "clip.mkv"),
        "./clip.report.html": str(tmp_path / "clip.mkv"),
    }


def test_numbers_as_text(table: Path) -> None:
    times = (0.366, 59.99, 119.996, 187.25, 188, 189, 190)
    heights = (0.0, 8e-5, 0.0123, 4.23, 12.34, 1234.5, 0.99996)  # over a threshold of 0.05
    rows = ["frame,time_s,opplod_response,opplod_threshold,opplod_alarm", "0,0,0,0.05,0"]
    for at, (time_s, height) in enumerate(zip(times, heights, strict=True)):
        rows.append(f"{2 * at + 1},{time_s},{height * 0.05:.9g},0.05,1")
        rows.append(f"{2 * at + 2},{time_s + 0.001},0,0.05,0")
    table.write_text("".join(f"{row}\n" for row in rows))
    table.with_name("clip.detections.jsonl").unlink()
    index = write_report([table, table], table.parent).first.read_text()
    shown = re.findall(r'title="OppLoD: ([^"]+) times the threshold">([^<]+)<', index)
    assert [text for _, text in shown[:4]] == ["0.37 s", "59.99 s", "2:00.00", "3:07.25"]
    numbers = ["0", "&lt; 0.01", "0.012", "4.2", "12", "1,234", "0.99"]
    assert [text for text, _ in shown[:7]] == numbers
    (curve,) = data_of(table.with_name("clip.report.html"))["curves"]
    assert curve["values"][13] == 0.9999
