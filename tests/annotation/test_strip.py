from __future__ import annotations

import math
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
import pytest

from oppload_cli.annotation.frame import Layout, Strip
from oppload_cli.models.registry import detector_named, detectors
from oppload_cli.palette import bgr, ink_of
from tests.annotation.records import facts, paint_of, record, texts_of, with_threshold

if TYPE_CHECKING:
    from oppload_cli.results.record import FrameRecord

LAYOUT = Layout.of(facts(1280, 720))
BOTH = ("opplod", "dlgmd")
OPPLOD, DLGMD = (paint_of(name) for name in BOTH)
DARK, SHADED, WHITE = (34,) * 3, (236,) * 3, (255,) * 3


def drawn(records: list[FrameRecord]) -> tuple[np.ndarray, Strip]:
    canvas = np.zeros((LAYOUT.height, LAYOUT.width, 3), np.uint8)
    strip = Strip(LAYOUT, list(records[0].detectors))
    for earlier in records[:-1]:
        strip.add(earlier)
    strip.draw(canvas, records[-1])
    assert not canvas[: LAYOUT.picture.height].any()
    return canvas, strip


def near(pixel: np.ndarray, paint: tuple[int, int, int], by: int = 2) -> bool:
    return bool(np.abs(pixel.astype(int) - np.array(paint)).max() <= by)


def test_levels_are_logarithmic_about_the_threshold() -> None:
    rows = [LAYOUT.level_row(ratio) for ratio in (1000, 10**2.5, 100, 10, 1, 0.1, 0.01, 0)]
    assert rows[0] == rows[1] == 2 * LAYOUT.line
    assert rows[-1] == rows[-2] == LAYOUT.plot.height - 1 - 2 * LAYOUT.line
    assert np.diff(rows[2:6]) == pytest.approx([(rows[-1] - rows[0]) / 4] * 3)


def test_the_threshold_is_a_dark_line_across_the_plot() -> None:
    canvas, _ = drawn([record(frame) for frame in range(30)])
    plot = canvas[LAYOUT.plot.slices]
    row = round(LAYOUT.level_row(1))
    assert (plot[row, 200:] == 34).all()
    assert (plot[row - 4, 200:] == 255).all()


def test_the_curves_pass_through_their_values() -> None:
    ratios = [0.1 * 1.1**frame for frame in range(90)]
    canvas, strip = drawn(
        [record(t, {"opplod": ratio, "dlgmd": 0.3}) for t, ratio in enumerate(ratios)]
    )
    plot = canvas[LAYOUT.plot.slices]
    for frame in (10, 45, 80):
        column = round(strip.column_of(frame / 30))
        assert near(plot[round(LAYOUT.level_row(ratios[frame])), column], OPPLOD, 12)
        assert near(plot[round(LAYOUT.level_row(0.3)), column], DLGMD, 12) or frame == 10
    assert strip.column_of(5) == LAYOUT.plot.width - 1 - 2 * LAYOUT.line
    # The window is empty after the latest frame.
    later = plot[: round(LAYOUT.level_row(1)) - 4, round(strip.column_of(3.2)) :]
    assert not np.any([near(pixel, OPPLOD, 30) for pixel in later.reshape(-1, 3)[::7]])


def test_a_time_far_away_is_drawn_without_a_warning() -> None:
    times = {1: 8388607.22, 2: 1 / 15}  # as a damaged file may have them
    records = [replace(record(t), time_s=times.get(t, t / 30)) for t in range(6)]
    _, strip = drawn(records)
    assert strip.column_of(times[1]) > 1 << 27


def test_a_response_without_threshold_is_a_gap() -> None:
    records = [record(t, {"opplod": None if 20 <= t < 40 else 5.0}) for t in range(60)]
    canvas, strip = drawn(records)
    plot, row = canvas[LAYOUT.plot.slices], round(LAYOUT.level_row(5))
    assert near(plot[row, round(strip.column_of(10 / 30))], OPPLOD, 12)
    gap = round(strip.column_of(33 / 30))
    assert near(plot[row, gap], WHITE)
    assert near(plot[round(LAYOUT.level_row(0)), gap], WHITE)
    assert near(plot[row, round(strip.column_of(50 / 30))], OPPLOD, 12)


