"""Who is evaluated: OppLoD under presets, and the plain baselines beside it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from oppload_cli.detection.alarm import ALARMS, AlarmParams
from oppload_cli.errors import ParameterError, suggestion
from oppload_cli.models.parameters import DlgmdParams, OpplodParams
from oppload_cli.models.presets import DEFAULT_PRESET, PRESETS, Preset

if TYPE_CHECKING:
    from collections.abc import Iterable

MEAN_P, FLOW, DLGMD = "mean_p", "flow_divergence", "dlgmd"
PREFIX = "opplod:"
HEIGHT = 240
MEANINGS = {
    DLGMD: "D-LGMD: mean of G over the frame",
    FLOW: "optical flow: largest mean divergence over a window of 5/12 of the height",
    MEAN_P: "frame difference: mean of P over the frame",
}


@dataclass(frozen=True)
class Contender:
    """One who answers to every frame.

    Attributes
    ----------
    name : str
        Such as ``opplod:default`` or ``mean_p``.
    meaning : str
        One line for the reader.
    height : int
        Working height in pixels.
    params : OpplodParams, DlgmdParams or None
        Of its model; None for a baseline that is no model.
    alarm : AlarmParams or None
        Of its own alarm; None where it has none.
    """

    name: str
    meaning: str
    height: int
    params: OpplodParams | DlgmdParams | None = None
    alarm: AlarmParams | None = None

    @property
    def model(self) -> str:
        """The name of its model in a frame's record; empty for none."""
        if self.params is None:
            return ""
        return "opplod" if isinstance(self.params, OpplodParams) else DLGMD

    def as_dict(self) -> dict[str, Any]:
        """Return all that its answers depend on, ready for JSON.

        Returns
        -------
        dict
        """
        model = self.params.as_dict() if self.params else None
        if isinstance(self.params, OpplodParams):
            model = self.params.resolved(self.height).as_dict()
        alarm = self.alarm.as_dict() if self.alarm else None
        return {
            "meaning": self.meaning,
            "height": self.height,
            "parameters": model,
            "alarm": alarm,
        }


def contenders(names: Iterable[str] = ()) -> list[Contender]:
    """Return who is evaluated, the baselines last.

    Parameters
    ----------
    names : iterable of str
        ``opplod:PRESET``, and baselines, which are there anyway; without any OppLoD
        its preset ``default``, and ``robust`` where there is one.

    Returns
    -------
    list of Contender

    Raises
    ------
    ParameterError
        If there is none of a name.
    """
    chosen = list(dict.fromkeys(names))
    known = {**{PREFIX + name: preset for name, preset in PRESETS.items()}}
    for name in chosen:
        if name not in known and name not in MEANINGS:
            raise ParameterError(f"no model '{name}'{suggestion(name, [*known, *MEANINGS])}")
    usual = [PREFIX + name for name in (DEFAULT_PRESET, "robust") if name in PRESETS]
    own = [name for name in chosen if name in known] or usual
    return [*(_opplod(name, known[name]) for name in own), *_baselines()]


def _opplod(name: str, preset: Preset) -> Contender:
    return Contender(name, preset.meaning, preset.height, preset.opplod, ALARMS[preset.name])


def _baselines() -> list[Contender]:
    return [
        Contender(DLGMD, MEANINGS[DLGMD], HEIGHT, DlgmdParams(), AlarmParams()),
        Contender(FLOW, MEANINGS[FLOW], HEIGHT),
        Contender(MEAN_P, MEANINGS[MEAN_P], HEIGHT),
    ]
