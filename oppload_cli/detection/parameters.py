"""Parameters of the places of looming objects."""

from __future__ import annotations

from dataclasses import dataclass

from oppload_cli.parameters import Parameters, parameter


@dataclass(frozen=True, kw_only=True)
class PlaceParams(Parameters):
    """What is an object, when it is the same one, and when its contact is determined.

    Source: ``docs/places.md``.
    """

    floor: float = parameter(
        1e-6, "response of OppLoD below which nothing is an object", low=0, high=1e9
    )
    share: float = parameter(
        0.01, "least response of an object over the frame's largest", low=0, high=1
    )
    most: int = parameter(5, "most objects in a frame", unit="objects", low=1, high=100)
    gap_s: float = parameter(
        0.2, "how long an object keeps its number unseen", unit="s", low=0, high=60
    )
    memory_s: float = parameter(
        0.4, "how far back the growth of an object is followed", unit="s", low=0.01, high=60
    )
    least_frames: int = parameter(
        4, "frames that the time to contact needs", unit="frames", low=3, high=1000
    )
    least_growth: float = parameter(
        1.15, "growth of the size over them that it needs", low=1, high=100
    )
    largest_error: float = parameter(
        0.2, "largest standard error of a time to contact over it", low=0.001, high=10
    )


# Responses of preset robust are on another scale.
PLACES = {"default": PlaceParams(), "paper": PlaceParams(), "robust": PlaceParams(floor=1e-3)}
