"""The list of all detectors.

A new detector needs one file in this folder and one line in the table of this module.
"""

from __future__ import annotations

import os
import re
import sys
from dataclasses import Field, make_dataclass
from hashlib import sha256
from importlib import import_module
from importlib.util import module_from_spec, spec_from_file_location
from itertools import chain
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, cast, overload

from oppload_cli.errors import OpploadError, ParameterError, faults_at, suggestion
from oppload_cli.models import LOAD
from oppload_cli.models.columns import COMMON, RMO, columns_of
from oppload_cli.models.detector import AlarmRule, Column, Detector
from oppload_cli.models.dlgmd import Dlgmd
from oppload_cli.models.opplod import Opplod
from oppload_cli.models.timebase import TimeParams
from oppload_cli.schema import Parameters, is_integer
from oppload_cli.video.frames import HIGHEST, WORKING_HEIGHT

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence
    from importlib.abc import Loader
    from importlib.machinery import ModuleSpec

    from oppload_cli.models.dlgmd import DlgmdParams
    from oppload_cli.models.opplod import OpplodParams


# No detector may have these names: they mean something else in settings and tables.
_TAKEN_NAMES = {
    *("alarm", "places", "rmo", "repeats", "time"),
    *("preset", "models", "height", "measure_rmo", "fov", "columns", "all"),
}
_TEXTS = "label", "colour", "meaning", "unit", "reference", "answers_to", "made_for", "interval"
# The types of a detector's attributes, and their names in messages.
_ATTRIBUTES: dict[str, tuple[Any, str]] = {
    **dict.fromkeys(_TEXTS, (str, "a text")),
    **dict.fromkeys(("by_default", "evaluated", "places", "interpolates"), (bool, "True or False")),
    "warm_up": (int, "a whole number"),
    "year": (int | None, "a whole number or None"),
    "cost_ms": (int | float | None, "a number or None"),
    "alarm": (AlarmRule, "an AlarmRule"),
}
ALL = "all"  # the word for all detectors in `names_of`
# Presets of versions before 1.0, and the detectors that took their places.
_GONE = {
    "default": "opplod",
    "robust": "opplod",
    "reference": "opplod_reference",
    "paper": "opplod_paper",
    "lplc2": "opplod_lplc2",
}

# The class of each detector that runs by default. The others are given as module and class, and
# imported when they are first needed: to import all would take a tenth of a run's start-up time.
_detectors: dict[str, type[Detector] | str] = {
    "opplod": Opplod,
    "dlgmd": Dlgmd,
    "opplod_reference": "models.opplod_reference:OpplodReference",
    "opplod_paper": "models.opplod_paper:OpplodPaper",
    "opplod_lplc2": "models.opplod_lplc2:OpplodLplc2",
    "frame_difference": "models.frame_difference:FrameDifference",
    "flow_divergence": "models.flow_divergence:FlowDivergence",
    "ttc_gradient": "models.ttc_gradient:TtcGradient",
    "area_growth": "models.area_growth:AreaGrowth",
    "lgmd1_group": "models.published.lgmd1_group:Lgmd1Group",
    "lgmd1_group_paper": "models.published.lgmd1_group:Lgmd1GroupPaper",
    "lgmd1_single": "models.published.lgmd1_single:Lgmd1Single",
    "lgmd1_single_paper": "models.published.lgmd1_single:Lgmd1SinglePaper",
    "lgmd1_onoff": "models.published.lgmd1_onoff:Lgmd1Onoff",
    "lgmd2": "models.published.lgmd2:Lgmd2",
    "lgmd_plus": "models.published.lgmd_plus:LgmdPlus",
    "plgmd": "models.published.lgmd1_group:Plgmd",
    "lgmd_contrast": "models.published.lgmd_contrast:LgmdContrast",
    "ci_lmd": "models.published.ci_lmd:CiLmd",
    "emd_lplc2_gf": "models.published.emd_lplc2_gf:EmdLplc2Gf",
    "zhou_lrf": "models.published.zhou_lrf:ZhouLrf",
    "mlplc2": "models.published.mlplc2:Mlplc2",
    "hua_fixed": "models.published.hua:HuaFixed",
    "hua_literal": "models.published.hua:HuaLiteral",
}


_loaded: dict[str, str] = {}  # checksums of the files that `load` imported, by name


