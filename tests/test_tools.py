"""The programs for developers: their options, and the commands that the pages show."""

from __future__ import annotations

import argparse
import re
import shlex
from importlib import import_module
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
PROGRAMS = {
    **{
        f"python -m benchmarks.{path.stem}": f"benchmarks.{path.stem}"
        for path in (ROOT / "benchmarks").glob("*.py")
        if "argparse" in path.read_text("utf-8")
    },
    "make bench BENCH=": "benchmarks.bench",
    "python -m tools.attack": "tools.attack.campaign",
    "python tools/structure.py": "tools.structure",
}


class ParserMadeError(Exception):
    """Holds the parser of a program, which then does nothing else."""


def parser_of(module: str, monkeypatch: pytest.MonkeyPatch) -> argparse.ArgumentParser:
    def caught(self: argparse.ArgumentParser, _: object = None) -> None:
        raise ParserMadeError(self)

    main = import_module(module).main
    with monkeypatch.context() as during:
        during.setattr(argparse.ArgumentParser, "parse_args", caught)
        with pytest.raises(ParserMadeError) as made:
            main()
    [parser] = made.value.args
    assert isinstance(parser, argparse.ArgumentParser)
    return parser


@pytest.mark.long
def test_the_programs_describe_their_options_and_take_what_the_pages_show(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    pages = [*ROOT.glob("*.md"), *ROOT.glob("benchmarks/*.md"), *ROOT.glob("docs/**/*.md")]
    text = "\n".join(page.read_text("utf-8") for page in pages if "_build" not in page.parts)
    named = set(re.findall(r"python -m benchmarks\.\w+", text))
    assert named <= PROGRAMS.keys()
    assert len(PROGRAMS) == 10
    shown = 0
    for command, module in PROGRAMS.items():
        parser = parser_of(module, monkeypatch)
        for option in parser._actions:
            assert option.help, (module, option.dest)
        assert str(import_module(module).__doc__) in parser.format_help(), module
        for words in re.findall(rf"{re.escape(command)}( [^`#\n]+|\"[^\"]+\")?", text):
            try:
                parser.parse_args(shlex.split(words.strip('"')))
            except SystemExit:
                pytest.fail(f"a page shows {command}{words}")
            shown += 1
    assert shown > 30


@pytest.mark.long
def test_approaches_without_an_alarm_have_a_row() -> None:
    from benchmarks.places import _Approaches

    assert _Approaches(count=2, frames=30).row("60") == "| 60 | 0 of 2 |  | 0 of 30 |  | 0 |"


@pytest.mark.parametrize(
    ("costs", "said", "code"),
    [
        ((1, 1.09, 1), "median 1.090 of 3 rounds, margin 0.100\n", 0),
        ((1, 1.11, 1), "median 1.110 of 3 rounds, margin 0.100: slower\n", 1),
        ((0.8, 1.2, 1.2), "median 1.200 of 3 rounds, margin 1.000\n", 0),  # the base itself varies
    ],
)
def test_the_comparison_fails_beyond_its_margin(
    costs: tuple[float, ...],
    said: str,
    code: int,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    from benchmarks import compare

    following = iter(3 * costs)
    monkeypatch.setattr(compare, "_cost", lambda *_: next(following))
    monkeypatch.setattr("sys.argv", ["compare", "base", "head", "--rounds", "3"])
    with pytest.raises(SystemExit) as ended:
        compare.main()
    assert (ended.value.code, capsys.readouterr().out) == (code, f"head / base: {said}")
