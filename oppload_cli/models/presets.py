"""The presets: named parameter sets (``docs/model.md``)."""

from __future__ import annotations

from dataclasses import dataclass

from oppload_cli.errors import ParameterError, suggestion
from oppload_cli.models.parameters import DlgmdParams, OpplodParams

DEFAULT_PRESET = "default"


@dataclass(frozen=True)
class Preset:
    """A named parameter set, with the working height that it was made for."""

    name: str
    meaning: str
    height: int
    opplod: OpplodParams
    dlgmd: DlgmdParams


PRESETS = {
    preset.name: preset
    for preset in (
        Preset(
            "default",
            "the model made to work: pooled opponency, a unit at every cell, outward minus inward",
            240,
            OpplodParams(),
            DlgmdParams(),
        ),
        Preset(
            "paper",
            "the paper to the letter: 25 units of 200 x 200 px, products pixel by pixel",
            600,
            OpplodParams(
                judgement="pixelwise",
                receptive_field=200,
                cell=1,
                pool_sigma=0.0,
                periphery=0.0,
                units="5x5",
            ),
            DlgmdParams(),
        ),
        Preset(
            "robust",
            "for real footage: large fields, compressed contrast, frames one and two apart",
            240,
            OpplodParams(
                receptive_field=240,
                cell=12,
                pool_sigma=1.0,
                border=6,
                compression=0.5,
                strides=2,
                cone=60.0,
                periphery=1.1,
                reference_rate=30.0,
                persistence=0.5,
                adaptation_level=0.035,
            ),
            DlgmdParams(),
        ),
    )
}


def preset_named(name: str) -> Preset:
    """Return a preset by its name.

    Parameters
    ----------
    name : str
        ``default``, ``paper`` or ``robust``.

    Returns
    -------
    Preset

    Raises
    ------
    ParameterError
        If there is none of that name.
    """
    if name not in PRESETS:
        raise ParameterError(f"no preset '{name}'{suggestion(name, PRESETS)}")
    return PRESETS[name]
