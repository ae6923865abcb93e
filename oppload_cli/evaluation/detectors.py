"""The detectors that are evaluated: each under the presets that change it."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any

from oppload_cli.detection.parameters import alarm_params
from oppload_cli.errors import ParameterError, suggestion
from oppload_cli.models.presets import DEFAULT_PRESET, PRESETS
from oppload_cli.models.registry import ALL, detector_of, detectors, parameters_of
from oppload_cli.models.timebase import TimeParams, time_params
from oppload_cli.pipeline.repeats import RepeatParams
from oppload_cli.pipeline.settings import resolve

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

    from oppload_cli.detection.parameters import AlarmParams
    from oppload_cli.schema import Parameters

_USUAL_PRESETS = (DEFAULT_PRESET, "reference")


@dataclass(frozen=True)
class EvaluatedDetector:
    """A detector with its parameters, its alarm and its working height.

    Attributes
    ----------
    name : str
        ``NAME``, or ``NAME:PRESET`` of a detector that presets change.
    meaning : str
        One line for the reader.
    height : int
        Working height in pixels.
    params : Parameters
        Of the detector.
    alarm : AlarmParams
        Of its alarm.
    repeats : RepeatParams
        Of repeats.
    time : TimeParams
        Time base of the detector.
    """

    name: str
    meaning: str
    height: int
    params: Parameters
    alarm: AlarmParams
    repeats: RepeatParams = field(default_factory=RepeatParams)
    time: TimeParams = field(default_factory=TimeParams)

    @property
    def detector(self) -> str:
        """The name of the detector in a frame's record."""
        return detector_of(self.params).name

    def as_dict(self) -> dict[str, Any]:
        """Return everything that its responses and alarms depend on, ready for JSON."""
        return {
            "meaning": self.meaning,
            "height": self.height,
            "parameters": self.params.resolved(self.height).as_dict(),
            "alarm": self.alarm.as_dict(),
            "repeats": self.repeats.as_dict(),
            "time": self.time.as_dict(),
        }


def evaluated_detectors(
    names: Iterable[str] = (), repeats: str | None = None, assignments: Sequence[str] = ()
) -> list[EvaluatedDetector]:
    """Return the detectors to evaluate: those chosen, then the baselines.

    Parameters
    ----------
    names : iterable of str
        ``NAME`` (under preset ``default``), ``NAME:PRESET``, ``NAME:VARIANT``, or ``all``.
        If no detector that presets change is named, all of these are evaluated under ``default``
        and ``reference``.
    repeats : str, optional
        How all detectors take repeats: ``near``, ``exact`` or ``keep``.
    assignments : sequence of str
        ``set.parameter=value`` for all of them, in place of the value of the preset: a parameter of
        a detector, of ``alarm``, ``repeats`` or ``time``.

    Raises
    ------
    ParameterError
        If a name is not known, a value out of range, or a parameter that of no evaluated detector.
    """
    chosen = _full_names(names)
    _, others = _by_presets()
    own = [name for name in chosen if name not in others] or _usual()
    rest = [name for name in others if detectors()[name].evaluated or name in chosen]
    handling = RepeatParams(handling=repeats) if repeats else RepeatParams()
    found = [_evaluated(name, handling) for name in (*own, *rest)]
    if not assignments:
        return found
    changed = [_with_settings(each, repeats, assignments) for each in found]
    sets = {*(each.detector for each in found), "alarm", "repeats", "time"}
    for assignment in assignments:
        name = assignment.partition(".")[0].strip()
        if name not in sets:
            raise ParameterError(
                f"'{assignment}' is of no detector that is evaluated; add it with --model, or "
                f"choose {', '.join(sorted(sets))}"
            )
    return changed


def chosen_detectors(names: Iterable[str] = ()) -> list[EvaluatedDetector]:
    """Return some detectors, and no others; all of them where none is named.

    Parameters
    ----------
    names : iterable of str
        As for `evaluated_detectors`. If none or ``all`` is named, the detectors that presets change
        are returned under ``default`` and ``reference``.

    Raises
    ------
    ParameterError
        If a name is not known.
    """
    return [_evaluated(name, RepeatParams()) for name in _full_names(list(names) or [ALL])]


def _by_presets() -> tuple[list[str], list[str]]:
    """Return the names of the detectors that presets change, and those of the others."""
    changed = [name for name, each in detectors().items() if each.presets]
    return changed, [name for name in detectors() if name not in changed]


def _usual() -> list[str]:
    return [f"{name}:{preset}" for name in _by_presets()[0] for preset in _USUAL_PRESETS]


def _full_names(names: Iterable[str]) -> list[str]:
    """Return each name once, with missing presets filled in and variants by their own names."""
    with_presets, others = _by_presets()
    full: list[str] = []
    for name in names:
        variant = name.replace(":", "_")
        if name == ALL:
            full += _usual()
            full += [other for other in others if not detectors()[other].variant_of]
        elif name in with_presets:
            full.append(f"{name}:{DEFAULT_PRESET}")
        else:
            full.append(variant if variant in others else name)
    known = [*(f"{name}:{preset}" for name in with_presets for preset in PRESETS), *others]
    for name in full:
        if name not in known:
            raise ParameterError(f"no model '{name}'{suggestion(name, known)}")
    return list(dict.fromkeys(full))


def _evaluated(full_name: str, repeats: RepeatParams) -> EvaluatedDetector:
    name, _, preset = full_name.partition(":")
    preset = preset or DEFAULT_PRESET
    detector = detectors()[name]
    return EvaluatedDetector(
        full_name,
        PRESETS[preset].meaning if detector.presets else detector.meaning,
        PRESETS[preset].height,
        parameters_of(name, preset),
        alarm_params(preset),
        repeats,
        time_params(preset),
    )


def _with_settings(
    evaluated: EvaluatedDetector, repeats: str | None, assignments: Sequence[str]
) -> EvaluatedDetector:
    """Return an evaluated detector with values in place of those of its preset."""
    preset = evaluated.name.partition(":")[2] or DEFAULT_PRESET
    settings = resolve(
        preset=preset, models=[evaluated.detector], repeats=repeats, assignments=assignments
    )
    return replace(
        evaluated,
        params=settings.model_params()[0],
        alarm=settings.alarm,
        repeats=settings.repeats,
        time=settings.time,
    )


def label_of(full_name: str) -> str:
    """Return the label of an evaluated detector for the reader, e.g. ``OppLoD default``."""
    name, _, preset = full_name.partition(":")
    label = detectors()[name].label if name in detectors() else name.replace("_", " ")
    return f"{label} {preset}".rstrip()
