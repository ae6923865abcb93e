"""The classic figures of looming neuroscience: each is a sweep of a stimulus of the catalogue."""

from __future__ import annotations

import itertools
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any

from oppload_cli.errors import ParameterError, suggestion
from oppload_cli.tuning.run import entry_named, swept

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from oppload_cli.stimulus.catalogue import Entry

_EVERY = "all"


@dataclass(frozen=True)
class Classic:
    """One figure.

    Attributes
    ----------
    title : str
        What it shows.
    kind : str
        The plot, as ``oppload plot --kind`` names it.
    stimulus : str
        In the catalogue.
    sweep : dict
        Lists of values by dotted key.
    changes : dict
        Other values of the stimulus by dotted key.
    settings : tuple of str
        Parameters of detectors; those of the user come later and win.
    presentations : int
        How often each stimulus is shown in a row.
    """

    title: str
    kind: str
    stimulus: str
    sweep: Mapping[str, list[Any]] = field(default_factory=dict)
    changes: Mapping[str, Any] = field(default_factory=dict)
    settings: tuple[str, ...] = ()
    presentations: int = 1


_PLACES = [-24, -18, -12, -6, 0, 6, 12, 18, 24]

FIGURES: dict[str, Classic] = {
    "peak-time": Classic(
        "Time and angular size at the peak",
        "contact",
        "klapoetke2017/loom-l-over-v",
        {"disk.growth.l_over_v_ms": [10, 20, 30, 40, 50, 60, 70, 80, 90, 100]},
        # A disk that stops growing has its largest edges just before: at 60 degrees, all
        # detectors whose response grows with the object would seem to have this threshold.
        # A frame is the smallest difference in time that can be seen.
        {"disk.growth.most_deg": 180, "display.frame_rate": 120},
    ),
    "size-speed": Classic(
        "Response over final size and edge speed",
        "heat",
        "klapoetke2017/loom-speed",
        {
            "disk.growth.speed_deg_s": [10, 20, 40, 80, 160],
            "disk.growth.end_deg": [15, 20, 30, 40, 50, 60, 70],
        },
        {"timing.motion_s": 3.0},
    ),
    "position": Classic(
        "Response over the position of a growing disk",
        "position",
        "klapoetke2017/loom-position",
        {"disk.centre_deg": [[right, up] for up, right in itertools.product(_PLACES, repeat=2)]},
        {"disk.growth.end_deg": 24, "disk.growth.speed_deg_s": 40, "timing.motion_s": 0.5},
        # OppLoD has a unit everywhere: the field of one is mapped.
        ("opplod.units=1x1",),
    ),
    "bar-ends": Classic(
        "A bar that grows at one end and at both",
        "ends",
        "klapoetke2017/bar-expand-10",
        {
            "bar.growth.sides": ["both", "forward"],
            "bar.axis_deg": list(range(0, 360, 30)),
        },
    ),
    "contrast": Classic(
        "Response over contrast of an approaching disk",
        "contrast",
        "controls/looming-contrast",
        {"disk.luminance": [0.0, 0.1, 0.2, 0.3, 0.4, 0.45, 0.55, 0.6, 0.7, 0.8, 0.9, 1.0]},
    ),
    "habituation": Classic(
        "Response to approaches that come every 2 s",
        "habituation",
        "klapoetke2017/loom-l-over-v",
        changes={
            "disk.growth.l_over_v_ms": [40],
            "timing.before_s": 0.6,
            "timing.motion_s": 1.0,
            "timing.after_s": 0.4,
        },
        presentations=10,
    ),
}


def figures_named(names: Sequence[str]) -> dict[str, Classic]:
    """Return the figures of some names, ``all`` for every one.

    Raises
    ------
    ParameterError
        If there is no such figure.
    """
    chosen = [one for name in names for one in (FIGURES if name == _EVERY else [name])]
    for name in chosen:
        if name not in FIGURES:
            hint = suggestion(name, (*FIGURES, _EVERY))
            raise ParameterError(f"--figure {name}: no such figure{hint}")
    return {name: FIGURES[name] for name in dict.fromkeys(chosen)}


def entry_of(name: str, changes: Mapping[str, Any], over: Sequence[str] = ()) -> Entry:
    """Return the stimuli of a figure.

    Parameters
    ----------
    name : str
        Of the figure.
    changes : mapping
        The user's values by dotted key.
    over : sequence of str
        As for :func:`oppload_cli.tuning.run.swept`: other values of what the figure sweeps.

    Raises
    ------
    ParameterError
        If `over` sweeps anything else, or cannot be understood.
    StimulusError
        If a key names no table or object of the stimulus.
    """
    figure = FIGURES[name]
    entry = entry_named(figure.stimulus).with_settings(dict(figure.changes))
    for key in changes:
        if key in figure.sweep:
            raise ParameterError(f"--change {key}: figure {name} sweeps it; give --over {key}=...")
    # What is swept once is no sweep: its value would be a column, and its name in every title.
    settled = {key: values[0] for key, values in entry.sweep.items() if key not in figure.sweep}
    entry = replace(entry, sweep={}).with_settings({**settled, **changes})
    entry = replace(entry, sweep={key: list(values) for key, values in figure.sweep.items()})
    if over:
        chosen = swept(entry, over).sweep
        other = [key for key in chosen if key not in figure.sweep]
        if other:
            swept_keys = " and ".join(figure.sweep) or "nothing"
            raise ParameterError(
                f"--over {over[list(chosen).index(other[0])]}: figure {name} sweeps {swept_keys}"
            )
        entry = replace(entry, sweep=entry.sweep | chosen)
    return replace(entry, name=name)
