"""The interface of a detector; all other code uses the models only through this interface.

A detector is one file in this folder, with its frozen parameters, its `step`, its columns, its
label and its colour. One line in :mod:`oppload_cli.models.registry` makes it known everywhere.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass, field, fields
from typing import TYPE_CHECKING, Any, ClassVar, NamedTuple

from oppload_cli.errors import ParameterError
from oppload_cli.models.layers import Layers
from oppload_cli.models.timebase import REFERENCE_INTERVAL, Clock, TimeParams
from oppload_cli.schema import Parameters, is_integer
from oppload_cli.video.frames import WORKING_HEIGHT

if TYPE_CHECKING:
    from fractions import Fraction

    import numpy as np
    from numpy.typing import NDArray

    from oppload_cli.models.dpc import Map


def checked_shape(shape: object) -> tuple[int, int]:
    """Return height and width as integers; `shape` may be a list, and hold NumPy integers.

    Raises ParameterError unless these are two integers of at least 1.
    """
    sides = tuple(shape) if isinstance(shape, Sequence) and not isinstance(shape, str) else ()
    if len(sides) != 2 or not all(is_integer(side, 1) for side in sides):
        given = " ".join(repr(shape).split())  # that of an image has several lines
        raise ParameterError(
            f"shape must be height and width in pixels, not {given:.60}; of an image give "
            "image.shape[:2]"
        )
    return int(sides[0]), int(sides[1])


class Box(NamedTuple):
    """A rectangle in pixels: its left top corner, width and height.

    Examples
    --------
    >>> import oppload_cli as oppload
    >>> oppload.Box(10, 20, 30, 40).centre
    (25.0, 40.0)
    """

    x: float
    y: float
    width: float
    height: float

    @property
    def centre(self) -> tuple[float, float]:
        """Its centre in pixels: x and y."""
        return self.x + self.width / 2, self.y + self.height / 2


class Column(NamedTuple):
    """One column of ``frames.csv``.

    Attributes
    ----------
    name : str
        Name in the header. A detector names its own columns without the prefix ``NAME_``.
    unit : str
        Unit of its values.
    meaning : str
        One line for the user.

    Examples
    --------
    >>> import oppload_cli as oppload
    >>> oppload.Dlgmd.columns[0].name
    's'
    """

    name: str
    unit: str
    meaning: str


class AlarmRule(NamedTuple):
    """The rule of a detector's alarm; :class:`~oppload_cli.AlarmParams` may change its numbers.

    Attributes
    ----------
    floor : float or None
        At or below this response the detector never alarms; None if it has no alarm.
    factor : float
        The alarm's threshold is this many times the median of the recent responses; 0: the floor
        alone.
    enough_s, window_s : float
        The alarm starts when evidence was above the threshold for `enough_s` seconds within the
        latest `window_s` seconds; 0: one frame is enough.
    why_none : str
        Why the detector has no alarm, if `floor` is None.

    Examples
    --------
    >>> import oppload_cli as oppload
    >>> oppload.Opplod.alarm.floor
    0.09
    """

    floor: float | None
    factor: float = 8.0
    enough_s: float = 0.0
    window_s: float = 0.0
    why_none: str = ""


@dataclass(frozen=True)
class Response:
    """The response of a detector to one frame, with its place and its inner values.

    A subclass has a field for each column of its detector.

    Attributes
    ----------
    response : float
        At least 0; the larger, the more the frame looks like an approach.
    box : Box or None
        The place of the response, in working pixels; None if it has none.

    Examples
    --------
    >>> import oppload_cli as oppload
    >>> oppload.Response(0.5).box is None
    True
    """

    response: float
    box: Box | None = None


def inner(default: float, unit: str, meaning: str) -> Any:
    """Declare an inner value of a response: a field of its class, and a column of the table.

    `default` is the value if nothing changes in the frame; `unit` and `meaning` are the column's.
    """
    return field(default=default, metadata={"column": (unit, meaning)})


class UnitMaps(NamedTuple):
    """The responses of a detector's units to the latest frame; the next frame overwrites them.

    Attributes
    ----------
    responses : ndarray of float32, shape (rows, columns)
        The response of every unit, at least 0.
    centres_y, centres_x : ndarray, shapes (rows,) and (columns,)
        Centres of the units in working pixels.
    field : float
        Side of a unit's receptive field in working pixels.

    Examples
    --------
    >>> import numpy as np, oppload_cli as oppload
    >>> model = oppload.Opplod((240, 320))
    >>> model.units.responses.shape == (len(model.units.centres_y), len(model.units.centres_x))
    True
    >>> model.units.centres_x[:2].tolist(), model.units.field
    ([4.0, 12.0], 100.0)
    """

    responses: Map
    centres_y: NDArray[np.float64]
    centres_x: NDArray[np.float64]
    field: float

    def box(self, row: int, column: int) -> Box:
        """Return a unit's receptive field, which may reach beyond the edge of the frame."""
        x, y = float(self.centres_x[column]), float(self.centres_y[row])
        return Box(x - self.field / 2, y - self.field / 2, self.field, self.field)


