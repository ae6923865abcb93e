"""Parameters of the alarms and of the places of looming objects."""

from __future__ import annotations

from dataclasses import dataclass, make_dataclass
from functools import cache
from typing import TYPE_CHECKING, Any, ClassVar

from oppload_cli.errors import ParameterError
from oppload_cli.models.presets import DEFAULT_PRESET, preset_named
from oppload_cli.models.registry import alarm_floor_of, detector_named, known_names
from oppload_cli.schema import Parameters, parameter

if TYPE_CHECKING:
    from collections.abc import Sequence

    from oppload_cli.models.detector import Detector


def _seconds(default: float, meaning: str) -> Any:
    return parameter(default, meaning, unit="s", low=0, high=60)


@dataclass(frozen=True, kw_only=True)
class AlarmParams(Parameters):
    """Parameters of the alarms; each detector has its own alarm with these parameters.

    :func:`alarm_params` adds the floor of each detector as ``NAME_floor``.

    Examples
    --------
    >>> import oppload_cli as oppload
    >>> oppload.AlarmParams(hold_s=1).hold_s
    1.0
    >>> oppload.AlarmParams(hold_s=-1)  # doctest: +ELLIPSIS
    Traceback (most recent call last):
    ...
    oppload_cli.errors.ParameterError: ...
    """

    on: bool = parameter(True, "whether there are alarms at all")
    factor: float = parameter(
        8.0,
        "the alarm's threshold is this many times the median response of the background, but at "
        "least the floor",
        low=0,
        high=1e6,
    )
    background_s: float = parameter(
        4.0,
        "length of the background, which ends guard_s before the latest frame",
        low=0.1,
        high=3600,
    )
    guard_s: float = _seconds(0.2, "time before the latest frame that the background leaves out")
    enough_s: float = _seconds(
        0.0,
        "evidence must be above the threshold for this time before the alarm starts; 0: one frame "
        "is enough",
    )
    window_s: float = _seconds(
        0.0, "length of the latest time in which evidence must be above the threshold for enough_s"
    )
    release: float = parameter(
        0.5,
        "an alarm continues while evidence is above this share of the threshold",
        low=0,
        high=1,
    )
    contact_s: float = _seconds(
        1.0, "if the time to contact is below this, a smaller response is enough; 0: it never is"
    )
    contact_share: float = parameter(
        0.1, "below contact_s, evidence is the response divided by this", low=1e-3, high=1
    )
    hold_s: float = _seconds(
        0.5, "time for which an alarm continues after evidence was last above the release share"
    )
    refractory_s: float = _seconds(
        0.5, "time after the end of an alarm in which no other alarm starts"
    )
    cut_ratio: float = parameter(
        4.0,
        "a frame is a cut if its luminance change is above this many times the largest change of "
        "the 0.18 s before; 0: there are no cuts",
        low=0,
        high=1e6,
    )
    cut_share: float = parameter(
        0.5, "least share of the pixels that change in a cut", low=0, high=1
    )
    rest: float = parameter(
        5e-4, "a scene is at rest while its luminance change is at most this", low=0, high=1
    )
    blind_s: float = _seconds(
        0.345,
        "time in which frames do not count; it begins with the first frame of a video, or with the "
        "frame before a cut or the end of a rest, but at most 1/30 s earlier",
    )

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.enough_s > self.window_s:
            raise ParameterError(
                f"parameter 'enough_s' of alarm must be at most 'window_s' ({self.window_s:g}), "
                f"not {self.enough_s:g}"
            )

    def floor_of(self, name: str) -> float:
        """Return the response at or below which a detector never alarms."""
        floor: float | None = getattr(self, f"{name}_floor", None)
        return alarm_floor_of(name) if floor is None else floor

    def evidence(self, response: float, contact_s: float | None) -> float:
        """Return the evidence, the number that an alarm compares with its threshold.

        Parameters
        ----------
        response : float
            The detector's response, at least 0.
        contact_s : float or None
            Time to contact in seconds of the object with the largest response; None or NaN if it
            is not known.

        Returns
        -------
        float
            The response; if contact is nearer than `contact_s`, the response / `contact_share`.

        Source: ``docs/alarms.md``.

        Examples
        --------
        >>> import oppload_cli as oppload
        >>> params = oppload.alarm_params("default")
        >>> params.evidence(0.05, None), params.evidence(0.05, 1.2), params.evidence(0.05, 0.8)
        (0.05, 0.05, 0.5)
        """
        near = contact_s is not None and contact_s < self.contact_s
        return response / self.contact_share if near else response

    def __reduce__(self) -> tuple[object, ...]:
        # The class with the floors is made at run time, so that another process must make its own.
        names = tuple(name.removesuffix("_floor") for name in self.names() if "_floor" in name)
        return _with_floors, (names, self.as_dict())


