"""The detectors to evaluate, with their parameters."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

from oppload_cli.errors import ParameterError
from oppload_cli.frames.repeats import RepeatParams
from oppload_cli.models.registry import detectors, names_of
from oppload_cli.models.timebase import TimeParams
from oppload_cli.pipeline.settings import resolve
from oppload_cli.video.frames import NATIVE

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping
    from pathlib import Path

    from oppload_cli.detection.alarm import AlarmParams
    from oppload_cli.schema import Parameters


@dataclass(frozen=True)
class EvaluatedDetector:
    """A detector with all settings that change its responses or alarms."""

    name: str
    meaning: str  # in a line
    height: int | str  # working height in pixels, or auto
    params: Parameters
    alarm: AlarmParams
    repeats: RepeatParams = field(default_factory=RepeatParams)
    time: TimeParams = field(default_factory=TimeParams)

    def as_dict(self) -> dict[str, Any]:
        """Return all settings that change the detector's responses or alarms, ready for JSON."""
        height = detectors()[self.name].height if isinstance(self.height, str) else self.height
        return {
            "meaning": self.meaning,
            "height": height,
            "parameters": self.params.resolved(height).as_dict(),
            "alarm": self.alarm.as_dict(),
            "repeats": self.repeats.as_dict(),
            "time": self.time.as_dict(),
        }


def evaluated_detectors(
    names: Iterable[str] = (),
    repeats: str | None = None,
    assignments: Mapping[str, object] | None = None,
    *,
    config: Path | None = None,
    height: str | None = None,
) -> list[EvaluatedDetector]:
    """Return the detectors to evaluate: the chosen ones, then the baselines.

    Parameters
    ----------
    names : iterable of str
        Names of detectors, or ``all``; if left out, those of `config`. If no version of OppLoD is
        among them, ``opplod`` and ``opplod_reference`` are evaluated too.
    repeats : str, optional
        Which repeats all detectors leave out: ``near``, ``exact`` or ``keep`` (none).
    assignments : mapping of str, optional
        Values in place of the defaults by ``set.parameter``; the set is a detector, ``alarm``,
        ``repeats`` or ``time``.
    config : Path, optional
        Settings of ``oppload run`` in TOML; `names`, `repeats`, `assignments` and `height` override
        them.
    height : str, optional
        Working height of all detectors in pixels, in place of their own.

    Raises
    ------
    ParameterError
        If a name is unknown, a value is out of range, a size is in degrees, the height is
        ``native``, or a set belongs to no evaluated detector.
    """
    known = detectors()
    chosen = [name for text in names for name in names_of(text)]
    if not chosen:
        chosen = list(resolve(config=config).models) if config else []
    if not any(name.startswith("opplod") for name in chosen):
        chosen = ["opplod", "opplod_reference", *chosen]
    baselines = [name for name, detector in known.items() if detector.evaluated]
    models = list(dict.fromkeys((*chosen, *baselines)))
    sets = {*models, "alarm", "repeats", "time"}
    for target in assignments or {}:
        name = target.partition(".")[0]
        if name not in sets:
            raise ParameterError(
                f"'{target}': the evaluation has no parameter set '{name}'; add a detector "
                f"with --model, or choose {', '.join(sorted(sets))}"
            )
    settings = resolve(
        models=models, repeats=repeats, assignments=assignments, config=config, height=height
    )
    for size, degrees in settings.angles.items():
        raise ParameterError(
            f"{size}={degrees:g}deg: the fields of view of labelled clips are not known; give the "
            "size in pixels"
        )
    if settings.height == NATIVE:
        raise ParameterError(
            "labelled clips may differ in size, so that height 'native' has no meaning for all of "
            "them; give the height in pixels"
        )
    return [
        EvaluatedDetector(
            name,
            known[name].meaning,
            settings.height,
            settings.groups[name],
            settings.alarm,
            settings.repeats,
            settings.time,
        )
        for name in models
    ]


def full_label(name: str) -> str:
    """Return the label of an evaluated detector in pages and figures; a measure keeps its name."""
    return detectors()[name].label if name in detectors() else name.replace("_", " ")
