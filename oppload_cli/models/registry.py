"""The detectors by name, and several of them over one video.

A new detector is one file in this room and one line here.
"""

from __future__ import annotations

import re
from importlib import import_module
from itertools import chain
from typing import TYPE_CHECKING

from oppload_cli.errors import ParameterError, suggestion
from oppload_cli.models.columns import COMMON, RMO, columns_of
from oppload_cli.models.dlgmd import Dlgmd
from oppload_cli.models.layers import Layers
from oppload_cli.models.opplod import Opplod
from oppload_cli.models.presets import DEFAULT_PRESET, PRESETS, preset_named
from oppload_cli.models.timebase import Clock

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

    from oppload_cli.models.detector import Detector, Response
    from oppload_cli.models.dpc import Map
    from oppload_cli.models.timebase import TimeParams
    from oppload_cli.schema import Parameters


# Names that mean something else in settings and tables.
_TAKEN_NAMES = {
    *("alarm", "places", "rmo", "repeats", "time"),
    *("preset", "models", "height", "measure_rmo", "fov", "columns", "all"),
}
ALL, _LITERAL = "all", "literal"  # words for detectors in `names_of`

# The detectors that run by default, and where to find each of the others once it is asked for:
# declaring them all would take a tenth of the start of a run.
_detectors: dict[str, type[Detector] | str] = {
    "opplod": Opplod,
    "dlgmd": Dlgmd,
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
    "plgmd": "models.published.plgmd:Plgmd",
    "lgmd_contrast": "models.published.lgmd_contrast:LgmdContrast",
    "ci_lmd": "models.published.ci_lmd:CiLmd",
    "emd_lplc2_gf": "models.published.emd_lplc2_gf:EmdLplc2Gf",
    "zhou_lrf": "models.published.zhou_lrf:ZhouLrf",
    "mlplc2": "models.published.mlplc2:Mlplc2",
    "hua_fixed": "models.published.hua:HuaFixed",
    "hua_literal": "models.published.hua:HuaLiteral",
}


def register(detector: type[Detector]) -> type[Detector]:
    """Make a detector known everywhere: settings, tables, alarms, figures, `oppload models`.

    Parameters
    ----------
    detector : type of Detector
        Returned as it is, so that this can be used as a decorator.

    Raises
    ------
    ParameterError
        If its name, its parameters or one of its columns is not valid, or is taken already.

    Examples
    --------
    >>> import oppload_cli as oppload
    >>> oppload.register(oppload.Dlgmd) is oppload.Dlgmd  # again: nothing changes
    True
    """
    name = getattr(detector, "name", None)
    where = f"detector '{name}' ({detector.__module__}.{detector.__qualname__})"
    if not isinstance(name, str) or not re.fullmatch(r"[a-z][a-z0-9_]*", name):
        raise ParameterError(f"{where}: its name must be lower case, digits and underscores")
    known = detectors().get(name)
    if name in _TAKEN_NAMES or (known is not None and known is not detector):
        raise ParameterError(f"{where}: its name is taken; choose another one")
    if not re.fullmatch(r"#[0-9A-Fa-f]{6}", getattr(detector, "colour", "")):
        raise ParameterError(f"{where}: its colour must be written as #RRGGBB")
    if not getattr(detector, "label", "") or not getattr(detector, "meaning", ""):
        raise ParameterError(f"{where}: it needs a label and a meaning")
    others = [each for each in detectors().values() if each is not detector]
    if any(each.parameters is detector.parameters for each in others):
        raise ParameterError(
            f"{where}: its parameters, {detector.parameters.__name__}, are those of another "
            f"detector; give it a class of its own"
        )
    taken = {column for each in others for column in _columns_of(each)}
    taken |= {column.name for column in (*COMMON, *RMO)}
    for column in _columns_of(detector):
        if column in taken:
            raise ParameterError(f"{where}: its column '{column}' is taken; choose another name")
        taken.add(column)
    fields = detector.answers.__dataclass_fields__
    for own in (*detector.columns, *detector.details):
        if own.name not in fields:
            raise ParameterError(
                f"{where}: its column '{own.name}' must be a field of its answers, "
                f"{detector.answers.__name__}"
            )
    _detectors[name] = detector
    return detector


def forget(name: str) -> None:
    """Remove a registered detector again, as tests do."""
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
    """Return the names of all detectors, without loading any."""
    return tuple(_detectors)


def default_names() -> tuple[str, ...]:
    """Return the names of the detectors that run where none is chosen."""
    return tuple(
        name for name, each in _detectors.items() if not isinstance(each, str) and each.by_default
    )


def detector_named(name: str) -> type[Detector]:
    """Return a detector by its name.

    Raises
    ------
    ParameterError
        If no detector has that name.
    """
    if name not in _detectors:
        raise ParameterError(f"no model '{name}'{suggestion(name, _detectors)}")
    detector = _detectors[name]
    if isinstance(detector, str):
        module, _, title = detector.partition(":")
        found: type[Detector] = getattr(import_module(f"oppload_cli.{module}"), title)
        _detectors[name] = detector = found
    return detector


def names_of(text: str) -> tuple[str, ...]:
    """Return the detectors that a user names.

    Parameters
    ----------
    text : str
        ``NAME``, ``NAME:VARIANT`` (``NAME:literal`` is NAME itself), ``NAME:PRESET``, several
        of them with commas between them, or ``all``.

    Raises
    ------
    ParameterError
        If no detector has such a name.
    """
    found: list[str] = []
    for part in text.split(","):
        name, _, variant = part.strip().partition(":")
        if name == ALL and not variant:
            found += [one for one, each in detectors().items() if not each.variant_of]
            continue
        detector_named(name)
        near = [one for one in _detectors if one.startswith(f"{name}_")]
        variants = [one for one in near if detector_named(one).variant_of == name]
        full = f"{name}_{variant}"
        if full not in variants and variant in PRESETS:
            variant = ""
        if variant and full not in variants and (variant != _LITERAL or not variants):
            known = [_LITERAL, *(one.removeprefix(f"{name}_") for one in variants)]
            has = f"it has {' and '.join(known)}" if variants else "it has none; see --preset"
            raise ParameterError(f"model '{name}' has no variant '{variant}': {has}")
        found.append(full if full in variants else name)
    return tuple(dict.fromkeys(found))


