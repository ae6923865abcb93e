"""The settings of a run, and the origin of each setting.

A file of settings overrides the defaults, and the command line overrides both.
"""

from __future__ import annotations

import json
import tomllib
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any, cast

from oppload_cli.detection.alarm import AlarmParams, alarm_params, alarm_params_with
from oppload_cli.detection.contact import PlaceParams
from oppload_cli.errors import ParameterError, faults_at, suggestion
from oppload_cli.files.reading import reading, text_of
from oppload_cli.frames.repeats import RepeatParams
from oppload_cli.models.registry import (
    default_names,
    detector_named,
    detectors,
    known_names,
    names_of,
    other_heights,
    parameters_of,
    preset_is_gone,
)
from oppload_cli.models.timebase import TimeParams
from oppload_cli.motion.rmo import RmoParams
from oppload_cli.video.frames import AUTO, parse_height, pixels_of
from oppload_cli.video.optics import FOV, parse_fov

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Mapping, Sequence
    from pathlib import Path

    from oppload_cli.schema import Parameters
    from oppload_cli.video.frames import WorkingSize
    from oppload_cli.video.optics import Optics


_DEFAULT, _COMMAND_LINE = "default", "command line"  # origins of settings
_SIDECARS = ("oppload.result/2", "oppload.tuning/1")  # schemas of sidecars with settings
_USUAL, ALL_COLUMNS = "usual", "all"  # values of the setting `columns`


@dataclass(frozen=True)
class Settings:
    """All settings that determine how an input is analysed."""

    models: tuple[str, ...]  # the detectors to run, in order
    height: int | str  # working height in pixels, native, or auto: that of each detector
    measure_rmo: bool
    # Parameter sets by name: at least those of the detectors to run, then ``alarm``, ``places``,
    # ``rmo``, ``repeats`` and ``time``.
    groups: dict[str, Parameters]
    # Origin of each setting, by its dotted name: ``default``, the path of a file, or
    # ``command line``.
    origins: dict[str, str] = field(default_factory=dict)
    columns: str = _USUAL  # or ``all``, with the inner values of the detectors
    fov: float | None = None  # degrees across the width of the frame; None if it is not known
    # Sizes that the user gave in degrees, by dotted name; `seen_through` converts them to pixels.
    angles: dict[str, float] = field(default_factory=dict)

    @property
    def pixels(self) -> int | None:
        """Working height in pixels at which frames are measured; None for the native size."""
        return pixels_of(self.height)

    @property
    def other_heights(self) -> tuple[int, ...]:
        """Working heights in pixels that some detectors need besides."""
        return other_heights(self.models) if self.height == AUTO else ()

    @property
    def with_alarm(self) -> list[str]:
        """The detectors to run that have an alarm."""
        return [name for name in self.models if self.alarm.rule_of(name).floor is not None]

    @property
    def alarm(self) -> AlarmParams:
        """Parameters of the alarms."""
        return cast("AlarmParams", self.groups["alarm"])

    @property
    def places(self) -> PlaceParams:
        """Parameters of the looming objects."""
        return cast("PlaceParams", self.groups["places"])

    @property
    def rmo(self) -> RmoParams | None:
        """Parameters of radial motion opponency; None if it is not measured."""
        return cast("RmoParams", self.groups["rmo"]) if self.measure_rmo else None

    @property
    def repeats(self) -> RepeatParams:
        """Parameters of repeats."""
        return cast("RepeatParams", self.groups["repeats"])

    @property
    def time(self) -> TimeParams:
        """The time base."""
        return cast("TimeParams", self.groups["time"])

    def model_params(self) -> list[Parameters]:
        """Return the parameter sets of the detectors to run, in order.

        Raises ParameterError for a size in degrees that :meth:`seen_through` has not converted to
        pixels.
        """
        for name, degrees in self.angles.items():
            raise ParameterError(
                f"{name}={degrees:g}deg needs the field of view; give it with --fov DEGREES (in "
                f"Python fov=DEGREES), or the size in pixels"
            )
        return [self.groups[name] for name in self.models]

    def without_idle_detectors(self) -> Settings:
        """Return the same settings without detectors that do not run, unless a value was set."""
        known = known_names()
        changed = {name for name, origin in self.origins.items() if origin != _DEFAULT}
        kept = {name for name in known if f"alarm.{name}_floor" in changed}
        kept |= {*self.models, *(name.partition(".")[0] for name in changed)}
        needed = [name for name in known if name in kept]
        groups = {
            name: group for name, group in self.groups.items() if name in kept or name not in known
        }
        names = alarm_params_with(needed).names()
        alarm = {name: value for name, value in self.alarm.as_dict().items() if name in names}
        return replace(self, groups={**groups, "alarm": alarm_params_with(needed, **alarm)})

    def seen_through(self, optics: Optics | None, working: WorkingSize) -> Settings:
        """Return the same settings with sizes in degrees converted to pixels of the `working` size.

        A size in degrees is the angle of a length in the middle of the frame. If `optics` is None,
        the settings do not change. Raises ParameterError if a size in pixels is out of range.
        """
        if optics is None:
            return self
        groups = dict(self.groups)
        for full_name, degrees in self.angles.items():
            group, _, name = full_name.partition(".")
            height = min(working.shape)
            scale = self.height_of(group, height) / height / working.scale_y
            pixels = round(optics.pixels(degrees) * scale)
            with faults_at(f"{full_name}={degrees:g}deg"):
                groups[group] = groups[group].replaced(**{name: pixels})
        return replace(self, groups=groups, angles={})

    def with_all_detectors(self) -> Settings:
        """Return the same settings with the parameter set and the floor of every detector."""
        known = known_names()
        if all(name in self.groups for name in known):
            return self
        sets = {name: parameters_of(name) for name in known}
        alarm = alarm_params_with(known, **self.alarm.as_dict())
        return replace(self, groups={**sets, **self.groups, "alarm": alarm})

    def resolved(self, height: int) -> dict[str, Parameters]:
        """Return all parameter sets, with values in place of those that depend on the height.

        `height` is the working height: the shorter side of the frame.
        """
        return {
            name: group.resolved(self.height_of(name, height))
            for name, group in self.groups.items()
        }

    def height_of(self, group: str, height: int) -> int:
        """Return the working height in px of a detector; `height` is that of the frames."""
        own = self.height == AUTO and group in self.models
        return detector_named(group).height if own else height


