"""The sweeps of ``oppload tune``: of a stimulus that the user chooses, and of classic figures.

A classic figure of looming neuroscience shows the responses to a sweep of a stimulus of the
catalogue.
"""

from __future__ import annotations

import itertools
import math
import tomllib
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any, NamedTuple

from oppload_cli.errors import ParameterError, StimulusError, faults_at, suggestion
from oppload_cli.models.registry import parameters_of
from oppload_cli.pipeline.settings import Settings, check_assignments, resolve
from oppload_cli.results.tuning import direction_of
from oppload_cli.stimulus.catalogue import Entry, find
from oppload_cli.stimulus.protocol_tables import key_of, value_at

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    Over = Mapping[str, list[Any] | None]


_NEURONS = "klapoetke2017/"  # stimuli that were shown to LPLC2 neurons
_USUAL = "opplod_reference", "dlgmd"
_EVERY = "all"
_MOST_VALUES = 1000
# Values of an option --over, in messages; single quotes keep the shell from changing the brackets.
EXAMPLES = "10,20,40, 0:330:30 (from, to, step), '[[0,0],[10,0]]' or '[\"forward\",\"both\"]'"
_UNREADABLE = f"its values cannot be read; write values such as {EXAMPLES}"
_TWICE = "'{}' is swept already; give all values once"


@dataclass(frozen=True)
class _Classic:
    """A classic figure: the sweep of its table, and the kind of its plot."""

    title: str
    kind: str  # of the plot, as for `oppload plot --kind`
    stimulus: str  # in the catalogue
    sweep: dict[str, list[Any]] = field(default_factory=dict)  # by dotted key
    changes: dict[str, Any] = field(default_factory=dict)  # of the stimulus, by dotted key
    settings: dict[str, Any] = field(
        default_factory=dict
    )  # of detectors, unless the user sets them
    presentations: int = 1  # of each stimulus, in a row


_PLACES = [-24, -18, -12, -6, 0, 6, 12, 18, 24]

FIGURES: dict[str, _Classic] = {
    "peak-time": _Classic(
        "Time and angular size at the peak",
        "contact",
        "klapoetke2017/loom-l-over-v",
        {"disk.growth.l_over_v_ms": [10, 20, 30, 40, 50, 60, 70, 80, 90, 100]},
        # The disk grows to 180 degrees. If it stopped at 60 degrees, each detector whose response
        # grows with the object would have its peak there, and seem to have this threshold.
        # The frame rate is high, because the time of a peak is exact to one frame only.
        {"disk.growth.most_deg": 180, "display.frame_rate": 120},
    ),
    "size-speed": _Classic(
        "Response over final size and edge speed",
        "heat",
        "klapoetke2017/loom-speed",
        {
            "disk.growth.speed_deg_s": [10, 20, 40, 80, 160],
            "disk.growth.end_deg": [15, 20, 30, 40, 50, 60, 70],
        },
        {"timing.motion_s": 3.0},
    ),
    "position": _Classic(
        "Response over the position of a growing disk",
        "position",
        "klapoetke2017/loom-position",
        {"disk.centre_deg": [[right, up] for up, right in itertools.product(_PLACES, repeat=2)]},
        # Without a pause: after a pause, detectors respond to the start of the motion at any place.
        {
            "disk.growth.end_deg": 24,
            "disk.growth.speed_deg_s": 40,
            "timing.before_s": 0,
            "timing.motion_s": 0.5,
        },
        # One unit, so that the map shows its receptive field.
        {"units": "1x1"},
    ),
    "bar-ends": _Classic(
        "A bar that grows at one end and at both",
        "ends",
        "klapoetke2017/bar-expand-10",
        {
            "bar.growth.sides": ["both", "forward"],
            # The diagonals are among the axes, as OppLoD responds most along them.
            "bar.axis_deg": list(range(0, 360, 15)),
        },
        # Without a pause, as above. The speed suits the default detectors. The bar is short at the
        # start, so that no peak falls into the warm-up.
        {
            "bar.size_deg": 2,
            "bar.growth.speed_deg_s": 60,
            "timing.before_s": 0,
            "timing.motion_s": 0.5,
        },
    ),
    "contrast": _Classic(
        "Response over contrast of an approaching disk",
        "contrast",
        "controls/looming-contrast",
        {"disk.luminance": [0.0, 0.1, 0.2, 0.3, 0.4, 0.45, 0.55, 0.6, 0.7, 0.8, 0.9, 1.0]},
    ),
    "habituation": _Classic(
        "Response to approaches that come every 2 s",
        "habituation",
        "klapoetke2017/loom-l-over-v",
        changes={
            "disk.growth.l_over_v_ms": 40,
            "timing.before_s": 0.6,
            "timing.motion_s": 1.0,
            "timing.after_s": 0.4,
        },
        presentations=10,
    ),
}


