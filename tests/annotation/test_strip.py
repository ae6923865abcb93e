from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import pytest

from oppload_cli.annotation.history import History
from oppload_cli.annotation.layout import layout_of
from oppload_cli.annotation.strip import column_of, draw_ground, draw_strip, level_row
from oppload_cli.palette import COLOURS, bgr
from tests.annotation.records import facts, record

if TYPE_CHECKING:
    from oppload_cli.results.record import FrameRecord

LAYOUT = layout_of(facts(1280, 720))
OPPLOD, DLGMD = bgr(COLOURS["opplod"]), bgr(COLOURS["dlgmd"])
WHITE = (255, 255, 255)


def drawn(records: list[FrameRecord]) -> tuple[np.ndarray, History]:
    canvas = np.zeros((LAYOUT.height, LAYOUT.width, 3), np.uint8)
    history = History(list(records[0].responses))
    for each in records:
        history.add(each)
    draw_ground(canvas, LAYOUT)
    draw_strip(canvas, LAYOUT, history, records[-1])
    assert not canvas[: LAYOUT.picture.height].any()
    return canvas, history


def near(pixel: np.ndarray, paint: tuple[int, int, int], by: int = 2) -> bool:
    return bool(np.abs(pixel.astype(int) - np.array(paint)).max() <= by)


def test_levels_are_logarithmic_about_the_threshold() -> None:
    rows = [level_row(ratio, LAYOUT) for ratio in (1000, 10**2.5, 100, 10, 1, 0.1, 0.01, 0)]
    assert rows[0] == rows[1] == 2 * LAYOUT.line
    assert rows[-1] == rows[-2] == LAYOUT.plot.height - 1 - 2 * LAYOUT.line
    assert np.diff(rows[2:6]) == pytest.approx([(rows[-1] - rows[0]) / 4] * 3)


def test_the_threshold_is_a_dark_line_across_the_plot() -> None:
    canvas, _ = drawn([record(frame) for frame in range(30)])
    plot = canvas[LAYOUT.plot.slices]
    row = round(level_row(1, LAYOUT))
    assert (plot[row, 200:] == 34).all()
    assert (plot[row - 4, 200:] == 255).all()


def test_the_curves_pass_through_their_values() -> None:
    ratios = [0.1 * 1.1**frame for frame in range(90)]
    canvas, history = drawn(
        [record(t, {"opplod": ratio, "dlgmd": 0.3}) for t, ratio in enumerate(ratios)]
    )
    plot = canvas[LAYOUT.plot.slices]
    for frame in (10, 45, 80):
        column = round(column_of(frame / 30, LAYOUT, history))
        assert near(plot[round(level_row(ratios[frame], LAYOUT)), column], OPPLOD, 12)
        assert near(plot[round(level_row(0.3, LAYOUT)), column], DLGMD, 12) or frame == 10
    assert column_of(5, LAYOUT, history) == LAYOUT.plot.width - 1 - 2 * LAYOUT.line
    # Nothing yet where the window is not filled.
    later = plot[: round(level_row(1, LAYOUT)) - 4, round(column_of(3.2, LAYOUT, history)) :]
    assert not np.any([near(pixel, OPPLOD, 30) for pixel in later.reshape(-1, 3)[::7]])


def test_a_response_without_threshold_is_a_gap() -> None:
    records = [record(t, {"opplod": None if 20 <= t < 40 else 5.0}) for t in range(60)]
    canvas, history = drawn(records)
    plot, row = canvas[LAYOUT.plot.slices], round(level_row(5, LAYOUT))
    assert near(plot[row, round(column_of(10 / 30, LAYOUT, history))], OPPLOD, 12)
    gap = round(column_of(33 / 30, LAYOUT, history))
    assert near(plot[row, gap], WHITE)
    assert near(plot[round(level_row(0, LAYOUT)), gap], WHITE)
    assert near(plot[row, round(column_of(50 / 30, LAYOUT, history))], OPPLOD, 12)


@pytest.mark.parametrize(
    ("models", "paint"),
    [({"opplod"}, OPPLOD), ({"dlgmd"}, DLGMD), ({"opplod", "dlgmd"}, OPPLOD)],
)
def test_alarms_are_shaded_and_signed(models: set[str], paint: tuple[int, int, int]) -> None:
    on = dict.fromkeys(models, True)
    records = [record(t, alarms=on if 30 <= t < 60 else {}) for t in range(90)]
    canvas, history = drawn(records)
    plot = canvas[LAYOUT.plot.slices]
    blue, green, red = (round(0.75 * 255 + 0.25 * value) for value in paint)
    tint = (blue, green, red)
    # From the first frame with the alarm to the first one without.
    first, last = (round(column_of(t, LAYOUT, history)) for t in (1, 2))
    assert near(plot[2, first - 3], WHITE)
    assert near(plot[2, first + 3], tint)
    assert near(plot[2, last - 3], tint)
    assert near(plot[2, last + 3], WHITE)
    header = canvas[LAYOUT.header.y : LAYOUT.plot.y]
    solid = (header == np.array(paint)).all(axis=2).sum()
    during, _ = drawn(records[:50])
    sign = during[LAYOUT.header.y : LAYOUT.plot.y]
    assert (sign == np.array(paint)).all(axis=2).sum() > solid + 2000
    # The edge of the picture is of the alarm's colour too.
    assert near(during[LAYOUT.header.y, 5], paint)
    assert near(canvas[LAYOUT.header.y, 5], (153, 153, 153))


def test_a_model_alone_is_shown_alone() -> None:
    canvas, _ = drawn([record(t, {"dlgmd": 0.5}) for t in range(9)])
    assert not (canvas == np.array(OPPLOD)).all(axis=2).any()
    assert (canvas == np.array(DLGMD)).all(axis=2).any()