def parameter_sets() -> dict[str, tuple[str, type[Parameters]]]:
    """Return the meaning and the class of each parameter set, by its name in settings."""
    return {
        **{name: (detector.meaning, detector.parameters) for name, detector in detectors().items()},
        "alarm": ("the alarm of each model", type(alarm_params())),
        "places": (
            "looming objects: their number, their places and their times to contact",
            PlaceParams,
        ),
        "rmo": ("radial motion opponency of motion vectors", RmoParams),
        "repeats": ("repeats: frames that show the same picture as the frame before", RepeatParams),
        "time": ("the time base of the models", TimeParams),
    }


def resolve(
    *,
    config: Path | None = None,
    models: Sequence[str] = (),
    height: str | None = None,
    fov: str | None = None,
    repeats: str | None = None,
    measure_rmo: bool | None = None,
    assignments: Mapping[str, object] | None = None,
    usual: Sequence[str] = (),
    columns: str | None = None,
) -> Settings:
    """Resolve the settings of a run from the defaults, a TOML file and the command line.

    A text or value has the meaning of the option of ``oppload run`` with the same name. If it is
    left out, the file decides, or else the default.

    Parameters
    ----------
    config : Path, optional
        A TOML file with ``models``, ``height``, ``fov``, ``measure_rmo``, ``columns``
        and a table per parameter set; or the sidecar of a result, whose settings are taken.
    models : sequence of str
        Names of detectors to run, or ``all``; a text may hold several names, separated by commas.
    repeats : str, optional
        ``near``, ``exact`` or ``keep``, in place of the parameter ``repeats.handling``.
    assignments : mapping of str, optional
        Values of single parameters by ``set.parameter``, such as ``{"opplod.gain": 2}``. A text is
        read as on the command line; a size may be given as ``60deg``.
    usual : sequence of str
        The detectors if neither `models` nor the file names any; OppLoD and D-LGMD if left out.

    Raises
    ------
    ParameterError
        If a name is unknown or a value out of range; the message names the place.
    """
    content, assignments = _read(config) if config else {}, dict(assignments or {})
    file_name = str(config) if config else ""
    usual = usual or default_names()
    needed = _needed_detectors(_models(models) if models else usual, content, assignments)
    groups: dict[str, Parameters] = {
        **{name: parameters_of(name) for name in needed},
        "alarm": alarm_params_with(needed),
        "places": PlaceParams(),
        "rmo": RmoParams(),
        "repeats": RepeatParams(),
        "time": TimeParams(),
    }
    known = {f"{group}.{name}" for group, params in groups.items() for name in params.names()}
    origins = dict.fromkeys([*_TOP_READERS, *sorted(known)], _DEFAULT)
    settings = Settings(tuple(usual), AUTO, True, groups, origins)
    settings = _with_file(settings, content, file_name)
    options = {
        "models": tuple(models) or None,
        "height": height,
        "fov": fov,
        "measure_rmo": measure_rmo,
        "columns": columns,
    }
    if repeats:
        if "repeats.handling" in assignments:
            raise ParameterError("--repeats and --set repeats.handling are the same; give one")
        assignments["repeats.handling"] = repeats
    return _with_command_line(settings, options, assignments).without_idle_detectors()


