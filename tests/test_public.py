"""The public names: they are listed, documented, and their examples are true."""

from __future__ import annotations

import doctest
import functools
import inspect
from typing import TYPE_CHECKING, Any

import pytest

import oppload_cli
from oppload_cli import stimulus
from tests.cli.process import loaded

if TYPE_CHECKING:
    from collections.abc import Iterator

NAMES = [name for name in oppload_cli.__all__ if name != "__version__"]


def examples_of(thing: Any, name: str) -> list[doctest.DocTest]:
    found = doctest.DocTestFinder().find(thing, name, globs={})  # also those of methods
    return [each for each in found if each.examples]


def failures_of(tests: list[doctest.DocTest]) -> str:
    said: list[str] = []
    runner = doctest.DocTestRunner(optionflags=doctest.NORMALIZE_WHITESPACE)
    for test in tests:
        runner.run(test, out=said.append)
    return "".join(said)


def once(function: Any, keep: Any) -> Any:
    """Return a function that computes only once what many examples begin with, and keeps that."""
    known: dict[bool, Any] = {}

    @functools.wraps(function)
    def shared(source: Any, *more: Any, **named: Any) -> Any:
        other = not isinstance(source, str) or source != "controls/looming-perspective"
        if other or more or named.keys() - {"rmo"}:
            return function(source, *more, **named)
        rmo = named.get("rmo", True)
        if rmo not in known:
            known[rmo] = keep(function(source, **named))
        return known[rmo]

    return shared


@pytest.fixture(autouse=True, scope="module")
def _common_runs_once() -> Iterator[None]:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(oppload_cli, "run", once(oppload_cli.run, lambda result: result))
        patch.setattr(oppload_cli, "analyse", once(oppload_cli.analyse, list))
        yield


@pytest.mark.parametrize("name", ["oppload_cli", *NAMES])
def test_every_public_name_has_an_example_that_is_true(name: str) -> None:
    thing = oppload_cli if name == "oppload_cli" else getattr(oppload_cli, name)
    tests = examples_of(thing, name)
    assert tests, f"{name} has no example"
    assert failures_of(tests) == ""


@pytest.mark.parametrize("name", stimulus.__all__)
def test_the_examples_of_stimuli_are_true(name: str) -> None:
    thing = getattr(stimulus, name)
    tests = examples_of(thing, name)
    shown = {"entries", "file_stem", "frame_truth", "frames", "ground_truth", "load", "load_all"}
    assert tests or name not in shown
    assert failures_of(tests) == ""


@pytest.mark.parametrize("name", ["plot", "report", "save", "summary"])
def test_the_methods_of_a_result_have_examples(name: str) -> None:
    assert examples_of(inspect.getattr_static(oppload_cli.Result, name), name)


def test_completion_shows_the_public_names_and_no_others() -> None:
    assert dir(oppload_cli) == sorted(oppload_cli.__all__)
    assert all(getattr(oppload_cli, name) is not None for name in oppload_cli.__all__)
    assert {"load", "frames", "ground_truth", "Protocol"} <= set(dir(stimulus))
    with pytest.raises(AttributeError, match="has no attribute 'nothing'"):
        _ = oppload_cli.nothing  # type: ignore[attr-defined]


@pytest.mark.long
def test_names_are_loaded_when_they_are_used() -> None:
    code = "import sys, oppload_cli; dir(oppload_cli); assert 'numpy' not in sys.modules\n"
    assert loaded(f"{code}oppload_cli.Opplod", "numpy", "pandas") == ["numpy"]
    # Matplotlib cannot be loaded where no folder can be written.
    assert loaded(f"{code}oppload_cli.run", "pandas", "matplotlib") == ["pandas"]
