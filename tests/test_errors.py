"""Parts of messages: hints for misspelt words, and the reasons that libraries give."""

from __future__ import annotations

import pytest

from oppload_cli.errors import nearest, reason_of, suggestion

KNOWN = ["opplod", "motion_gain", "gain", "receptive_field"]
ALL = "; choose gain, motion_gain, opplod, receptive_field"


@pytest.mark.parametrize(
    ("word", "hint"),
    [
        ("gian", "; did you mean 'gain'?"),
        ("GIAN", "; did you mean 'gain'?"),
        ("field", "; did you mean 'receptive_field'?"),
        ("opp", "; did you mean 'opplod'?"),
        ("op", ALL),  # too short for a beginning
        ("unlike", ALL),
        (None, ALL),
    ],
)
def test_a_misspelt_word_gives_the_most_similar_one_or_all(word: object, hint: str) -> None:
    assert suggestion(word, KNOWN) == hint
    assert nearest(word, KNOWN) == ("" if hint == ALL else hint.split("'")[1])


def test_a_word_that_several_known_ones_end_in_gives_these() -> None:
    assert suggestion("deg", ["size_deg", "speed_deg", "size"]) == "; choose size_deg, speed_deg"
    assert not nearest("deg", ["size_deg", "speed_deg", "size"])
    assert not suggestion("deg", [])


@pytest.mark.parametrize(
    ("error", "reason"),
    [
        (ValueError("Wrong value.\nMore lines"), "wrong value"),
        (ValueError("I/O error"), "I/O error"),
        (ValueError(" "), "ValueError"),
        (FileNotFoundError(2, "No such file or directory", "a.mp4"), "no such file or directory"),
    ],
)
def test_a_reason_is_the_first_line_as_a_part_of_a_sentence(error: Exception, reason: str) -> None:
    assert reason_of(error) == reason
