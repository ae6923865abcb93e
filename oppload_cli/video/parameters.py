"""Parameters of reading a video; nothing here needs NumPy."""

from __future__ import annotations

from dataclasses import dataclass

from oppload_cli.parameters import Parameters, parameter


@dataclass(frozen=True, kw_only=True)
class RepeatParams(Parameters):
    """How exact repeats of a frame are taken (``docs/model.md``, "Repeated frames")."""

    most: int = parameter(
        5,
        "repeats in a row taken as a copied frame; a longer run is a still scene",
        unit="frames",
        low=0,
        high=1000,
    )
