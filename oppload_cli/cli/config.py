"""``oppload config``."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING

import click

from oppload_cli.cli.options import settings_options
from oppload_cli.settings import NATIVE, resolve

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

    from oppload_cli.settings import Settings


@click.command(short_help="every setting of a run, and where it came from")
@settings_options
def config(  # noqa: PLR0917 - click passes them by name
    models: tuple[str, ...],
    preset: str | None,
    assignments: tuple[str, ...],
    config: Path | None,
    height: str | None,
    measure_rmo: bool | None,
) -> None:
    """Print every setting as TOML, with where each came from as a comment.

    What is printed can be saved and given back with --config.
    """
    settings = resolve(
        preset=preset,
        config=config,
        models=models,
        height=height,
        measure_rmo=measure_rmo,
        assignments=assignments,
    )
    for line in _lines(settings):
        click.echo(line)


def _lines(settings: Settings) -> Iterator[str]:
    origins = settings.origins
    yield f'preset = "{settings.preset}"  # {origins["preset"]}'
    yield f"models = {json.dumps(list(settings.models))}  # {origins['models']}"
    height = settings.height if settings.height is not None else f'"{NATIVE}"'
    yield f"height = {height}  # {origins['height']}"
    yield f"measure_rmo = {json.dumps(settings.measure_rmo)}  # {origins['measure_rmo']}"
    for group, params in settings.groups.items():
        yield ""
        yield f"[{group}]"
        for name, value in params.as_dict().items():
            origin = origins[f"{group}.{name}"]
            # TOML has no "none"; what follows from the working size is left out.
            line = f"# {name} follows from the height" if value is None else f"{name} = "
            yield (line if value is None else line + json.dumps(value)) + f"  # {origin}"