def check_assignments(
    assignments: Mapping[str, object], models: Sequence[str], *, measure_rmo: bool
) -> None:
    """Raise ParameterError if a single setting belongs to a part that does not run.

    `assignments` are those of :func:`resolve`, `models` the detectors that run.
    """
    idle = set(known_names()) - set(models)
    floors = {f"alarm.{name}_floor": name for name in idle}
    for target, value in assignments.items():
        name = floors.get(target, target.partition(".")[0])
        if name in idle:
            raise ParameterError(
                f"setting {target}={value} has no effect, as '{name}' does not run; give --model "
                f"{name} (in Python models) too, or leave it out"
            )
        if name == "rmo" and not measure_rmo:
            raise ParameterError(
                f"setting {target}={value} has no effect, as RMO is not measured; leave it out"
            )


def _needed_detectors(
    models: Sequence[str], content: Mapping[str, Any], assignments: Iterable[str]
) -> Sequence[str]:
    """Return the detectors whose parameters are needed: all, if any of them may have a setting."""
    others = {*models, "places", "rmo", "repeats", "time"}
    few = not content and all(target.partition(".")[0] in others for target in assignments)
    return [name for name in known_names() if name in models] if few else known_names()


def _with_file(settings: Settings, content: Mapping[str, Any], file_name: str) -> Settings:
    groups, origins = dict(settings.groups), dict(settings.origins)
    top: dict[str, Any] = {}
    angles: dict[str, float] = {}
    known = [*_TOP_READERS, *groups]
    for key, value in content.items():
        with faults_at(file_name):
            if key == "preset":
                raise preset_is_gone(str(value))
            if key not in known:
                raise ParameterError(f"no setting '{key}'{suggestion(key, known)}")
            if key in groups:
                groups[key] = _with_table(groups[key], key, value, angles)
                origins.update((f"{key}.{name}", file_name) for name in value)
            else:
                top[key] = _TOP_READERS[key](value)
                origins[key] = file_name
    return replace(settings, groups=groups, origins=origins, angles=angles, **top)