class Detector(ABC):
    """A model that responds to each frame of one video.

    Parameters
    ----------
    shape : tuple of int
        Height and width of the working frames.
    params : Parameters, optional
        An instance of the class `parameters`; the defaults if left out.
    frame_rate : float or Fraction, optional
        Frames per second of the video. Without it each frame counts as one interval of 1/30 s, so
        that the responses to another frame rate are wrong.
    layers : Layers, optional
        Photoreceptors and DPC layers; a layer that several detectors share is computed once.

    Attributes
    ----------
    name : str
        Name on the command line and in the columns: lower case, digits and underscores.
    label, colour : str
        Name and colour (``#RRGGBB``) in figures and in annotated videos.
    meaning : str
        One line for the user.
    unit : str
        Unit of the response, for the axes of figures.
    response_column : tuple of str
        Unit and meaning of the column ``NAME_response``.
    columns : tuple of Column
        The detector's own columns; each is a field of `responses`, with a default.
    details : tuple of Column
        Columns for the inner values that the authors publish; the table has them only with
        ``--columns all``. By default the fields of `responses` that :func:`inner` declares.
    responses : type of Response
        The class of its responses.
    parameters : type of Parameters
        The class of its parameters.
    height : int
        Working height in px for which the detector is made: it gets frames of this height, unless
        the user states another one.
    interval : str
        Its time base: the value of ``time.interval``, unless the user states another one.
    interpolates : bool
        Whether it also gets pictures between frames that are far apart, which the flow makes of the
        earlier frame. Such a detector separates its shared layers in `separate`.
    alarm : AlarmRule
        The rule of its alarm, or why it has none.
    least_object : tuple of float
        Least response of a looming object, and least share of the frame's largest response.
    by_default : bool
        Whether the detector runs if the user chooses none; a subclass does not inherit this.
    evaluated : bool
        Whether `oppload evaluate` runs the detector if the user chooses none.
    year : int or None
        Year of the publication; None if there is none.
    reference : str
        The publication, or who defined the detector.
    answers_to : str
        The stimuli that cause a response and those that do not, in one line.
    made_for : str
        The working size and the frame rate for which its authors designed it.
    cost_ms : float or None
        Milliseconds per frame of its height on one core, by ``oppload models --measure``.
    least_size : tuple of int
        The least height and width of the frames, in px.
    warm_up : int
        Number of intervals at the start without a response.
    witnesses : tuple of str
        Names of the columns whose measurements together are the reason of an alarm.
    places : bool
        Whether the responses have boxes, and `units` shows where objects loom.

    Raises
    ------
    ParameterError
        If the frames are smaller than `least_size`, or an argument is of another type.

    Examples
    --------
    >>> import numpy as np, oppload_cli as oppload
    >>> model = oppload.Dlgmd((48, 64))
    >>> isinstance(model, oppload.Detector), model.step(np.zeros((48, 64), np.float32))
    (True, None)
    """

    name: ClassVar[str]
    label: ClassVar[str]
    colour: ClassVar[str]
    meaning: ClassVar[str]
    unit: ClassVar[str] = "arbitrary unit"
    response_column: ClassVar[tuple[str, str]] = ("", "response; empty during warm-up")
    columns: ClassVar[tuple[Column, ...]] = ()
    details: ClassVar[tuple[Column, ...]] = ()
    responses: ClassVar[type[Response]] = Response
    parameters: ClassVar[type[Parameters]] = Parameters
    height: ClassVar[int] = WORKING_HEIGHT
    interval: ClassVar[str] = REFERENCE_INTERVAL
    interpolates: ClassVar[bool] = False
    alarm: ClassVar[AlarmRule] = AlarmRule(0.0)
    least_object: ClassVar[tuple[float, float]] = (0.02, 0.2)
    by_default: ClassVar[bool] = False
    evaluated: ClassVar[bool] = True
    year: ClassVar[int | None] = None
    reference: ClassVar[str] = ""
    answers_to: ClassVar[str] = ""
    made_for: ClassVar[str] = ""
    cost_ms: ClassVar[float | None] = None
    least_size: ClassVar[tuple[int, int]] = (1, 1)
    warm_up: ClassVar[int] = 1
    witnesses: ClassVar[tuple[str, ...]] = ()
    places: ClassVar[bool] = False

    def __init__(
        self,
        shape: tuple[int, int],
        params: Parameters | None = None,
        *,
        frame_rate: float | Fraction | None = None,
        layers: Layers | None = None,
    ) -> None:
        shape = checked_shape(shape)
        self.need_size(shape, self.least_size)
        if params is not None and not isinstance(params, self.parameters):
            raise ParameterError(
                f"params must be of the class {self.parameters.__name__}, such as "
                f"parameters_of('{self.name}'), not {params!r:.60}"
            )
        self.layers = layers or Layers(shape, Clock(TimeParams(interval=self.interval), frame_rate))
        self.shape, self.frame_rate = shape, None if frame_rate is None else float(frame_rate)
        self.params = (params or self.parameters()).resolved(min(shape))

    def __init_subclass__(cls) -> None:
        super().__init_subclass__()
        cls.by_default = vars(cls).get("by_default", False)
        if "responses" in vars(cls) and "details" not in vars(cls):
            declared = [value for value in fields(cls.responses) if "column" in value.metadata]
            cls.details = tuple(Column(value.name, *value.metadata["column"]) for value in declared)

    @abstractmethod
    def step(self, luma: Map) -> Response | None:
        """Take the next frame and return the response to it; None during warm-up.

        The frame's presentation time, if known, is ``self.layers.time_s``.

        Parameters
        ----------
        luma : ndarray of float32, shape (height, width)
            Luminance L(t), 0 to 1.

        Raises
        ------
        FrameError
            If the array is not a luminance image of the right shape.
        """

    @abstractmethod
    def reset(self) -> None:
        """Forget all frames: the next frame is frame 0.

        Detectors that share layers must be reset together, as ``DetectorBank.reset`` does.
        """

    @classmethod
    def need_size(cls, shape: tuple[int, int], least: tuple[int, int]) -> None:
        """Raise a ParameterError if the frames' height or width in px is below `least`."""
        if shape[0] < least[0] or shape[1] < least[1]:
            raise ParameterError(
                f"model '{cls.name}' needs frames of at least {least[1]} x {least[0]} px, not "
                f"{shape[1]} x {shape[0]}; raise the working height (--height), or "
                "choose another model"
            )

    def at_rest(self) -> Response:
        """Return the response, 0, to a frame in which nothing changed.

        A subclass keeps the latest value of inner values that last longer than the motion.
        """
        return self.responses(0.0)

    def separate(self) -> None:  # noqa: B027
        """Replace layers that it shares by copies of its own.

        It is called before the first picture between frames, which other detectors do not get.
        """

    @property
    def maps(self) -> dict[str, Map]:
        """The layers of the latest frame by their symbols, such as ``P`` and ``S``.

        Arrays of float32, shape (height, width); the next frame overwrites them. Empty if the
        detector has no layers.
        """
        return {}

    @property
    def units(self) -> UnitMaps | None:
        """The units at the latest frame; None if the detector has no units."""
        return None
