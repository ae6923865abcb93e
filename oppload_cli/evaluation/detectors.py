"""The detectors to evaluate, with the parameters of their presets."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

from oppload_cli.errors import ParameterError, suggestion
from oppload_cli.models.presets import DEFAULT_PRESET, PRESETS
from oppload_cli.models.registry import ALL, detector_of, detectors
from oppload_cli.models.timebase import TimeParams
from oppload_cli.pipeline.repeats import RepeatParams
from oppload_cli.pipeline.settings import resolve

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence
    from pathlib import Path

    from oppload_cli.detection.alarm import AlarmParams
    from oppload_cli.schema import Parameters

_USUAL_PRESETS = (DEFAULT_PRESET, "reference")


@dataclass(frozen=True)
class EvaluatedDetector:
    """A detector with its working height in pixels and all of its parameters."""

    name: str  # ``NAME``, or ``NAME:PRESET`` of a detector that presets change
    meaning: str  # of the preset or the detector, in a line
    height: int
    params: Parameters
    alarm: AlarmParams
    repeats: RepeatParams = field(default_factory=RepeatParams)
    time: TimeParams = field(default_factory=TimeParams)

    @property
    def detector(self) -> str:
        """The name of the detector without its preset, as a frame's record has it."""
        return detector_of(self.params).name

    def as_dict(self) -> dict[str, Any]:
        """Return all settings that change the detector's responses or alarms, ready for JSON."""
        return {
            "meaning": self.meaning,
            "height": self.height,
            "parameters": self.params.resolved(self.height).as_dict(),
            "alarm": self.alarm.as_dict(),
            "repeats": self.repeats.as_dict(),
            "time": self.time.as_dict(),
        }


def evaluated_detectors(
    names: Iterable[str] = (),
    repeats: str | None = None,
    assignments: Sequence[str] = (),
    *,
    config: Path | None = None,
    height: str | None = None,
) -> list[EvaluatedDetector]:
    """Return the detectors to evaluate: the chosen ones, then the baselines.

    Parameters
    ----------
    names : iterable of str
        ``NAME`` (under preset ``default``, or that of `config`), ``NAME:PRESET``,
        ``NAME:VARIANT``, ``all`` or ``all:PRESET``.
        If they name no detector that presets change, all such detectors are evaluated under
        ``default`` and ``reference``.
    repeats : str, optional
        Which repeats all detectors leave out: ``near``, ``exact`` or ``keep`` (none).
    assignments : sequence of str
        ``set.parameter=value`` in place of the preset's value, for all detectors; the set is a
        detector, ``alarm``, ``repeats`` or ``time``.
    config : Path, optional
        Settings of ``oppload run`` in TOML, for all detectors; `repeats`, `assignments` and
        `height` override them. Without `names`, the detectors of the file are evaluated, under
        its preset.
    height : str, optional
        Working height of all detectors in pixels, in place of that of their presets.

    Raises
    ------
    ParameterError
        If a name is unknown, a value is out of range, a size is in degrees, the height is
        ``native``, or a set belongs to no evaluated detector.
    """
    preset = DEFAULT_PRESET
    if config:
        of_file = resolve(config=config)
        preset, names = of_file.preset, list(names) or of_file.models
    chosen = _full_names(names, preset)
    _, others = _by_presets()
    with_presets = [name for name in chosen if name not in others] or _usual()
    without = [name for name in others if detectors()[name].evaluated or name in chosen]
    options = {"repeats": repeats, "assignments": assignments, "config": config, "height": height}
    evaluated = [_evaluated(name, **options) for name in (*with_presets, *without)]
    sets = {*(each.detector for each in evaluated), "alarm", "repeats", "time"}
    for assignment in assignments:
        name = assignment.partition(".")[0].strip()
        if name not in sets:
            raise ParameterError(
                f"'{assignment}': the evaluation has no parameter set '{name}'; add a detector "
                f"with --model, or choose {', '.join(sorted(sets))}"
            )
    return evaluated


def _by_presets() -> tuple[list[str], list[str]]:
    """Return the names of the detectors that presets change, and of the other detectors."""
    known = detectors()
    changed = [name for name, each in known.items() if each.presets or len(each.alarm_floors) > 1]
    return changed, [name for name in known if name not in changed]


def _usual() -> list[str]:
    return [f"{name}:{preset}" for name in _by_presets()[0] for preset in _USUAL_PRESETS]


def _full_names(names: Iterable[str], usual: str = DEFAULT_PRESET) -> list[str]:
    """Return each name once, with its preset or else `usual`, and variants by their own names."""
    with_presets, others = _by_presets()
    full: list[str] = []
    for name in names:
        variant = name.replace(":", "_")
        head, _, preset = name.partition(":")
        if head == ALL:
            full += [f"{each}:{preset}" for each in with_presets] if preset else _usual()
            full += [other for other in others if not detectors()[other].variant_of]
        elif name in with_presets:
            full.append(f"{name}:{usual}")
        else:
            full.append(variant if variant in others else name)
    known = [*(f"{name}:{preset}" for name in with_presets for preset in PRESETS), *others]
    for name in full:
        head, _, preset = name.partition(":")
        if head in others and preset in PRESETS:
            raise ParameterError(f"model '{name}': no preset changes {head}; leave out ':{preset}'")
        if name not in known:
            # A name that was given without a preset gets a suggestion without one.
            like = known if preset else [*with_presets, *others]
            raise ParameterError(f"no model '{name}'{suggestion(name, like)}")
    return list(dict.fromkeys(full))


def _evaluated(full_name: str, **options: Any) -> EvaluatedDetector:
    """Return a detector with the parameters that `resolve` gives for these options."""
    name, _, preset = full_name.partition(":")
    preset = preset or DEFAULT_PRESET
    detector = detectors()[name]
    settings = resolve(preset=preset, models=[name], **options)
    for size, degrees in settings.angles.items():
        raise ParameterError(
            f"{size}={degrees:g}deg: the fields of view of labelled clips are not known; give the "
            "size in pixels"
        )
    # Detectors whose alarms are equal in all of their parameters can share one pass.
    settings = settings.with_all_detectors()
    if settings.height is None:
        raise ParameterError(
            "labelled clips may differ in size, so that height 'native' has no meaning for all of "
            "them; give the height in pixels"
        )
    return EvaluatedDetector(
        full_name,
        PRESETS[preset].meaning if full_name != name else detector.meaning,
        settings.height,
        settings.model_params()[0],
        settings.alarm,
        settings.repeats,
        settings.time,
    )


def full_label(full_name: str) -> str:
    """Return the name of an evaluated detector in pages and figures, e.g. ``OppLoD default``."""
    name, _, preset = full_name.partition(":")
    label = detectors()[name].label if name in detectors() else name.replace("_", " ")
    return f"{label} {preset}".rstrip()
