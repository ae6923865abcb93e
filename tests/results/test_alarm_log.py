"""Alarms one by one: from records, to the sidecar and back, in words and in alarms.csv."""

from __future__ import annotations

import json
import math
from typing import TYPE_CHECKING

import pytest

from oppload_cli.detection.places import Detection
from oppload_cli.errors import BusyError
from oppload_cli.files import atomic
from oppload_cli.models.detector import Box
from oppload_cli.models.opplod import OpplodResponse
from oppload_cli.results import alarm_log
from oppload_cli.results.alarm_log import (
    AlarmLog,
    Verdict,
    in_words,
    times,
    verdicts_in,
    write_alarms,
)
from oppload_cli.results.record import DetectorRecord, FrameRecord
from tests.results.make import rows_of

if TYPE_CHECKING:
    from collections.abc import Mapping
    from pathlib import Path


def verdict(
    responses: list[float],
    on: list[int],
    blind: tuple[int, ...] = (),
    *,
    cause: str = "rest",
    threshold: float | tuple[float, ...] = 2.0,
    contacts: Mapping[int, float] = {4: 0.6},
    hidden: tuple[int, ...] = (),
) -> Verdict:
    """Return the verdict; `threshold` holds in all frames, or is one for each.

    `contacts` has times to contact in s by frame; frames in `hidden` have no object.
    """
    log = AlarmLog("opplod")
    for t, response in enumerate(responses):
        place = Detection(1, Box(t, 0, 9, 9), 4.0, 4.0, response, True, contacts.get(t))
        log.add(
            FrameRecord(
                t,
                t / 10,
                0.0,
                {
                    "opplod": DetectorRecord(
                        OpplodResponse(response, opponency=response / 4, growth=0.5),
                        t in on,
                        threshold[t] if isinstance(threshold, tuple) else threshold,
                        objects=() if t in hidden else (place,),
                    )
                },
                blind=cause * (t in blind),
            )
        )
    return log.verdict


def test_an_alarm_has_its_times_its_peak_its_box_and_the_time_to_contact() -> None:
    found = verdict([0, 1, 3, 8, 5, 0, 0, 4, 0], on=[2, 3, 4, 7])
    first, second = found.alarms
    assert (first.start_frame, first.start_s, first.end_s) == (2, 0.2, 0.4)
    assert (first.peak_over_threshold, first.box) == (4, [3, 0, 9, 9])
    assert math.isclose(first.time_to_contact_s or 0, 0.4 - 0.2 + 0.6)
    assert (second.start_frame, second.end_s, second.peak_over_threshold) == (7, 0.7, 2)
    assert second.time_to_contact_s is None
    assert str(found) == (
        "alarm at 0.20 s (frame 2, contact estimated 0.8 s later), 2 alarms, "
        "response up to 4 times the threshold (growth 0.5/s, opponency 2)"
    )


def test_the_first_time_to_contact_of_an_alarm_counts_from_its_start() -> None:
    (alarm,) = verdict([0, 3, 3, 3], on=[1, 2, 3], contacts={2: 0.5, 3: 0.8}).alarms
    assert alarm.time_to_contact_s == pytest.approx(0.2 - 0.1 + 0.5)


def test_of_equal_peaks_the_first_one_gives_the_box() -> None:
    (alarm,) = verdict([0, 3, 3, 1], on=[1, 2, 3]).alarms
    assert (alarm.peak_over_threshold, alarm.box) == (1.5, [1, 0, 9, 9])
    # A larger response without an object leaves the box of the one before.
    (alarm,) = verdict([0, 3, 5, 1], on=[1, 2, 3], hidden=(2,)).alarms
    assert (alarm.peak_over_threshold, alarm.box) == (2.5, [1, 0, 9, 9])


def test_an_alarm_below_its_threshold_has_its_reason() -> None:
    constant = [0.25, 0.25, 0.25]  # with a floor of 0 it alarms before a background is known
    assert str(verdict(constant, on=[0, 1, 2], threshold=(0.0, 2.0, 2.0))) == (
        "alarm at 0.00 s (frame 0), response up to 0.12 times the threshold, but above the "
        "threshold when the alarm began (growth 0.5/s, opponency 0.062)"
    )
    assert str(verdict(constant, on=[0, 1, 2], threshold=0.0)) == (
        "alarm at 0.00 s (frame 0), response above a threshold of 0"
    )


def test_multiples_have_no_exponent() -> None:
    assert [times(value) for value in (0.26, 99.4, 99.5, 1207)] == ["0.26", "99", "100", "1207"]
    # A response below the threshold is not told as one at the threshold.
    assert [times(value) for value in (0.0099, 0.0101)] == ["<0.01", "0.01"]
    assert [times(value) for value in (0.994, 0.9999, 1.0, 1.004)] == ["0.99", "0.99", "1", "1"]


