from __future__ import annotations

import numpy as np
import pytest

from oppload_cli.annotation.frame import Layout, draw_detections
from oppload_cli.models.registry import detector_named
from oppload_cli.palette import bgr
from tests.annotation.records import detection, facts, texts_of

COLOUR = detector_named("opplod").colour
PAINT = bgr(COLOUR)


def drawn(*boxes: tuple[float, float, float, float], alarm: bool = False) -> np.ndarray:
    layout = Layout.of(facts(432, 240))  # shown at 864 x 480
    canvas = np.full((layout.height, layout.width, 3), 90, np.uint8)
    draw_detections(canvas, layout, [detection(box, alarm=alarm) for box in boxes], COLOUR)
    assert (canvas[layout.picture.height :] == 90).all()
    return canvas


def painted(canvas: np.ndarray, paint: tuple[int, int, int]) -> np.ndarray:
    mask: np.ndarray = (canvas == np.array(paint)).all(axis=2)
    return mask


@pytest.mark.parametrize(("alarm", "line"), [(False, 2), (True, 4)])
def test_an_alarm_doubles_the_lines_just_inside_the_edges(alarm: bool, line: int) -> None:
    mask = painted(drawn((100, 80, 120, 60), alarm=alarm), PAINT)
    # In twice the size: columns 200 to 440, rows 160 to 280; looked at away from the label.
    row, column = mask[220], mask[:, 400]
    assert np.flatnonzero(row[:300]).tolist() == [*range(200, 200 + line)]
    assert (np.flatnonzero(row[340:]) + 340).tolist() == [*range(440 - line, 440)]
    assert np.flatnonzero(column).tolist() == [*range(160, 160 + line), *range(280 - line, 280)]
    assert mask[219:222, 319:322].all()  # the centre


def test_a_dark_rim_stands_around() -> None:
    canvas = drawn((100, 80, 120, 60))
    assert canvas[230, 198:204].tolist() == [
        [90] * 3,
        [34] * 3,
        [*PAINT],
        [*PAINT],
        [34] * 3,
        [90] * 3,
    ]


@pytest.mark.parametrize(
    ("box", "ends"),
    [
        ((-50, -50, 100, 100), (0, 99, 0, 99)),
        ((400, 220, 100, 100), (800, 863, None, 479)),  # None: an end of the label, whose size
        ((0, 0, 432, 240), (0, 863, 0, 479)),  # depends on the version of OpenCV
        ((10, 10, 0.2, 0.2), (11, None, 11, None)),
    ],
)
def test_boxes_over_the_edge_are_cut(
    box: tuple[float, float, float, float], ends: tuple[int | None, ...]
) -> None:
    y, x = painted(drawn(box), PAINT).nonzero()
    found = x.min(), x.max(), y.min(), y.max()
    assert all(end in {None, at} for end, at in zip(ends, found, strict=True)), found


@pytest.mark.parametrize("box", [(-300, -300, 100, 100), (500, 300, 10, 10)])
def test_of_a_box_outside_no_line_is_drawn(box: tuple[float, float, float, float]) -> None:
    assert painted(drawn(box), PAINT).sum() < 30  # pixels, of its label


def test_the_first_is_drawn_over_the_others() -> None:
    layout = Layout.of(facts(432, 240))
    mixed = np.zeros((layout.height, layout.width, 3), np.uint8)
    both = [detection((100, 80, 120, 60), alarm=True), detection((100, 80, 120, 60))]
    draw_detections(mixed, layout, both, COLOUR)
    assert painted(mixed, PAINT)[160:164, 400].all()  # the thick line of the alarm


def test_the_label_tells_the_time_to_contact_where_it_is_known(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    layout = Layout.of(facts(432, 240))
    canvas = np.zeros((layout.height, layout.width, 3), np.uint8)
    box = (100.0, 80.0, 120.0, 60.0)
    shown = [
        detection(box, alarm=True),
        detection(box, seconds=4.46),
        detection(box, seconds=0.8449),
        detection(box),
    ]
    texts = texts_of(monkeypatch, lambda: draw_detections(canvas, layout, shown, COLOUR))
    assert texts == ["#3", "#3  contact in 0.84 s", "#3  contact in 4.5 s", "ALARM #3"]


@pytest.mark.parametrize("alarm", [False, True])
def test_the_label_of_a_light_colour_can_be_read(alarm: bool) -> None:
    layout = Layout.of(facts(432, 240))
    canvas = np.zeros((layout.height, layout.width, 3), np.uint8)
    draw_detections(canvas, layout, [detection((100, 80, 120, 60), alarm=alarm)], "#FFEE55")
    label = canvas[138:156, 203:230]
    assert label[0, 0].tolist() == ([0x55, 0xEE, 0xFF] if alarm else [255, 255, 255])
    assert (label.max(axis=2) < 200).sum() > 30  # pixels of the number