def placing_detector(names: Iterable[str]) -> type[Detector] | None:
    """Return the first of some detectors whose answers have places: its objects are reported."""
    return next((each for each in map(detector_named, names) if each.places), None)


def detector_of(params: Parameters) -> type[Detector]:
    """Return the detector that a set of parameters belongs to.

    Raises
    ------
    ParameterError
        If no detector has such parameters.
    """
    loaded = [each for each in _detectors.values() if not isinstance(each, str)]
    for detector in chain(loaded, map(detector_named, known_names())):
        if type(params) is detector.parameters:
            return detector
    raise ParameterError(f"no detector has parameters of the class {type(params).__name__}")


def parameters_of(name: str, preset: str = DEFAULT_PRESET) -> Parameters:
    """Return the parameters of a detector under a preset.

    Raises
    ------
    ParameterError
        If there is no such detector, or no such preset.

    Examples
    --------
    >>> import oppload_cli as oppload
    >>> oppload.parameters_of("opplod", "paper").receptive_field
    200
    """
    detector = detector_named(name)
    return detector.presets.get(preset_named(preset).name) or detector.parameters()


def alarm_floor_of(name: str, preset: str = DEFAULT_PRESET) -> float:
    """Return the response at or below which a detector never alarms, under a preset."""
    floors = detector_named(name).alarm_floors
    return floors.get(preset, floors[DEFAULT_PRESET])


def _columns_of(detector: type[Detector]) -> tuple[str, ...]:
    return tuple(each.name for each in columns_of(detector, details=True, degrees=True))


class DetectorBank:
    """Detectors that see the same frames, in one pass.

    Parameters
    ----------
    shape : tuple of int
        Height and width of the working frames.
    params : sequence of Parameters
        One set for each detector, in the order of the answers.
    frame_rate : float, optional
        Frames per second of the video, where it is known.
    time : TimeParams, optional
        The time base; intervals of 1/30 s if left out.

    Attributes
    ----------
    detectors : dict of str to Detector
        By name.

    Raises
    ------
    ParameterError
        If no detector is given, or one is given twice.

    Examples
    --------
    >>> import numpy as np, oppload_cli as oppload
    >>> bank = oppload.DetectorBank((48, 64), [oppload.DlgmdParams()], frame_rate=30)
    >>> for luma in np.zeros((5, 48, 64), np.float32):
    ...     answers = bank.step(luma)
    >>> answers
    {'dlgmd': DlgmdResponse(response=0.0, box=None, s=0.0)}
    """

    def __init__(
        self,
        shape: tuple[int, int],
        params: Sequence[Parameters],
        frame_rate: float | None = None,
        time: TimeParams | None = None,
    ) -> None:
        if not params:
            raise ParameterError("no model is chosen; name at least one")
        self._layers = layers = Layers(shape, Clock(time, frame_rate))
        self._photoreceptors = layers.photoreceptors()
        self.detectors: dict[str, Detector] = {}
        for each in params:
            kind = detector_of(each)
            if kind.name in self.detectors:
                raise ParameterError(f"model '{kind.name}' is given twice; name each once")
            self.detectors[kind.name] = kind(shape, each, frame_rate=frame_rate, layers=layers)

    @property
    def luma_change(self) -> float | None:
        """Mean of P(t) over the frame, 0 to 1; None where no earlier frame was compared."""
        return self._photoreceptors.layer.luma_change

    @property
    def photoreceptors(self) -> Map:
        """P(t), shape (height, width), 0 to 1; zeros on the first frame."""
        return self._photoreceptors.layer.maps[0]

    def reset(self) -> None:
        """Forget all frames: the next frame is frame 0."""
        self._photoreceptors.reset()
        for detector in self.detectors.values():
            detector.reset()

    def step(self, luma: Map, time_s: float | None = None) -> dict[str, Response | None]:
        """Take the next frame; every detector answers to it.

        Parameters
        ----------
        luma : ndarray of float32, shape (height, width)
            Luminance, 0 to 1.
        time_s : float, optional
            Its presentation time in seconds; detectors read it from their layers.

        Returns
        -------
        dict of str to Response or None
            By name; None during warm-up.

        Raises
        ------
        FrameError
            If the array is not a luminance image of the right shape.
        ParameterError
            If a detector returns anything else than an instance of its `answers`.
        """
        self._layers.clock.time_s = time_s
        self._photoreceptors.step(luma)
        return {name: _checked(each, each.step(luma)) for name, each in self.detectors.items()}

    def at_rest(self, intervals: float) -> dict[str, Response | None]:
        """Return every detector's answer to a frame in which nothing changed.

        Parameters
        ----------
        intervals : float
            Intervals since the start of the video; a detector in its warm-up has no answer.
        """
        return {
            name: each.at_rest() if intervals >= each.warm_up else None
            for name, each in self.detectors.items()
        }


def _checked(detector: Detector, answer: object) -> Response | None:
    if answer is None or isinstance(answer, detector.answers):
        return answer
    raise ParameterError(
        f"detector '{detector.name}': its step returned {type(answer).__name__}, "
        f"not a {detector.answers.__name__} or None"
    )
