"""Options that several commands share."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from oppload_cli.models.presets import PRESETS
from oppload_cli.results.columns import MODELS

if TYPE_CHECKING:
    from collections.abc import Callable

    Command = Callable[..., Any]


def settings_options(command: Command) -> Command:
    """Add the options that :func:`oppload_cli.settings.resolve` takes.

    Parameters
    ----------
    command : callable
        Takes `models`, `preset`, `assignments`, `config`, `height` and
        `measure_rmo`.

    Returns
    -------
    callable
    """
    for option in reversed(
        (
            click.option(
                "--model",
                "models",
                multiple=True,
                metavar="NAME",
                help=f"A model to run: {' or '.join(MODELS)}; may be given again.  [default: all]",
            ),
            click.option(
                "--preset",
                metavar="NAME",
                help=f"A named parameter set: {' or '.join(PRESETS)}.  [default: default]",
            ),
            click.option(
                "--set",
                "assignments",
                multiple=True,
                metavar="SET.PARAMETER=VALUE",
                help="One parameter, e.g. opplod.receptive_field=200; see 'oppload models'.",
            ),
            click.option(
                "--config",
                type=click.Path(path_type=Path),
                metavar="FILE.toml",
                help="Settings from a file; see 'oppload config'.",
            ),
            click.option(
                "--height",
                metavar="PX|native",
                help="Working height; the width follows.  [default: the preset's, 240 or 600]",
            ),
            click.option(
                "--no-rmo",
                "measure_rmo",
                flag_value=False,
                default=None,
                type=bool,
                help="Do not measure radial motion opponency (RMO).",
            ),
        )
    ):
        command = option(command)
    return command