# Presets under which alarms have other parameters than under preset default.
_TWO_OF_THREE = {"factor": 30.0, "enough_s": 0.03, "window_s": 0.09, "contact_s": 0.0}
_ALARMS: dict[str, dict[str, float]] = {
    "reference": _TWO_OF_THREE,
    "paper": _TWO_OF_THREE,
    "lplc2": {"contact_s": 0.0},
}


def alarm_params(preset: str = DEFAULT_PRESET, **values: float) -> AlarmParams:
    """Return the parameters of the alarms under a preset, with the floor of every detector.

    Parameters
    ----------
    preset : str
        Name of the preset.
    **values : float
        Parameters that differ from the preset, such as ``factor=10`` or ``opplod_floor=0.01``.

    Raises
    ------
    ParameterError
        If the preset or a name is unknown, or a value is out of range.

    Examples
    --------
    >>> import oppload_cli as oppload
    >>> oppload.alarm_params("reference").factor, oppload.alarm_params("default").factor
    (30.0, 8.0)
    >>> oppload.alarm_params(opplod_floor=0.1).floor_of("opplod")
    0.1
    """
    return alarm_params_with(known_names(), preset).replaced(**values)


def alarm_params_with(names: Sequence[str], preset: str, **values: float) -> AlarmParams:
    """Return the parameters of the alarms under a preset, with the floors of some detectors."""
    floors = {f"{name}_floor": alarm_floor_of(name, preset) for name in names}
    on = not preset_named(preset).no_alarm
    given = {"on": on, **floors, **_ALARMS.get(preset, {}), **values}
    return _with_floors(tuple(names), given)


@cache  # by classes, not by names: a notebook may define a detector again under the same name
def _alarm_class(kinds: tuple[type[Detector], ...]) -> type[AlarmParams]:
    """Return the class of the alarms' parameters with a floor for each detector."""
    floors = [
        (
            f"{kind.name}_floor",
            float,
            parameter(
                kind.alarm_floors[DEFAULT_PRESET],
                f"an alarm of {kind.label} needs a response above this",
                low=0,
                high=1e9,
            ),
        )
        for kind in kinds
    ]
    return make_dataclass("AlarmParams", floors, bases=(AlarmParams,), frozen=True, kw_only=True)


def _with_floors(names: tuple[str, ...], values: dict[str, float]) -> AlarmParams:
    kinds = tuple(map(detector_named, names))
    return (_alarm_class(kinds) if kinds else AlarmParams)(**values)  # type: ignore[arg-type]


@dataclass(frozen=True, kw_only=True)
class PlaceParams(Parameters):
    """Parameters of looming objects: their search, their identity and their time to contact.

    Source: ``docs/explanation/boxes.md``.

    Examples
    --------
    >>> import oppload_cli as oppload
    >>> few = oppload.PlaceParams(most=1)
    >>> records = oppload.analyse("controls/two-looming-disks", places=few, rmo=False)
    >>> max(len(record.detections) for record in records)
    1
    """

    _set: ClassVar[str] = "places"

    floor: float = parameter(1e-3, "least response of an object", low=0, high=1e9)
    share: float = parameter(
        0.01,
        "least response of an object, as a share of the largest response of the frame",
        low=0,
        high=1,
    )
    most: int = parameter(
        5, "largest number of objects in a frame", unit="objects", low=1, high=100
    )
    gap_s: float = _seconds(0.2, "time for which an object keeps its number without being seen")
    memory_s: float = parameter(
        0.4, "time over which the growth of an object is measured", low=0.01, high=60
    )
    least_frames: int = parameter(
        4,
        "least number of measured growths for a time to contact; one less if the error of a single "
        "growth is below half of largest_error",
        unit="growths",
        low=3,
        high=1000,
    )
    least_s: float = _seconds(0.118, "least time over which these growths extend")
    least_growth: float = parameter(
        1.15, "least total growth of the size for a time to contact, as a factor", low=1, high=100
    )
    largest_error: float = parameter(
        0.2, "largest standard error of a time to contact, as a share of it", low=0.001, high=10
    )


# Responses under these presets are on another scale than those under preset default.
_PLACES = dict.fromkeys(("reference", "paper"), PlaceParams(floor=1e-6))


def place_params(preset: str = DEFAULT_PRESET) -> PlaceParams:
    """Return the parameters of the looming objects under a preset."""
    return _PLACES.get(preset, PlaceParams())