def register(detector: type[Detector]) -> type[Detector]:
    """Add a detector to settings, tables, alarms, figures and `oppload models`.

    If a class is defined again, as in a notebook, the new class replaces the former one.

    Parameters
    ----------
    detector : type of Detector
        The class, which is also returned, so that this function can be a decorator. A class
        without its own parameters gets an empty class of parameters.

    Raises
    ------
    ParameterError
        If the class is not complete, or if its name, its parameters or one of its columns is not
        valid or is in use already.

    Examples
    --------
    >>> import oppload_cli as oppload
    >>> oppload.register(oppload.Dlgmd) is oppload.Dlgmd  # again: nothing changes
    True
    """
    where = _check_class(detector)
    known = detectors().get(detector.name)
    if detector.name in _TAKEN_NAMES or (known and not _is_again(known, detector)):
        by = f" by {known.__module__}.{known.__qualname__}" if known else ""
        raise ParameterError(f"{where}: its name is taken{by}; choose another one")
    inherited = "parameters" not in vars(detector)
    # A subclass of a registered detector without parameters inherits the empty class of that one.
    if detector.parameters is Parameters or (inherited and not detector.parameters.declared()):
        detector.parameters = _no_parameters(detector)
    others = [kind for kind in detectors().values() if kind is not known]
    if any(kind.parameters is detector.parameters for kind in others):
        raise ParameterError(
            f"{where}: its parameters, {detector.parameters.__name__}, are those of another "
            f"detector; set 'parameters' to a class that extends {detector.parameters.__name__}"
        )
    taken = {column.name for column in (*COMMON, *RMO)}.union(*map(_column_names, others))
    for column in _column_names(detector):
        if column in taken:
            raise ParameterError(f"{where}: its column '{column}' is taken; choose another name")
        taken.add(column)
    fields = detector.responses.__dataclass_fields__
    for declared in (*detector.columns, *detector.details):
        if declared.name not in fields:
            raise ParameterError(
                f"{where}: its column '{declared.name}' must be a field of its responses, "
                f"{detector.responses.__name__}"
            )
    _detectors[detector.name] = detector
    return detector


def load(name: str) -> None:
    """Import a file such as ``edges.py``, or an installed module, that registers detectors.

    A file or module that cannot be imported is a ParameterError.
    """
    path = Path(name)
    if path.suffix != ".py" and not all(map(str.isidentifier, name.split("."))):
        raise ParameterError(
            f"--load {name}: is neither a file that ends in .py nor the name of a module; check "
            "the name"
        )
    try:
        if path.suffix == ".py":
            # Working processes load the same files and look for their classes in these modules.
            title = modules_of([*_loaded, name])[name]
            spec = cast("ModuleSpec", spec_from_file_location(title, path.absolute()))
            sys.modules[title] = module_from_spec(spec)
            cast("Loader", spec.loader).exec_module(sys.modules[title])
        else:
            path = Path(import_module(name).__file__ or "")
        _loaded[name] = sha256(path.read_bytes()).hexdigest()
    except OpploadError:
        raise
    # SystemExit: a file that is also a program may end Python, and the command with it.
    except (Exception, SystemExit) as error:
        raise ParameterError(
            f"--load {name}: cannot be imported ({type(error).__name__}: {error}); correct it"
        ) from error


def modules_of(names: Iterable[str]) -> dict[str, str]:
    """Return the module of each name of ``--load``; each file has a module of its own.

    The first of several files of one name, in different folders, has the shortest module.
    """
    modules: dict[str, str] = {}
    for name in dict.fromkeys(names):
        path, title = Path(name), name
        if path.suffix == ".py":
            title = f"loaded_{path.stem.replace('.', '_')}"  # a dot would mean a package
            while title in modules.values():
                title += "_"
        modules[name] = title
    return modules


def load_only(files: Sequence[dict[str, str]]) -> None:
    """Load files of detectors, as `loaded` returns them, in place of those loaded before.

    A worker of a cluster runs the batches of many users, and a user changes files between batches.
    """
    if loaded() == list(files):
        return
    for name, detector in detectors().items():
        if not is_of_package(detector):
            forget(name)
    _loaded.clear()
    for file in files:
        load(file["name"])


def loaded() -> list[dict[str, str]]:
    """Return the name and the checksum of each file that `load` has imported."""
    return [{"name": name, "sha256": checksum} for name, checksum in _loaded.items()]


def needs_loading(name: str) -> bool:
    """Return whether a detector is one of the user's own, not of oppload."""
    return not is_of_package(detector_named(name))