class Sweep(NamedTuple):
    """A stimulus with its sweep, the settings of the detectors, and the classic figure."""

    entry: Entry
    settings: Settings
    presentations: int = 1  # of each stimulus, in a row
    figure: Mapping[str, str] = {}  # name, title and kind; empty without a classic figure
    # The values of dotted keys that the stimulus's own sweep varies, but this sweep does not.
    fixed: Mapping[str, Any] = {}
    # The values of `--change` by dotted key, without those of keys that are swept.
    changes: Mapping[str, Any] = {}


def sweeps(
    stimulus: str | None,
    figures: Sequence[str],
    changes: dict[str, Any],
    over: Over,
    settings: Mapping[str, Any],
) -> list[Sweep]:
    """Return the sweeps that a user asks for, after a check of all their options.

    Parameters
    ----------
    stimulus : str or None
        A name of the catalogue or a TOML file; None for `figures`.
    figures : sequence of str
        Names of classic figures, or ``all``.
    changes : dict
        Changed values of the stimulus, by dotted key.
    over : mapping of str to list or None
        The values of each swept parameter; None for those of the stimulus's own sweep. If empty,
        the stimulus keeps its own sweep. A parameter is a key such as ``bar.axis_deg`` or a word
        such as ``axis``.
    settings : mapping
        The arguments of :func:`oppload_cli.pipeline.settings.resolve`.

    Raises
    ------
    ParameterError
        If a figure, a parameter, a setting or values cannot be understood.
    StimulusError
        If there is no such stimulus, or if nothing is swept.
    """
    if stimulus is not None:
        return [_checked(_sweep_of(stimulus, changes, over, settings), settings)]
    names = [name for given in figures for name in (FIGURES if given == _EVERY else [given])]
    for name in names:
        if name not in FIGURES:
            hint = suggestion(name, (*FIGURES, _EVERY))
            raise ParameterError(f"--figure {name}: no such figure{hint}")
    if over and len(set(names)) > 1:
        raise ParameterError("--over needs exactly one --figure; give one of them")
    return [
        _checked(_figure_sweep(name, changes, over, settings), settings)
        for name in dict.fromkeys(names)
    ]


def _checked(sweep: Sweep, settings: Mapping[str, Any]) -> Sweep:
    check_assignments(settings.get("assignments", {}), sweep.settings.models, measure_rmo=False)
    return sweep


def _sweep_of(
    stimulus: str, changes: dict[str, Any], over: Over, settings: Mapping[str, Any]
) -> Sweep:
    """Return the sweep of a stimulus; the arguments are those of `sweeps`."""
    named = _entry_named(stimulus)
    changes = named.in_full(changes)
    own = named.with_settings(changes)
    entry = _swept(own, over)
    for key in changes:
        if over and key in entry.sweep:
            raise ParameterError(f"--change {key}: --over sweeps it; leave one of the two out")
    replaced = own.sweep.keys() - entry.sweep.keys() if own.only == "*" else set()
    for key in sorted(replaced):
        first, *others = own.sweep[key]
        if not others:  # a single value is no sweep that --over could replace
            entry = replace(entry.with_settings({key: first}), sweep=entry.sweep)
            replaced.remove(key)
        elif key in changes:
            raise ParameterError(
                f"--change {key}: gives several values beside --over; give one of them, or "
                f"sweep them with --over {key}=..."
            )
    values = {key: value_at(entry.table, key) for key in sorted(replaced)}
    fixed = {key: value for key, value in values.items() if value is not None}
    changes = {key: value for key, value in changes.items() if key not in entry.sweep}
    resolved = resolve(**settings, usual=_models_for(named.name))
    return Sweep(entry, resolved, fixed=fixed, changes=changes)