def test_no_alarm_tells_how_near_it_came() -> None:
    silent = verdict([0, 0.5, 0], on=[])
    assert (str(silent), silent.strongest) == ("no alarm, peak at 0.25 of the threshold", 0.25)
    for cause, words in (
        ("start", "at the start"),
        ("cut", "at a cut or a flash"),
        ("rest", "at the end of a rest"),
        ("gap", "after a gap"),
    ):
        silent = verdict([0, 0.5, 9], on=[], blind=(2,), cause=cause)
        assert str(silent) == (
            f"no alarm, peak at 4.5 times the threshold, which did not count: it came {words}"
        )
        assert verdicts_in({"alarms": {"opplod": silent.as_dict()}}) == (silent,)
    assert verdict([0, 9, 9], on=[], blind=(1,)).peak_blind == "rest"  # of the first peak
    assert str(verdict([0, 8, 0, 9], on=[], blind=(1,))) == (
        "no alarm, peak at 4.5 times the threshold, which did not count: it was too short"
    )
    assert verdict([0, 5], on=[], threshold=math.inf).peak is None
    assert str(verdict([0, 5], on=[], threshold=math.inf)) == "no alarm"


def test_a_peak_outside_the_alarms_is_told_with_its_reason() -> None:
    """The strongest alarm is not the peak, which the table of many inputs shows."""
    begin = "alarm at 0.20 s (frame 2), response up to 1.5 times the threshold"
    found = [verdict([0, 9, 3], on=[2], blind=blind, cause="start") for blind in ((1,), ())]
    found.append(found[0]._replace(peak_blind=None))
    assert list(map(str, found)) == [
        f"{begin} (the peak is 4.5 times, which did not count: it came {why}) "
        "(growth 0.5/s, opponency 0.75)"
        for why in (
            "at the start",
            "soon after an alarm, or was too short",
            "at the start, a cut, a flash, the end of a rest or after a gap, or came soon after an "
            "alarm, or was too short",
        )
    ]


def test_many_verdicts_are_one_line() -> None:
    assert in_words([verdict([0], []), verdict([3], [0])]) == (
        "OppLoD no alarm; OppLoD alarm at 0.00 s (frame 0), response up to 1.5 times the threshold "
        "(growth 0.5/s, opponency 0.75)"
    )


def test_they_come_back_from_a_sidecar_and_a_second_batch_adds_rows(tmp_path: Path) -> None:
    found = verdict([0, 3, 0], on=[1])
    sidecar = json.loads(json.dumps({"alarms": {"opplod": found.as_dict()}}))
    assert verdicts_in(sidecar) == (found,)
    path = tmp_path / "alarms.csv"
    stems = {"b.mp4": "b", "a.mp4": "a", "./a.mp4": "a", "c.mp4": "c"}
    write_alarms(path, {"b.mp4": [found], "a.mp4": [found]}, stems)
    path.write_text(path.read_text(), encoding="utf-8-sig")  # as spreadsheets save it
    # A second run may name its inputs otherwise.
    write_alarms(path, {"c.mp4": [found], "./a.mp4": [found]}, stems)
    write_alarms(path, {"c.mp4": [verdict([0], [])]}, stems)
    rows = rows_of(path)
    assert [row["video"] for row in rows] == ["./a.mp4", "b.mp4"]
    assert rows[0] == {
        "result": "a", "video": "./a.mp4", "model": "opplod", "start_frame": "1", "start_s": "0.1",
        "end_s": "0.1", "peak_over_threshold": "1.5", "x": "1", "y": "0", "width": "9",
        "height": "9", "time_to_contact_s": "",
    }  # fmt: skip


def test_of_two_batches_that_end_at_the_same_time_none_loses_rows(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path, found = tmp_path / "alarms.csv", [verdict([0, 3, 0], on=[1])]
    stems = {"a.mp4": "a", "b.mp4": "b"}
    monkeypatch.setattr(atomic, "_DYING_S", 0)

    def read_later(_: Path, _columns: object) -> list[dict[str, str]]:
        with pytest.raises(BusyError):
            write_alarms(path, {"a.mp4": found}, stems)
        return []

    monkeypatch.setattr(alarm_log, "rows_of", read_later)
    write_alarms(path, {"b.mp4": found}, stems)


def test_a_second_batch_replaces_rows_of_a_name_that_no_text_can_hold(tmp_path: Path) -> None:
    path = tmp_path / "alarms.csv"
    name = "a\udcff\n.mp4"
    for _ in range(2):
        write_alarms(path, {name: [verdict([0, 3, 0], on=[1])]}, {name: "a\udcff"})
    rows = rows_of(path)
    assert [row["video"] for row in rows] == [r"a\udcff\n.mp4"]
