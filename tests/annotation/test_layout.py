from __future__ import annotations

import pytest

from oppload_cli.annotation.frame import Layout
from tests.annotation.records import facts


@pytest.mark.parametrize(
    ("width", "height", "picture"),
    [
        (1280, 720, (1280, 720)),
        (432, 240, (864, 480)),
        (63, 47, (567, 423)),
        (3840, 2160, (1920, 1080)),
        (1080, 1920, (1080, 1920)),
        (5000, 10, (1920, 4)),
        (2, 2, (400, 400)),
        (1000, 10, (1000, 10)),
        (600, 100, (1800, 300)),
    ],
)
def test_the_picture_keeps_its_size_or_is_enlarged_by_an_integer(
    width: int, height: int, picture: tuple[int, int]
) -> None:
    layout = Layout.of(facts(width, height))
    assert (layout.picture.width, layout.picture.height) == picture
    assert (layout.scale_x, layout.scale_y) == (picture[0] / width, picture[1] / height)
    assert layout.width % 2 == layout.height % 2 == 0
    assert layout.text >= 16
    # No part overlaps another or reaches beyond the frame.
    assert layout.header.y == layout.picture.height
    assert layout.plot.y == layout.header.y + layout.header.height
    assert layout.plot.y + layout.plot.height <= layout.height
    assert layout.plot.x + layout.plot.width <= layout.width
    assert 0 <= layout.picture.x <= layout.width - layout.picture.width
    assert layout.plot.width >= 20 * layout.text
