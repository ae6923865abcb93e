"""``oppload models``."""

from __future__ import annotations

import json
from dataclasses import fields
from typing import TYPE_CHECKING, Any

import click

from oppload_cli.detection.alarm import ALARMS, AlarmParams
from oppload_cli.detection.parameters import PlaceParams
from oppload_cli.models.parameters import DlgmdParams, OpplodParams
from oppload_cli.models.presets import PRESETS
from oppload_cli.motion.parameters import RmoParams
from oppload_cli.video.parameters import RepeatParams

if TYPE_CHECKING:
    from collections.abc import Iterator

    from oppload_cli.parameters import Parameters

SETS: dict[str, tuple[str, type[Parameters]]] = {
    "opplod": ("OppLoD: DPC, directional inhibition, opponency, enhancing", OpplodParams),
    "dlgmd": ("D-LGMD: DPC and grouping", DlgmdParams),
    "alarm": ("the alarm of each model", AlarmParams),
    "places": ("looming objects: which, where, and when they touch", PlaceParams),
    "rmo": ("radial motion opponency of motion vectors", RmoParams),
    "repeats": ("exact repeats of a frame", RepeatParams),
}


@click.command(short_help="the models, their parameters and presets")
@click.option("--json", "as_json", is_flag=True, help="Print JSON.")
def models(as_json: bool) -> None:
    """Describe the models, every parameter with its range and default, and the presets."""
    if as_json:
        click.echo(json.dumps(_described(), indent=2))
        return
    for name, (meaning, params) in SETS.items():
        click.secho(f"{name}  ({meaning})", bold=True)
        for line in _lines(params):
            click.echo(f"  {line}")
        click.echo()
    click.secho("presets", bold=True)
    for preset in PRESETS.values():
        click.echo(f"  {preset.name:<9}{preset.meaning}; working height {preset.height}")
        chosen: dict[str, Parameters] = {"opplod": preset.opplod, "alarm": ALARMS[preset.name]}
        for group, of_preset in chosen.items():
            for name, value in _changed(of_preset):
                click.echo(f"  {'':9}{group}.{name} = {value}")


def _changed(params: Parameters) -> Iterator[tuple[str, object]]:
    usual = type(params)().as_dict()
    for name, value in params.as_dict().items():
        if value != usual[name]:
            yield name, value


def _lines(params: type[Parameters]) -> Iterator[str]:
    for entry in _entries(params):
        unit = f" {entry['unit']}" if entry["unit"] else ""
        default = "auto" if entry["default"] is None else str(entry["default"])
        yield f"{entry['name']:<20}{default:>8}{unit:<8} {entry['meaning']}"


def _entries(params: type[Parameters]) -> Iterator[dict[str, Any]]:
    for declared in fields(params):
        choices = list(declared.metadata["choices"])
        yield {
            "name": declared.name,
            "default": declared.default,
            **declared.metadata,
            "choices": choices,
        }


def _described() -> dict[str, Any]:
    return {
        "parameters": {name: list(_entries(params)) for name, (_, params) in SETS.items()},
        "presets": {
            preset.name: {
                "meaning": preset.meaning,
                "height": preset.height,
                "opplod": preset.opplod.as_dict(),
                "dlgmd": preset.dlgmd.as_dict(),
                "alarm": ALARMS[preset.name].as_dict(),
            }
            for preset in PRESETS.values()
        },
    }