@pytest.mark.parametrize("models", [{"opplod"}, {"dlgmd"}, {"opplod", "dlgmd"}])
def test_alarms_are_shaded_and_signed_in_no_detectors_colour(models: set[str]) -> None:
    on = dict.fromkeys(models, True)
    records = [record(t, alarms=on if 30 <= t < 60 else {}) for t in range(90)]
    canvas, strip = drawn(records)
    plot = canvas[LAYOUT.plot.slices]
    # From the first frame with the alarm to the first one without.
    first, last = (round(strip.column_of(t)) for t in (1, 2))
    assert near(plot[2, first - 3], WHITE)
    assert near(plot[2, first + 3], SHADED)
    assert near(plot[2, last - 3], SHADED)
    assert near(plot[2, last + 3], WHITE)
    during, _ = drawn(records[:50])
    for name, paint in (("ALARM", DARK), ("opplod", OPPLOD), ("dlgmd", DLGMD)):
        before, sign = (
            (image[LAYOUT.header.y : LAYOUT.plot.y] == np.array(paint)).all(axis=2).sum()
            for image in (canvas, during)
        )
        assert (sign > before + 1000) == (name == "ALARM" or name in models)
    # The edge of the picture is dark and thick.
    edge = during[LAYOUT.header.y : LAYOUT.header.y + 2 * LAYOUT.line, 5]
    assert (edge == DARK).all()
    assert near(canvas[LAYOUT.header.y, 5], (153, 153, 153))


