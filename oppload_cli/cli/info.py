"""``oppload info``."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING, Any

import click

from oppload_cli.environment import environment

if TYPE_CHECKING:
    from collections.abc import Mapping


@click.command(short_help="versions, for a bug report")
@click.option("--json", "as_json", is_flag=True, help="Print JSON.")
def info(as_json: bool) -> None:
    """Print the versions and cores that a result depends on."""
    facts = environment()
    if as_json:
        click.echo(json.dumps(facts, indent=2))
        return
    for name, value in _flat(facts).items():
        click.echo(f"{name:<24}{'not installed' if value is None else value}")


def _flat(facts: Mapping[str, Any]) -> dict[str, Any]:
    own = {name: value for name, value in facts.items() if name != "libraries"}
    return {**own, **facts["libraries"]}
