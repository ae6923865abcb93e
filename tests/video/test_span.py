"""Positions in an input, and the part between two of them."""

from __future__ import annotations

import pytest

from oppload_cli.errors import ParameterError
from oppload_cli.video.inputs import Position, Span, parse_position


@pytest.mark.parametrize(
    ("text", "position"),
    [
        ("f300", Position(frame=300)),
        ("12.5", Position(seconds=12.5)),
        ("00:01:02.5", Position(seconds=62.5)),
        ("2:03", Position(seconds=123)),
    ],
)
def test_positions(text: str, position: Position) -> None:
    assert parse_position(text) == position


@pytest.mark.parametrize("text", ["", "f", "x", "-1", "nan", "inf", "1:2:3:4", "f1.5"])
def test_a_text_that_is_no_position(text: str) -> None:
    with pytest.raises(ParameterError, match="is no position"):
        parse_position(text)


def test_end_and_duration_exclude_each_other() -> None:
    with pytest.raises(ParameterError, match="exclude each other"):
        Span(end=Position(frame=1), duration=Position(frame=1))