def test_labels_that_do_not_fit_are_counted_and_alarms_come_first() -> None:
    names = list(detectors())
    names = [name for name in names if len(set(paint_of(name))) > 1]  # other words are grey
    last = "emd_lplc2_gf"
    canvas, _ = drawn([record(0, dict.fromkeys(names, 0.5), {last: True})])
    header = canvas[LAYOUT.header.y + 2 * LAYOUT.line : LAYOUT.plot.y].astype(int)
    # OpenCV 4 draws letters of thin lines, whose pixels hold little of the plain colour.
    inks = {name: bgr(ink_of(detector_named(name).colour)) for name in names}
    inks[last] = paint_of(last)  # the ground of its label
    like = {name: np.abs(header - np.array(inks[name])).max(axis=2) <= 8 for name in names}
    shown = [name for name in names if like[name].sum() > 10]
    assert len(shown) < len(names)
    assert shown == [*names[: len(shown) - 1], last]
    # White columns divide the ground of the last label from the number of the others.
    end = like[last].any(axis=0).nonzero()[0].max()
    assert (header[:, end + 2 : end + LAYOUT.text // 2] == 255).all()
    assert (header[:, end + 2 :] < 255).any()
    # The labels stand to the right of the clock, the frame and the word ALARM.
    dark = (header == np.array(DARK)).all(axis=2).any(axis=0).nonzero()[0].max()
    assert dark < like[names[0]].any(axis=0).argmax()


@pytest.mark.parametrize(("name", "ink"), [("opplod", WHITE), ("dlgmd", WHITE), ("ci_lmd", DARK)])
def test_a_word_can_be_read_on_the_colour_of_its_detector(
    name: str, ink: tuple[int, int, int]
) -> None:
    canvas, _ = drawn([record(0, {name: 0.5}, {name: True})])
    header = canvas[LAYOUT.header.y + 2 * LAYOUT.line : LAYOUT.plot.y].astype(int)
    ground = (header == np.array(paint_of(name))).all(axis=2).any(axis=0).nonzero()[0]
    sign = header[header.shape[0] // 2 - 4 : header.shape[0] // 2 + 4, ground[0] : ground[-1] + 1]
    inks = {ink: (np.abs(sign - np.array(ink)).max(axis=2) <= 8).sum() for ink in (DARK, WHITE)}
    assert max(inks, key=lambda paint: inks[paint]) == ink


@pytest.mark.parametrize(
    ("colour", "ink"),
    [
        ("#D55E00", "#D55E00"),
        ("#BBC57A", "#91995e"),
        ("#FFFFFF", "#919191"),
        ("#000000", "#000000"),
    ],
)
def test_a_word_in_the_colour_of_its_detector_can_be_read_on_white(colour: str, ink: str) -> None:
    assert ink_of(colour) == ink


def test_the_curve_of_an_alarm_is_thicker() -> None:
    records = [record(t, {"opplod": 10.0}, {"opplod": 30 <= t < 60}) for t in range(90)]
    canvas, strip = drawn(records)
    thickness = []
    for second in (0.5, 1.5, 2.5):
        column = canvas[LAYOUT.plot.slices][:, round(strip.column_of(second))]
        thickness.append(sum(near(pixel, OPPLOD, 12) for pixel in column))
    assert thickness[0] == thickness[2] <= thickness[1] - 2


@pytest.mark.parametrize(
    ("window", "ticks"),
    [
        (5, ["0 s", "1 s", "2 s", "3 s", "4 s", "5 s"]),
        (3.1, ["0 s", "1 s", "2 s", "3 s"]),
        (3, ["0.0 s", "0.5 s", "1.0 s", "1.5 s", "2.0 s", "2.5 s", "3.0 s"]),
        (2.4, ["0.0 s", "0.5 s", "1.0 s", "1.5 s", "2.0 s"]),
        (0.93, ["0.0 s", "0.2 s", "0.4 s", "0.6 s", "0.8 s"]),
        (0.1, ["0.00 s", "0.02 s", "0.04 s", "0.06 s", "0.08 s", "0.10 s"]),
    ],
)
def test_ticks_are_at_round_times(
    window: float, ticks: list[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    strip = Strip(LAYOUT, BOTH, window)
    canvas = np.zeros((LAYOUT.height, LAYOUT.width, 3), np.uint8)
    texts = texts_of(monkeypatch, lambda: strip.draw(canvas, record(0)))
    assert [text for text in texts if text.endswith(" s")][1:] == ticks  # after the clock


def test_ticks_have_numbers_that_move_with_the_window() -> None:
    rows = slice(LAYOUT.plot.y + LAYOUT.plot.height, None)
    at = {}
    for frame in (150, 165, 180):
        canvas, strip = drawn([record(t) for t in range(frame + 1)])
        ink = np.flatnonzero((canvas[rows] < 200).any(axis=(0, 2)))
        centres = [LAYOUT.plot.x + strip.column_of(second) for second in (2, 3, 4)]
        at[frame] = centres[0]
        for centre in centres:
            near_it = ink[np.abs(ink - centre) < 3 * LAYOUT.text]
            assert near_it.mean() == pytest.approx(centre, abs=4)
    assert at[150] > at[165] > at[180]


def test_a_detector_that_runs_alone_is_shown_alone() -> None:
    canvas, _ = drawn([record(t, {"dlgmd": 0.5}) for t in range(9)])
    assert not (canvas == np.array(OPPLOD)).all(axis=2).any()
    assert (canvas == np.array(DLGMD)).all(axis=2).any()


def test_responses_are_divided_by_their_thresholds() -> None:
    strip = Strip(LAYOUT, BOTH)
    strip.add(record(0, {"opplod": 2.0, "dlgmd": None}, {"opplod": True}))
    assert list(strip.points["opplod"]) == [(0.0, 2.0, True)]
    assert list(strip.points["dlgmd"]) == [(0.0, None, False)]
    strip.add(with_threshold(record(1, dict.fromkeys(BOTH, 2.0)), 0.0))
    assert strip.points["opplod"][-1].ratio is None


def test_the_window_fills_and_then_moves() -> None:
    strip = Strip(LAYOUT, BOTH)
    starts = []
    for frame in range(301):
        strip.add(record(frame))
        starts.append(strip.start_s)
    assert starts[150] == 0
    assert starts[180] == pytest.approx(1)
    assert starts[300] == pytest.approx(5)
    # One frame from before the left edge, for the line that leads to it.
    assert strip.points["opplod"][0].time_s == pytest.approx(149 / 30)
    assert len(strip.points["opplod"]) == 152


def test_a_short_video_fills_the_window() -> None:
    assert Strip(LAYOUT, BOTH, 1.5).window_s == 1.5
    assert Strip(LAYOUT, BOTH, 60).window_s == Strip(LAYOUT, BOTH).window_s == 5
    assert Strip(LAYOUT, BOTH, 0.001).window_s == 0.1


def test_a_video_that_begins_late_begins_at_the_left_edge() -> None:
    strip = Strip(LAYOUT, BOTH)
    strip.add(record(90))
    assert strip.start_s == 3


def test_repeats_are_passed_over_and_a_scene_at_rest_is_not() -> None:
    strip = Strip(LAYOUT, ("opplod",))
    for frame in range(12):
        strip.add(
            record(
                frame, {"opplod": 0.0 if frame % 3 else 1.0}, repeat="exact" if frame % 3 else ""
            )
        )
    assert [point.ratio for point in strip.points["opplod"]] == [1, 1, 1, 1]
    for frame in range(12, 20):
        strip.add(record(frame, {"opplod": 0.0}, repeat="exact"))
    assert [point.ratio for point in strip.points["opplod"]][4:] == [0] * 5


def test_an_alarm_left_of_the_plot_shades_nothing() -> None:
    repeats = [record(frame, rate=0.5, repeat="exact") for frame in range(1, 6)]
    canvas, strip = drawn([record(0, alarms={"opplod": True}, rate=0.5), *repeats])
    assert strip.start_s == 5
    assert not (canvas[LAYOUT.plot.slices] == SHADED).all(axis=2).any()


def test_without_alarms_a_response_of_0_has_a_ratio_of_0_before_any_other() -> None:
    strip = Strip(LAYOUT, ["opplod"])
    for frame, value in enumerate((0.0, 2.0)):
        strip.add(with_threshold(record(frame, {"opplod": value}), math.inf))
    assert [point.ratio for point in strip.points["opplod"]] == [0, 1]


def test_without_alarms_responses_are_over_the_largest_so_far() -> None:
    records = [
        with_threshold(record(t, {"opplod": value}), math.inf)
        for t, value in enumerate([2.0, 1.0] * 15 + [20.0] + [5.0] * 29)
    ]
    canvas, strip = drawn(records[:30])
    assert [point.ratio for point in strip.points["opplod"]][:2] == [1, 0.5]
    canvas, strip = drawn(records)
    ratios = [point.ratio for point in strip.points["opplod"]]
    assert ratios == pytest.approx([0.1, 0.05] * 15 + [1] + [0.25] * 29)
    plot = canvas[LAYOUT.plot.slices]
    column = round(strip.column_of(50 / 30))
    assert near(plot[round(LAYOUT.level_row(0.25, strip.scale)), column], OPPLOD, 12)
    # The dark line is at the largest one, and not where the threshold would be.
    lines = {row: (plot[row, -50:] == 34).all() for row in range(len(plot))}
    assert lines[round(LAYOUT.level_row(1, strip.scale))]
    assert not lines[round(LAYOUT.level_row(1))]
    names = slice(LAYOUT.plot.y, LAYOUT.plot.y + LAYOUT.plot.height), slice(0, LAYOUT.plot.x - 2)
    usual, _ = drawn([record(t, {"opplod": 1.0}) for t in range(9)])
    assert (canvas[names] != usual[names]).any()