def _models_for(stimulus: str) -> tuple[str, ...]:
    """Return the detectors that tune shows if the user names none: those that fit the stimulus."""
    if stimulus.startswith(_NEURONS):
        return "opplod_lplc2", "opplod_reference"
    return _USUAL


def _figure_sweep(
    name: str, changes: dict[str, Any], over: Over, settings: Mapping[str, Any]
) -> Sweep:
    """Return the sweep of a classic figure; the other arguments are those of `sweeps`."""
    figure = FIGURES[name]
    own = _entry_named(figure.stimulus).with_settings(figure.changes)
    entry = replace(own, sweep=figure.sweep)
    changes = entry.in_full(changes)
    for key in changes:
        if key in figure.sweep:
            raise ParameterError(f"--change {key}: figure {name} sweeps it; give --over {key}=...")
    # Other keys of the stimulus's own sweep get their first value. If they stayed in the sweep,
    # each would be a column of the table and a part of each stimulus's name.
    first = {key: values[0] for key, values in own.sweep.items() if key not in figure.sweep}
    entry = entry.with_settings({**first, **changes})
    if over:  # it changes the values of the sweep
        chosen = _swept(entry, over).sweep
        for word, key in zip(over, chosen, strict=True):
            if key not in figure.sweep:
                swept_keys = " and ".join(figure.sweep) or "nothing"
                raise ParameterError(
                    f"--over {word}: figure {name} sweeps {swept_keys}; make a figure for each "
                    f"value with --change {key}=VALUE"
                )
        entry = replace(entry, sweep=entry.sweep | chosen)
    own_settings = {
        f"{model}.{name}": value
        for model in resolve(**settings, usual=_USUAL).models
        for name, value in figure.settings.items()
        if name in parameters_of(model).names()
    }
    assignments = own_settings | dict(settings.get("assignments", {}))
    resolved = resolve(**{**settings, "assignments": assignments}, usual=_USUAL)
    words = {"name": name, "title": figure.title, "kind": figure.kind}
    entry = replace(entry, name=name)
    return Sweep(entry, resolved, figure.presentations, words, changes=changes)


def _entry_named(name: str) -> Entry:
    """Return the one stimulus with a name in the catalogue, or of a TOML file."""
    entries = find(name)
    if len(entries) > 1:
        raise StimulusError(
            f"'{name}' stands for {len(entries)} stimuli; name one, such as '{entries[0].name}'"
        )
    return entries[0]


def _swept(entry: Entry, over: Over) -> Entry:
    """Return a stimulus with the sweep that the user asks for."""
    if not over:
        if not entry.sweep:
            raise StimulusError(
                f"{entry.name}: has no sweep of its own; give one, e.g. --over direction=0:315:45"
            )
        return entry
    chosen: dict[str, list[Any]] = {}
    own = entry
    if entry.only != "*":  # one stimulus of the sweep was named: it keeps its values
        members = entry.values()
        if len(members) > 1:
            raise ParameterError(
                f"'{entry.only}' stands for {len(members)} stimuli, and --over sweeps one; name "
                f"one, such as '{next(iter(members))}'"
            )
        ((name, member_values),) = members.items()
        entry = replace(entry, name=name, sweep={}, only="*").with_settings(member_values)
    for word, values in over.items():
        key = key_of(word, own.name, own.table, own.sweep, "--over")
        with faults_at(f"--over {word}"):
            if key in chosen:
                raise ParameterError(_TWICE.format(key))
            if values is None and key not in entry.sweep:
                raise ParameterError(
                    f"{entry.name} has no values of its own for '{key}'; write --over "
                    f"{word}=VALUES, with VALUES such as {EXAMPLES}"
                )
            chosen[key] = entry.sweep[key] if values is None else _checked_values(values)
            if key.endswith(".centre_deg"):
                _check_places(word, chosen[key])
            if values is not None and direction_of([key]):
                _check_turns(chosen[key])
    # with_settings() refuses a key that names no table; making the protocols checks the values.
    first = {key: chosen[key][0] for key in chosen}
    return replace(entry.with_settings(first, "--over"), sweep=chosen)