def _check_class(detector: type[Detector]) -> str:
    """Check a class without the other detectors; return its name and module for messages."""
    value: object = detector  # a user's call may ignore the types
    if not isinstance(value, type) or not issubclass(value, Detector):
        raise ParameterError(f"{value!r} is no detector: register a class that extends Detector")
    name = getattr(detector, "name", None)
    where = f"detector '{name}' ({detector.__module__}.{detector.__qualname__})"
    if not isinstance(name, str) or not re.fullmatch(r"[a-z][a-z0-9_]*", name):
        raise ParameterError(
            f"{where}: its name must begin with a lower-case letter, and have only lower-case "
            f"letters, digits and underscores"
        )
    if missing := ", ".join(sorted(getattr(detector, "__abstractmethods__", ()))):
        raise ParameterError(f"{where}: it lacks {missing}; define it")
    _check_types(detector, where)
    if not re.fullmatch(r"#[0-9A-Fa-f]{6}", getattr(detector, "colour", "")):
        raise ParameterError(f"{where}: its colour must be written as #RRGGBB")
    if not getattr(detector, "label", "") or not getattr(detector, "meaning", ""):
        raise ParameterError(f"{where}: it needs a label and a meaning")
    for title in ("columns", "details"):
        columns = getattr(detector, title)
        if not isinstance(columns, tuple) or not all(isinstance(one, Column) for one in columns):
            raise ParameterError(f"{where}: its {title} must be a tuple of Column")
    _check_parameters(detector, where)
    return where


def _check_parameters(detector: type[Detector], where: str) -> None:
    for kind in detector.parameters.__mro__:  # a dataclass replaces its fields by their defaults
        if any(isinstance(value, Field) for value in vars(kind).values()):
            raise ParameterError(
                f"{where}: its parameters, {kind.__name__}, are no dataclass; write "
                "@dataclass(frozen=True, kw_only=True) above the class"
            )
    with faults_at(where):
        detector.parameters()  # raises the error of a wrong declaration or default
        TimeParams(interval=detector.interval)


def _check_types(detector: type[Detector], where: str) -> None:
    for attribute, (kinds, words) in _ATTRIBUTES.items():
        value = getattr(detector, attribute, "")
        if not isinstance(value, kinds):
            raise ParameterError(f"{where}: its {attribute} must be {words}, not {value!r:.60}")
    height: object = detector.height  # a user's detector may ignore the types
    if not is_integer(height, 1) or detector.height > HIGHEST:
        raise ParameterError(
            f"{where}: its working height must be a whole number of 1 to {HIGHEST} pixels, not "
            f"{height!r:.60}"
        )
    rule = detector.alarm
    numbers: list[Any] = [number for number in rule[:4] if number is not None]
    if not all(isinstance(number, int | float) and number >= 0 for number in numbers):
        raise ParameterError(f"{where}: its alarm must have numbers of at least 0, not {rule}")
    if rule.floor is None and not rule.why_none:
        raise ParameterError(f"{where}: its alarm has no floor; say why in why_none")


def _is_again(known: type[Detector], detector: type[Detector]) -> bool:
    """Return whether a class is the known one, or a new definition of it by the user."""
    names = {(kind.__module__, kind.__qualname__) for kind in (known, detector)}
    return known is detector or (len(names) == 1 and not is_of_package(known))


def _no_parameters(detector: type[Detector]) -> type[Parameters]:
    """Return an empty class of parameters; each detector needs its own (see `detector_of`)."""
    empty = make_dataclass(detector.__name__, [], bases=(Parameters,), frozen=True, kw_only=True)
    # Other processes look for the class under this name.
    empty.__module__ = detector.__module__
    empty.__qualname__ = f"{detector.__qualname__}.parameters"
    return empty


def forget(name: str) -> None:
    """Remove a registered detector again.

    Parameters
    ----------
    name : str
        Name of the detector; no error if it is unknown.

    Raises
    ------
    ParameterError
        If the name is no text.

    Examples
    --------
    >>> import oppload_cli as oppload
    >>> oppload.forget("never_registered")  # nothing to remove
    """
    given: object = name  # a caller may give a list or an array, in spite of the type
    if not isinstance(given, str):
        raise ParameterError(f"the name of a detector must be a text, not {given!r:.60}")
    _detectors.pop(name, None)


def detectors() -> dict[str, type[Detector]]:
    """Return all detectors by name, in the order of their registration.

    Examples
    --------
    >>> import oppload_cli as oppload
    >>> list(oppload.detectors())[:2]
    ['opplod', 'dlgmd']
    """
    return {name: detector_named(name) for name in _detectors}


