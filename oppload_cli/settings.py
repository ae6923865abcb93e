"""The settings of a run, and where each came from.

Later ones win: the preset, then the TOML file, then the command line.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any, TypeVar

from oppload_cli.detection.alarm import ALARMS, AlarmParams
from oppload_cli.detection.parameters import PLACES, PlaceParams
from oppload_cli.errors import ParameterError, suggestion
from oppload_cli.models.parameters import DlgmdParams, OpplodParams
from oppload_cli.models.presets import DEFAULT_PRESET, Preset, preset_named
from oppload_cli.motion.parameters import RmoParams
from oppload_cli.results.columns import MODELS
from oppload_cli.video.parameters import RepeatParams

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence
    from pathlib import Path

    from oppload_cli.parameters import Parameters

Kind = TypeVar("Kind", bound="Parameters")

COMMAND_LINE = "command line"
NATIVE = "native"
TOP_LEVEL = ("preset", "models", "height", "measure_rmo")


@dataclass(frozen=True)
class Settings:
    """All that decides how an input is analysed.

    Attributes
    ----------
    preset : str
        The preset's name.
    models : tuple of str
        The models to run, in order.
    height : int or None
        Working height in pixels; None keeps the native size.
    measure_rmo : bool
        Whether radial motion opponency is measured.
    groups : dict of str to Parameters
        Parameter sets by name: ``opplod``, ``dlgmd``, ``alarm``, ``places``,
        ``rmo``, ``repeats``.
    origins : dict of str to str
        Where each setting came from, by its dotted name: ``preset default``,
        a file's path, or ``command line``.
    """

    preset: str
    models: tuple[str, ...]
    height: int | None
    measure_rmo: bool
    groups: dict[str, Parameters]
    origins: dict[str, str] = field(default_factory=dict)

    @property
    def opplod(self) -> OpplodParams:
        """The parameters of OppLoD."""
        return _of_kind(self.groups["opplod"], OpplodParams)

    @property
    def dlgmd(self) -> DlgmdParams:
        """The parameters of D-LGMD."""
        return _of_kind(self.groups["dlgmd"], DlgmdParams)

    @property
    def alarm(self) -> AlarmParams:
        """The parameters of the alarms."""
        return _of_kind(self.groups["alarm"], AlarmParams)

    @property
    def places(self) -> PlaceParams:
        """The parameters of the looming objects."""
        return _of_kind(self.groups["places"], PlaceParams)

    @property
    def rmo(self) -> RmoParams | None:
        """The parameters of radial motion opponency; None if it is not measured."""
        return _of_kind(self.groups["rmo"], RmoParams) if self.measure_rmo else None

    @property
    def repeats(self) -> RepeatParams:
        """How exact repeats are taken."""
        return _of_kind(self.groups["repeats"], RepeatParams)

    def model_params(self) -> list[OpplodParams | DlgmdParams]:
        """Return the parameter sets of the models to run, in order.

        Returns
        -------
        list of OpplodParams or DlgmdParams
        """
        return [self.opplod if name == "opplod" else self.dlgmd for name in self.models]


def resolve(
    *,
    preset: str | None = None,
    config: Path | None = None,
    models: Sequence[str] = (),
    height: str | None = None,
    measure_rmo: bool | None = None,
    assignments: Sequence[str] = (),
) -> Settings:
    """Resolve the settings of a run from the preset, a TOML file and the command line.

    Parameters
    ----------
    preset : str, optional
        Name of the preset; else the file's, else ``default``.
    config : Path, optional
        A TOML file with ``preset``, ``models``, ``height``, ``measure_rmo`` and a
        table per parameter set.
    models : sequence of str
        Models to run; none means all.
    height : str, optional
        Working height in pixels, or ``native``.
    measure_rmo : bool, optional
        Whether radial motion opponency is measured; else the file's, else yes.
    assignments : sequence of str
        ``set.parameter=value``, e.g. ``opplod.receptive_field=200``.

    Returns
    -------
    Settings

    Raises
    ------
    ParameterError
        If a name is unknown or a value out of range; the message says where.
    """
    content = _read(config) if config else {}
    source = str(config) if config else ""
    chosen = preset_named(preset) if preset else _preset_of_file(content, source)
    groups: dict[str, Parameters] = {
        "opplod": chosen.opplod,
        "dlgmd": chosen.dlgmd,
        "alarm": ALARMS[chosen.name],
        "places": PLACES[chosen.name],
        "rmo": RmoParams(),
        "repeats": RepeatParams(),
    }
    known = {f"{group}.{name}" for group, params in groups.items() for name in params.names()}
    origins = dict.fromkeys([*TOP_LEVEL, *sorted(known)], f"preset {chosen.name}")
    origins["preset"] = COMMAND_LINE if preset else source if "preset" in content else "default"
    settings = Settings(chosen.name, MODELS, chosen.height, True, groups, origins)
    settings = _with_file(settings, content, source)
    return _with_command_line(settings, models, height, measure_rmo, assignments)


def parse_height(value: str | int) -> int | None:
    """Read a working height.

    Parameters
    ----------
    value : str or int
        Pixels, or ``native``.

    Returns
    -------
    int or None
        None for ``native``.

    Raises
    ------
    ParameterError
        If it is neither, or outside 1 to 8192.
    """
    if value == NATIVE:
        return None
    text = str(value)
    if not text.isdigit() or not 1 <= int(text) <= 8192:
        raise ParameterError(f"height must be 'native' or 1 to 8192 pixels, not '{value}'")
    return int(text)


def _with_file(settings: Settings, content: Mapping[str, Any], source: str) -> Settings:
    groups, origins = dict(settings.groups), dict(settings.origins)
    top: dict[str, Any] = {}
    known = [*TOP_LEVEL, *groups]
    for key, value in content.items():
        try:
            if key not in known:
                raise ParameterError(f"no setting '{key}'{suggestion(key, known)}")
            if key in groups:
                groups[key] = _with_table(groups[key], key, value)
                origins.update((f"{key}.{name}", source) for name in value)
            elif key != "preset":
                top[key] = TOP_READERS[key](value)
                origins[key] = source
        except ParameterError as error:
            raise ParameterError(f"{source}: {error}") from error
    return replace(settings, groups=groups, origins=origins, **top)


def _with_table(params: Parameters, key: str, value: object) -> Parameters:
    if not isinstance(value, dict):
        raise ParameterError(f"'{key}' is a table; write [{key}] on a line of its own")
    return params.replaced(**value)


def _with_command_line(
    settings: Settings,
    models: Sequence[str],
    height: str | None,
    measure_rmo: bool | None,
    assignments: Sequence[str],
) -> Settings:
    groups, origins = dict(settings.groups), dict(settings.origins)
    changes: dict[str, dict[str, object]] = {}
    for assignment in assignments:
        group, name, text = _split(assignment, groups)
        changes.setdefault(group, {})[name] = groups[group].parsed(name, text)
        origins[f"{group}.{name}"] = COMMAND_LINE
    for group, values in changes.items():
        groups[group] = groups[group].replaced(**values)
    given = {"models": tuple(models) or None, "height": height, "measure_rmo": measure_rmo}
    top = {key: TOP_READERS[key](value) for key, value in given.items() if value is not None}
    origins.update(dict.fromkeys(top, COMMAND_LINE))
    return replace(settings, groups=groups, origins=origins, **top)


def _split(assignment: str, groups: Mapping[str, Parameters]) -> tuple[str, str, str]:
    target, equals, text = assignment.partition("=")
    group, dot, name = target.strip().partition(".")
    if not equals or not dot:
        raise ParameterError(
            f"'{assignment}' is no setting; write set.parameter=value, "
            f"e.g. opplod.receptive_field=200"
        )
    if group not in groups:
        raise ParameterError(f"no parameter set '{group}'{suggestion(group, groups)}")
    return group, name, text.strip()


def _models(names: object) -> tuple[str, ...]:
    if not isinstance(names, list | tuple) or not names:
        raise ParameterError(f"models must be a list such as {list(MODELS)}, not {names!r}")
    for name in names:
        if name not in MODELS:
            raise ParameterError(f"no model '{name}'{suggestion(str(name), MODELS)}")
    return tuple(dict.fromkeys(names))


def _yes_or_no(value: object) -> bool:
    if not isinstance(value, bool):
        raise ParameterError(f"measure_rmo must be true or false, not {value!r}")
    return value


TOP_READERS: dict[str, Callable[[Any], Any]] = {
    "models": _models,
    "height": parse_height,
    "measure_rmo": _yes_or_no,
}


def _read(path: Path) -> dict[str, Any]:
    import tomllib  # noqa: PLC0415 - seldom needed

    try:
        return tomllib.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        reason = (error.strerror or str(error)).lower()
        raise ParameterError(f"{path}: cannot be read ({reason}); check --config") from error
    except (ValueError, RecursionError) as error:  # of TOML, of UTF-8, or of brackets
        raise ParameterError(f"{path}: is not valid TOML ({error}); correct the file") from error


def _preset_of_file(content: Mapping[str, Any], source: str) -> Preset:
    name = content.get("preset", DEFAULT_PRESET)
    if not isinstance(name, str):
        raise ParameterError(f"{source}: 'preset' must be a word in quotes, not {name!r}")
    try:
        return preset_named(name)
    except ParameterError as error:
        raise ParameterError(f"{source}: {error}") from error


def _of_kind(params: Parameters, kind: type[Kind]) -> Kind:
    if not isinstance(params, kind):
        raise ParameterError(f"a set of {kind.__name__} is wanted, not {type(params).__name__}")
    return params
