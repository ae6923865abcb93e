"""What is alike in all commands, and what the shell completes."""

from __future__ import annotations

import importlib
from pathlib import Path
from typing import TYPE_CHECKING

import click
import pytest
from click.shell_completion import ShellComplete

from oppload_cli import cli
from oppload_cli.cli import COMMANDS, oppload
from oppload_cli.errors import StimulusError
from oppload_cli.models.registry import detectors
from oppload_cli.stimulus.catalogue import find

if TYPE_CHECKING:
    from collections.abc import Iterator


def commands() -> Iterator[click.Command]:
    for name in COMMANDS:
        command = getattr(importlib.import_module(f"oppload_cli.cli.{name}"), name)
        yield from command.commands.values() if isinstance(command, click.Group) else (command,)


def options(name: str) -> list[click.Option]:
    listed = [each for command in commands() for each in command.params]
    return [each for each in listed if isinstance(each, click.Option) and f"--{name}" in each.opts]


def test_jobs_are_the_same_everywhere() -> None:
    jobs = options("jobs")
    assert len(jobs) >= 5
    for each in jobs:
        assert (each.opts, each.default) == (["-j", "--jobs"], 0)
        assert isinstance(each.type, click.IntRange)
        assert (each.type.min, each.type.max) == (0, 1024)
        assert "0: one per core" in str(each.help)


def test_the_page_of_the_commands_can_list_all_of_them() -> None:
    """The site asks Click for them."""
    context = click.Context(oppload)
    listed = {name: oppload.get_command(context, name) for name in oppload.list_commands(context)}
    assert list(listed) == list(COMMANDS)
    assert None not in listed.values()


def test_one_name_for_one_thing() -> None:
    assert not options("models")
    assert not options("stimulus-set")
    assert {each.metavar for each in options("set")} == {"SET.PARAMETER=VALUE"}
    assert {each.metavar for each in options("change")} == {"KEY=VALUE"}


def test_every_message_goes_through_say() -> None:
    """`say` ignores that the program that reads standard error has ended."""
    sources = Path(cli.__file__).parent.glob("*.py")
    assert sum(each.read_text(encoding="utf-8").count("err=True") for each in sources) == 1


def completed(*words: str) -> list[str]:
    completion = ShellComplete(oppload, {}, "oppload", "_OPPLOAD_COMPLETE")
    return [each.value for each in completion.get_completions(list(words[:-1]), words[-1])]


def test_the_shell_completes_names() -> None:
    assert completed("re") == ["report", "reproduce"]
    versions = ["opplod", "opplod_reference", "opplod_paper", "opplod_lplc2"]
    assert completed("run", "--model", "opp") == versions
    assert completed("tune", "--model", "dlgmd,opplod_r") == ["dlgmd,opplod_reference"]
    for command in ("evaluate", "plot"):
        assert set(completed(command, "--model", "")) == set(detectors())
    assert completed("run", "--set", "opp") == [f"{name}." for name in versions]
    assert completed("run", "--set", "opplod.rec") == ["opplod.receptive_field="]
    assert completed("run", "--set", "opplod.axes=") == ["opplod.axes=0", "opplod.axes=45"]
    assert completed("tune", "klapoetke2017/edg") == ["klapoetke2017/edge"]
    assert completed("stimuli", "show", "and-trans") == ["controls/looming-and-translating"]


@pytest.mark.parametrize(
    ("wanted", "name", "only"),
    [
        ("looming-and-translating", "controls/looming-and-translating", "*"),
        ("and-trans", "controls/looming-and-translating", "*"),
        ("l-over-v-60", "klapoetke2017/loom-l-over-v", "klapoetke2017/loom-l-over-v/l-over-v-60"),
    ],
)
def test_a_stimulus_by_its_last_part_or_a_fragment(wanted: str, name: str, only: str) -> None:
    [entry] = find(wanted)
    assert (entry.name, entry.only) == (name, only)


def test_a_fragment_of_several_names_them() -> None:
    with pytest.raises(StimulusError, match=r"could be controls/\S+, controls/\S+; write more"):
        find("translating-disk")
    with pytest.raises(StimulusError, match=r"^no stimulus '-' in the catalogue; see .*FILE.toml"):
        find("-")


def test_the_first_help_keeps_its_lines(capsys: pytest.CaptureFixture[str]) -> None:
    oppload.main(["--help"], standalone_mode=False)
    shown = capsys.readouterr().out
    assert "\\b" not in shown
    assert "\n  oppload run video.mp4 " in shown
