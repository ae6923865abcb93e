from __future__ import annotations

import numpy as np
import pytest

from oppload_cli.annotation.boxes import ALARM_PAINT, CALM_PAINT, draw_detections, label_of
from oppload_cli.annotation.layout import layout_of
from tests.annotation.records import detection, facts


def drawn(*boxes: tuple[float, float, float, float], alarm: bool = False) -> np.ndarray:
    layout = layout_of(facts(432, 240))  # shown at 864 x 480
    canvas = np.full((layout.height, layout.width, 3), 90, np.uint8)
    draw_detections(canvas, layout, [detection(box, alarm=alarm) for box in boxes])
    assert (canvas[layout.picture.height :] == 90).all()
    return canvas


def painted(canvas: np.ndarray, paint: tuple[int, int, int]) -> np.ndarray:
    mask: np.ndarray = (canvas == np.array(paint)).all(axis=2)
    return mask


@pytest.mark.parametrize(("alarm", "paint"), [(False, CALM_PAINT), (True, ALARM_PAINT)])
def test_the_lines_lie_just_inside_the_edges(alarm: bool, paint: tuple[int, int, int]) -> None:
    mask = painted(drawn((100, 80, 120, 60), alarm=alarm), paint)
    # In twice the size: columns 200 to 440, rows 160 to 280; looked at away from the corners.
    row, column = mask[220], mask[:, 400]
    assert np.flatnonzero(row[:300]).tolist() == [200, 201]
    assert np.flatnonzero(row[340:]).tolist() == [438 - 340, 439 - 340]
    assert np.flatnonzero(column).tolist() == [160, 161, 278, 279]
    other = ALARM_PAINT if paint == CALM_PAINT else CALM_PAINT
    assert not painted(drawn((100, 80, 120, 60), alarm=alarm), other).any()


def test_the_corners_are_thicker_and_the_centre_is_marked() -> None:
    mask = painted(drawn((100, 80, 120, 60)), CALM_PAINT)
    assert np.flatnonzero(mask[270, :300]).tolist() == [200, 201, 202, 203]
    assert mask[219:222, 319:322].all()


def test_a_dark_rim_stands_around() -> None:
    canvas = drawn((100, 80, 120, 60))
    assert canvas[230, 198:204].tolist() == [
        [90] * 3,
        [34] * 3,
        [*CALM_PAINT],
        [*CALM_PAINT],
        [34] * 3,
        [90] * 3,
    ]


@pytest.mark.parametrize(
    "box",
    [
        (-50, -50, 100, 100),
        (400, 220, 100, 100),
        (0, 0, 432, 240),
        (10, 10, 0.2, 0.2),
        (-300, -300, 100, 100),
        (500, 300, 10, 10),
    ],
)
def test_boxes_over_the_edge_are_cut(box: tuple[float, float, float, float]) -> None:
    canvas = drawn(box)
    assert canvas.shape == (616, 864, 3)


def test_the_first_is_drawn_over_the_others() -> None:
    canvas = drawn((100, 80, 120, 60), (100, 80, 120, 60), alarm=True)
    assert painted(canvas, ALARM_PAINT)[160, 400]
    layout = layout_of(facts(432, 240))
    mixed = np.zeros((layout.height, layout.width, 3), np.uint8)
    both = [detection((100, 80, 120, 60), alarm=True), detection((100, 80, 120, 60))]
    draw_detections(mixed, layout, both)
    assert painted(mixed, ALARM_PAINT)[160, 400]


def test_the_label_stands_above_or_inside_and_never_beyond() -> None:
    above = painted(drawn((100, 80, 120, 60)), CALM_PAINT)
    assert above[138, 200:230].all()
    assert not above[134, 200:230].any()
    inside = painted(drawn((100, 5, 120, 60)), CALM_PAINT)
    assert inside[32, 205:225].all()
    right = painted(drawn((425, 80, 60, 60)), CALM_PAINT)
    assert right[138, -30:].all()


def test_the_label_tells_the_time_to_contact_where_it_is_known() -> None:
    assert label_of(detection((0, 0, 1, 1))) == "#3"
    assert label_of(detection((0, 0, 1, 1), left=0.8449)) == "#3  contact in 0.84 s"
    assert label_of(detection((0, 0, 1, 1), left=4.46)) == "#3  contact in 4.5 s"
