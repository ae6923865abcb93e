"""``oppload info``."""

from __future__ import annotations

import json

import click

from oppload_cli.environment import environment


@click.command()
@click.option("--json", "as_json", is_flag=True, help="Print JSON.")
def info(as_json: bool) -> None:
    """Print the versions and cores that a result depends on."""
    facts = environment()
    if as_json:
        click.echo(json.dumps(facts, indent=2))
        return
    for name, value in {**facts, **facts["libraries"]}.items():
        if name != "libraries":
            click.echo(f"{name:<24}{'not installed' if value is None else value}")
