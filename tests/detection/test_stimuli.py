"""Time to contact over the catalogue: what ``docs/places.md`` states."""

from __future__ import annotations

import statistics

import pytest

from benchmarks.places import CONDITIONS, Measured, measured
from oppload_cli import stimulus


def over(*words: str) -> Measured:
    total = Measured()
    for name, protocol, settings in CONDITIONS:
        if name.startswith(words):
            one = measured(stimulus.load_all(protocol, settings)[0], "opplod")
            assert one.identities == {1}
            total.frames += one.frames
            total.errors += one.errors
            total.focus += one.focus
    return total


def check(found: Measured, share: float) -> None:
    assert len(found.errors) >= share * found.frames
    assert statistics.median(abs(error) for error in found.errors) < 0.17
    assert max(found.focus) < 0.08 * 240


@pytest.mark.long
def test_a_disk_of_the_catalogue() -> None:
    check(over("disk, l/v 60 ms"), 0.5)


@pytest.mark.slow
def test_every_disk_of_the_catalogue() -> None:
    check(over("disk", "aside", "bright", "texture at rest", "motion blur"), 0.5)