def _with_table(
    params: Parameters, key: str, table: object, angles: dict[str, float]
) -> Parameters:
    """Return `params` with the values of a table; put sizes in degrees into `angles` instead."""
    if not isinstance(table, dict):
        raise ParameterError(f"'{key}' is a table; write [{key}] on a line of its own")
    degrees = {name: params.angle(name, value) for name, value in table.items()}
    angles.update((f"{key}.{name}", angle) for name, angle in degrees.items() if angle)
    return params.replaced(**{name: value for name, value in table.items() if not degrees[name]})


def _with_command_line(
    settings: Settings, options: Mapping[str, object], assignments: Mapping[str, object]
) -> Settings:
    groups, origins = dict(settings.groups), dict(settings.origins)
    changes: dict[str, dict[str, object]] = {}
    angles = dict(settings.angles)
    for full_name, value in assignments.items():
        group, _, name = full_name.partition(".")
        if group not in groups:
            raise ParameterError(f"no parameter set '{group}'{suggestion(group, groups)}")
        angle = groups[group].angle(name, value)
        if angle:
            angles[full_name] = angle
        else:
            angles.pop(full_name, None)
            changes.setdefault(group, {})[name] = groups[group].parsed(name, value)
        origins[full_name] = _COMMAND_LINE
    for group, values in changes.items():
        groups[group] = groups[group].replaced(**values)
    top = {key: _TOP_READERS[key](value) for key, value in options.items() if value is not None}
    origins.update(dict.fromkeys(top, _COMMAND_LINE))
    return replace(settings, groups=groups, origins=origins, angles=angles, **top)


def _models(names: object) -> tuple[str, ...]:
    if not isinstance(names, list | tuple) or not names:
        known = list(default_names())
        raise ParameterError(f"models must be a list such as {known}, not {names!r}")
    detectors = [detector for name in names for detector in names_of(str(name))]
    return tuple(dict.fromkeys(detectors))


def _yes_or_no(value: object) -> bool:
    if not isinstance(value, bool):
        raise ParameterError(f"measure_rmo must be true or false, not {value!r}")
    return value


def _columns(value: object) -> str:
    if value not in (_USUAL, ALL_COLUMNS):  # a tuple: the value of a file may be a list
        raise ParameterError(f"columns must be '{_USUAL}' or '{ALL_COLUMNS}', not {value!r}")
    return str(value)


_TOP_READERS: dict[str, Callable[[Any], Any]] = {
    "models": _models,
    "height": parse_height,
    "fov": parse_fov,
    "measure_rmo": _yes_or_no,
    "columns": _columns,
}


def _read(path: Path) -> dict[str, Any]:
    """Return the content of a file of settings, or the settings in the sidecar of a result."""
    if path.suffix.lower() == ".json":
        return _settings_of_sidecar(path)
    other = "give a file of settings in TOML, or the sidecar of a result, NAME.oppload.json"
    repair = "correct the file" if path.suffix.lower() == ".toml" else other
    with reading(path, ParameterError, form="TOML", check="check --config", repair=repair):
        return tomllib.loads(text_of(path))


def _settings_of_sidecar(path: Path) -> dict[str, Any]:
    with reading(path, ParameterError, form="JSON", check="check --config"):
        content = json.loads(
            text_of(path), object_hook=lambda one: {k: v for k, v in one.items() if v is not None}
        )
    sets = content.get("parameters") if isinstance(content, dict) else None
    if not isinstance(sets, dict) or content.get("schema") not in _SIDECARS:
        raise ParameterError(
            f"{path}: holds no settings that this version knows; give the sidecar of a result, "
            "NAME.oppload.json or NAME.tuning.json, or a file of settings in TOML"
        )
    if (preset := content.get("preset")) not in {None, "default"}:  # of a version before 1.0
        raise preset_is_gone(str(preset))
    top = {key: content[key] for key in _TOP_READERS if key in content}
    view = content.get("field_of_view")
    if isinstance(view, dict) and view.get("origin") == FOV:
        top["fov"] = view.get("horizontal_deg")
    return {**top, **sets}