def _checked_values(values: list[Any]) -> list[Any]:
    """Return the values of a sweep; raise ParameterError for none, or for one that is repeated."""
    if not values:
        raise ParameterError(_UNREADABLE)
    repeated = next((value for value in values if values.count(value) > 1), None)
    if repeated is not None:
        raise ParameterError(f"{repeated} is there twice; leave one out")
    return values


def parsed_over(texts: Sequence[str]) -> dict[str, list[Any] | None]:
    """Return the argument `over` of `sweeps` for texts such as ``direction=0:315:45``.

    The values are ``10,20,40``, ``0:330:30`` (from, to, step; both ends included), or a list of
    TOML, such as ``[[0,0],[10,0]]``. Without them the stimulus's own count. Raises ParameterError
    if values cannot be read.
    """
    over: dict[str, list[Any] | None] = {}
    for text in texts:
        word, equals, values = text.partition("=")
        word = word.strip()
        with faults_at(f"--over {text}"):
            if word in over:
                raise ParameterError(_TWICE.format(word))
            over[word] = _values_of(values) if equals else None
    return over


def _values_of(values: str) -> list[Any]:
    try:
        if values.count(":") == 2:
            listed = _range(*(float(end) for end in values.split(":")))
        else:
            array = values if values.strip().startswith("[") else f"[{values}]"
            listed = tomllib.loads(f"values = {array}")["values"]
    except ParameterError:  # also a ValueError, but with a better message
        raise
    except ValueError:
        listed = []
    return _checked_values(listed)


def _check_places(word: str, values: Sequence[Any]) -> None:
    """Raise ParameterError if a value is not a position, with the right form in the message."""
    if all(isinstance(value, list) for value in values):
        return
    places = [value if isinstance(value, list) else [value, 0] for value in values]
    written = f"{word}={places}".replace(" ", "")
    raise ParameterError(f"a position is two numbers, [right,up]; write {written[:200]}")


def _check_turns(values: Sequence[Any]) -> None:
    """Raise ParameterError if two directions are the same one, such as 0 and 360 degrees."""
    first_values: dict[float, float] = {}  # by direction
    for value in values:
        if not isinstance(value, int | float):  # making the protocols refuses it
            return
        first = first_values.setdefault(round(value, 6) % 360, value)
        if first != value:
            raise ParameterError(
                f"{value:g} degrees are the same direction as {first:g}; leave one of the two out, "
                "as in 0:315:45"
            )


def _range(first: float, last: float, step: float) -> list[Any]:
    """Return the values from first to last; none if the step is 0 or a number is not finite."""
    if not step or not math.isfinite(first + last + step):
        return []
    steps = (last - first) / step + 1e-9
    if steps < 0:
        raise ParameterError(
            f"steps of {step:g} from {first:g} lead away from {last:g}; exchange the ends, or "
            "change the sign of the step"
        )
    if steps >= _MOST_VALUES:
        raise ParameterError(f"these are more than {_MOST_VALUES:,} values; take a larger step")
    values = [first + index * step for index in range(math.floor(steps) + 1)]
    return [int(value) if value.is_integer() else value for value in values]
