"""``oppload config``."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING, Any

import click

from oppload_cli.cli import options
from oppload_cli.errors import printable
from oppload_cli.pipeline.settings import resolve
from oppload_cli.schema import AUTO

if TYPE_CHECKING:
    from collections.abc import Iterator

    from oppload_cli.pipeline.settings import Settings


@click.command()
@options.settings()
def config(**chosen: Any) -> None:
    """Print every setting as TOML, with its origin as a comment.

    If you save the output to a file, --config reads the settings from it.
    """
    for line in _lines(resolve(**chosen).with_all_detectors()):
        click.echo(printable(line))


def _lines(settings: Settings) -> Iterator[str]:
    origins = settings.origins
    yield f"models = {json.dumps(list(settings.models))}  # {origins['models']}"
    yield f"height = {json.dumps(settings.height)}  # {origins['height']}"
    fov = "# fov is not known" if settings.fov is None else f"fov = {settings.fov}"
    yield f"{fov}  # {origins['fov']}"
    yield f"measure_rmo = {json.dumps(settings.measure_rmo)}  # {origins['measure_rmo']}"
    yield f'columns = "{settings.columns}"  # {origins["columns"]}'
    for group, params in settings.groups.items():
        yield ""
        yield f"[{group}]"
        angles = {
            name: f"{degrees}deg"
            for name in params.names()
            if (degrees := settings.angles.get(f"{group}.{name}"))
        }
        for name, value in {**params.as_dict(), **angles}.items():
            origin = origins.get(f"{group}.{name}", "default")
            # TOML has no pairs of escapes, which JSON writes for some letters.
            text = json.dumps(AUTO if value is None else value, ensure_ascii=False)
            yield f"{name} = {text}  # {origin}"
