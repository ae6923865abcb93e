"""Tables as text: cells, line ends, and numbers of 64 bits."""

from __future__ import annotations

import csv
from io import StringIO

import numpy as np
import pytest

from oppload_cli.files.tables import Cell, csv_text, finite_text, formatted, plain_text, typed


@pytest.mark.parametrize(
    ("value", "texts"),
    [
        ("a", ("a", "a", "a")),
        (None, ("", "", "")),
        (True, ("1", "true", "true")),
        (12, ("12", "12", "12")),
        (1 / 3, ("0.333333333", "0.333333333", "0.333333333")),
        (np.float64(2e-12), ("2e-12", "2e-12", "2e-12")),
        (float("nan"), ("nan", "nan", "")),
        (float("-inf"), ("-inf", "-inf", "")),
    ],
)
def test_the_text_of_a_cell(value: Cell, texts: tuple[str, str, str]) -> None:
    assert (formatted(value), plain_text(value), finite_text(value)) == texts


def test_rows_end_with_line_feeds_and_names_keep_their_line_ends() -> None:
    names = ["a", "b\rc", "b\nc", "b\r\nc", 'd"e', "f,g", "h\r\n", ""]
    text = csv_text([{"name": name, "frame": 1} for name in names], ["name", "frame", "lacking"])
    assert text.startswith("name,frame,lacking\na,1,\n")
    assert text.endswith("\n,1,\n")
    rows = list(csv.reader(StringIO(text, newline="")))
    assert rows[1:] == [[name, "1", ""] for name in names]


def test_whole_numbers_of_a_column_have_64_bits() -> None:
    assert typed(2**63 - 1, int) == 2**63 - 1
    assert typed(-(2**63), int) == -(2**63)
    for number in (2**63, -(2**63) - 1):
        with pytest.raises(ValueError, match="more than 64 bits"):
            typed(number, int)
    assert [typed("", float), typed(None, str), typed("2", float)] == [None, None, 2.0]
    for value, kind in ((1, str), ("true", bool)):
        with pytest.raises(TypeError, match=f"is no {kind.__name__}"):
            typed(value, kind)