def known_names() -> tuple[str, ...]:
    """Return the names of all detectors, without importing their classes."""
    return tuple(_detectors)


def default_names() -> tuple[str, ...]:
    """Return the names of the detectors that run if the user chooses none."""
    return tuple(
        name for name, kind in _detectors.items() if not isinstance(kind, str) and kind.by_default
    )


def detector_named(name: str) -> type[Detector]:
    """Return a detector by its name; an unknown name is a ParameterError."""
    name = str(name)  # a caller may give a list or an array, in spite of the type
    if name not in _detectors:
        raise ParameterError(f"no model '{name}'{suggestion(name, _detectors)}")
    detector = _detectors[name]
    if isinstance(detector, str):
        module, _, title = detector.partition(":")
        _detectors[name] = getattr(import_module(f"oppload_cli.{module}"), title)
        return detector_named(name)
    return detector


def names_of(text: str) -> tuple[str, ...]:
    """Return the names of the detectors in a value of ``--model``.

    `text` is ``NAME`` or ``all``, or several of these with commas between them. Other names are a
    ParameterError.
    """
    names: dict[str, None] = {}
    for part in map(str.strip, text.split(",")):
        name, colon, version = part.partition(":")
        was_preset = version in _GONE or f"{name}_{version}" in _detectors
        if colon and was_preset and name in {*_detectors, ALL}:
            raise preset_is_gone(version, name)
        names |= dict.fromkeys(_detectors if part == ALL else [detector_named(part).name])
    return tuple(names)


def preset_is_gone(preset: str, name: str = "opplod") -> ParameterError:
    """Return the error for a preset of an earlier version, which names the detector to choose."""
    own = f"{name}_{preset}"
    instead = own if own in _detectors else _GONE.get(preset, "") if name == "opplod" else name
    if not instead:
        return ParameterError(
            f"there are no presets since 1.0, and no detector '{own}'; choose one with --model "
            "(in Python models), as 'oppload models' lists them"
        )
    return ParameterError(
        f"presets are detectors of their own since 1.0: in place of '{preset}' write --model "
        f"{instead} (in Python models=['{instead}'])"
    )


def other_heights(names: Iterable[str]) -> tuple[int, ...]:
    """Return the working heights in px of some detectors that differ from the usual one."""
    heights = {detector_named(name).height for name in names}
    return tuple(sorted(heights - {WORKING_HEIGHT}))


def placing_detector(names: Iterable[str]) -> type[Detector] | None:
    """Return the first of some detectors that has places: oppload reports its detections."""
    return next((kind for kind in map(detector_named, names) if kind.places), None)


def detector_of(params: Parameters) -> type[Detector]:
    """Return the detector to which a set of parameters belongs; a ParameterError if none has it."""
    imported = [kind for kind in _detectors.values() if not isinstance(kind, str)]
    for detector in chain(imported, map(detector_named, known_names())):
        if type(params) is detector.parameters:
            return detector
    raise ParameterError(f"no detector has parameters of the class {type(params).__name__}")


@overload
def parameters_of(name: Literal["opplod"]) -> OpplodParams: ...
@overload
def parameters_of(name: Literal["dlgmd"]) -> DlgmdParams: ...
@overload
def parameters_of(name: str) -> Parameters: ...
def parameters_of(name: str) -> Parameters:
    """Return the default parameters of a detector.

    Parameters
    ----------
    name : str
        Name of the detector, as in ``oppload models``.

    Raises
    ------
    ParameterError
        If the name is unknown; the message suggests the nearest one.

    Examples
    --------
    >>> import oppload_cli as oppload
    >>> oppload.parameters_of("opplod_paper").receptive_field
    200
    """
    return detector_named(name).parameters()


def least_response_of(name: str) -> float:
    """Return the least response of a detector that means something: its alarm's floor.

    Without an alarm it is the least response of an object.
    """
    detector = detector_named(name)
    floor = detector.alarm.floor
    return detector.least_object[0] if floor is None else floor


def is_rounding_error(response: float, least: float) -> bool:
    """Return whether a response is less than a millionth of the least that means something."""
    return response < 1e-6 * least


def _column_names(detector: type[Detector]) -> tuple[str, ...]:
    return tuple(column.name for column in columns_of(detector, details=True, degrees=True))


def is_of_package(detector: type[Detector]) -> bool:
    """Return whether a detector is one of oppload, and not one of the user."""
    return detector.__module__.startswith("oppload_cli.")


for _name in filter(None, os.environ.get(LOAD, "").split(os.pathsep)):
    load(_name)
