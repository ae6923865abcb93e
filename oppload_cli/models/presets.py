"""The presets by name: their working height and their purpose.

The class of each detector holds its parameters under the presets. This module does not import
NumPy, so that a video can be opened at its working height before the detectors are loaded.
"""

from __future__ import annotations

import re
from typing import TYPE_CHECKING, NamedTuple

from oppload_cli.errors import ParameterError, suggestion

if TYPE_CHECKING:
    from collections.abc import Iterable

DEFAULT_PRESET = "default"
STUDY_PRESET = "reference"  # the default of commands that study the model itself
REFERENCE_INTERVAL = "1/30"  # seconds
NATIVE = "native"  # value of the working height that stands for the height of the video
# Variants of detectors that have the name of a preset: `NAME:paper` means the variant.
VARIANTS = ("lgmd1_group:paper", "lgmd1_single:paper")
EXAMPLE_SETTING = "opplod.receptive_field=200"  # for help texts and messages


class Preset(NamedTuple):
    """A name for a set of parameters."""

    name: str
    meaning: str  # its purpose, in one line
    height: int  # working height in pixels for which its parameters are made
    no_alarm: str = ""  # why its alarms are off; empty if they are calibrated
    interval: str = REFERENCE_INTERVAL  # its time base: the value of ``time.interval``


PRESETS = {
    preset.name: preset
    for preset in (
        Preset(
            "default",
            "for videos of cameras: opponent units and the growth of the optical flow must agree",
            240,
        ),
        Preset(
            "reference",
            "for studies of the model: the paper's OppLoD made to work, at any frame rate",
            240,
        ),
        Preset(
            "paper",
            "for comparison with the paper: its text to the letter, 25 units of 200 x 200 px",
            600,
            "it responds to inward and outward motion: no threshold separates approach and retreat",
            interval="frame",
        ),
        Preset(
            "lplc2",
            "for neuroscience: tuned like LPLC2 neurons of the fruit fly, with a calcium signal",
            240,
            "it responds like a neuron, and nobody has measured which response warns of a contact",
        ),
    )
}


def preset_in(models: Iterable[str], where: str = "the list of models") -> str:
    """Return the preset in values of ``--model`` such as ``NAME:PRESET``, empty if there is none.

    Different presets are a ParameterError, because one run has one preset; `where` is the place of
    the values in its message.
    """
    names = [each.strip() for text in models for each in text.split(",")]
    suffixes = (name.partition(":")[2].strip() for name in names if name not in VARIANTS)
    presets = list(dict.fromkeys(suffix for suffix in suffixes if suffix in PRESETS))
    if len(presets) > 1:
        raise ParameterError(
            f"{where} names the presets '{presets[0]}' and '{presets[1]}'; give each a run of its "
            f"own, or compare them with 'oppload evaluate'"
        )
    return presets[0] if presets else ""


def stated_preset(preset: str | None, models: Iterable[str]) -> str | None:
    """Return the preset that a run states, by itself or in the names of its models, else None.

    An unknown preset, and two different ones, are a ParameterError.
    """
    of_models = preset_in(models)
    if preset is not None:
        preset_named(preset)  # raises the error of an unknown preset, also of an empty text
    if preset and of_models and preset != of_models:
        raise ParameterError(
            f"a model asks for preset '{of_models}', but the preset is '{preset}'; leave one out"
        )
    return preset or of_models or None


def preset_named(name: str) -> Preset:
    """Return a preset by its name; an unknown name is a ParameterError."""
    name = str(name)  # a caller may give a list or an array, in spite of the type
    if name == "robust":
        raise ParameterError("preset 'robust' is called 'default' since 1.0; leave the preset out")
    if name not in PRESETS:
        raise ParameterError(f"no preset '{name}'{suggestion(name, PRESETS)}")
    return PRESETS[name]


def parse_height(value: str | int) -> int | None:
    """Return a working height in pixels; None for ``native``.

    Raises
    ------
    ParameterError
        If `value` is neither ``native`` nor an integer from 1 to 8192.
    """
    text = str(value)
    if text == NATIVE:
        return None
    if not re.fullmatch(r"[0-9]{1,4}", text) or not 1 <= int(text) <= 8192:
        raise ParameterError(
            f"height must be 'native' or a whole number of pixels from 1 to 8192, not '{value}'"
        )
    return int(text)
