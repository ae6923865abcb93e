"""Looming objects: their places, their numbers, and their times to contact (``docs/places.md``)."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, NamedTuple

import cv2
import numpy as np

from oppload_cli.detection.contact import Contact
from oppload_cli.frame_times import ticks
from oppload_cli.models.detector import Box
from oppload_cli.motion.growth import box_about, motion_about

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from oppload_cli.detection.contact import PlaceParams
    from oppload_cli.models.detector import Response, UnitMaps
    from oppload_cli.models.dpc import Map
    from oppload_cli.motion.flow import Flow
    from oppload_cli.video.frames import WorkingSize
    from oppload_cli.video.optics import Optics, View

    Floats = NDArray[np.float64]


class Detection(NamedTuple):
    """One looming object in one frame: a line of ``detections.jsonl``.

    Attributes
    ----------
    identity : int
        Number of the object, the same in all its frames; numbers start at 1.
    box : Box
        The object's box in source pixels, cut to the frame.
    centre_x, centre_y : float
        The object's focus of expansion in source pixels.
    response : float
        The detector's response there, at least 0.
    alarm : bool
        Whether the alarm is on because of this object.
    time_to_contact_s : float or None
        Estimate in seconds, above 0; None if it is not determined.
    time_to_contact_error_s : float or None
        Error of the estimate in seconds, the scatter of single estimates (``docs/places.md``).
    view : View or None
        Box, focus and growth in degrees; None if the field of view is not known.

    Examples
    --------
    >>> import oppload_cli as oppload
    >>> records = oppload.analyse("controls/looming-perspective", rmo=False)
    >>> found = [seen for record in records for seen in record.detections if seen.alarm]
    >>> found[0].identity, 0 < found[0].box.width < found[-1].box.width
    (1, True)
    """

    identity: int
    box: Box
    centre_x: float
    centre_y: float
    response: float
    alarm: bool
    time_to_contact_s: float | None
    time_to_contact_error_s: float | None = None
    view: View | None = None

    def seen_through(self, optics: Optics) -> Detection:
        """Return the same object with its view in degrees."""
        centre = self.centre_x, self.centre_y
        return self._replace(view=optics.view(self.box, centre, self.time_to_contact_s))

    def after(self, passed_s: float) -> Detection:
        """Return the same object `passed_s` seconds later, without a new measurement."""
        remaining_s = self.time_to_contact_s and self.time_to_contact_s - passed_s
        if remaining_s is None or remaining_s <= 0:
            view = self.view and self.view._replace(angular_speed_deg_s=None)
            return self._replace(time_to_contact_s=None, time_to_contact_error_s=None, view=view)
        return self._replace(time_to_contact_s=remaining_s)


_NEIGHBOURS = np.ones((3, 3), np.uint8)
_NEAR = 0.25  # a peak nearer to an object's focus, in receptive fields, belongs to the object
_GROWTH = 1.25  # growth from one frame to the next shortly before contact


class _Peak(NamedTuple):
    """A unit with a larger response than the units around it."""

    row: int
    column: int
    response: float


def _peaks(maps: UnitMaps, params: PlaceParams) -> list[_Peak]:
    """Find the units with the largest response in their receptive field.

    The peaks are sorted by response, so that the winning unit of the frame comes first, if it
    reaches the floor. No peak lies in the receptive field of an earlier peak.
    """
    responses = maps.responses
    least = max(params.floor or 0.0, (params.share or 0.0) * float(responses.max()))
    tops = (
        (responses >= cv2.dilate(responses, _NEIGHBOURS)) & (responses >= least) & (responses > 0)
    )
    rows, columns = np.nonzero(tops)
    order = np.argsort(-responses[rows, columns], kind="stable")
    peaks: list[_Peak] = []
    for row, column in zip(rows[order].tolist(), columns[order].tolist(), strict=True):
        if len(peaks) == params.most:
            break
        if not any(_shares_field(maps, row, column, peak) for peak in peaks):
            peaks.append(_Peak(row, column, float(responses[row, column])))
    return peaks


def _shares_field(maps: UnitMaps, row: int, column: int, peak: _Peak) -> bool:
    across = abs(maps.centres_x[column] - maps.centres_x[peak.column])
    down = abs(maps.centres_y[row] - maps.centres_y[peak.row])
    return bool(max(across, down) < maps.field / 2)


def _focus(maps: UnitMaps, row: int, column: int) -> tuple[float, float]:
    """Return the place (x, y) of a peak in working pixels, within half a cell of its unit."""
    across, down = maps.responses[row], maps.responses[:, column]
    return _top(across, maps.centres_x, column), _top(down, maps.centres_y, row)


def _top(values: Map, centres: Floats, index: int) -> float:
    """Return the top of the parabola through the logarithms of a peak and its two neighbours."""
    centre = float(centres[index])
    if not 0 < index < len(centres) - 1 or not (values[index - 1 : index + 2] > 0).all():
        return centre
    before, top, after = np.log(values[index - 1 : index + 2].astype(np.float64))
    bend = before - 2 * top + after
    if bend == 0:
        return centre
    return centre + 0.5 * float((before - after) / bend) * float(centres[1] - centres[0])


@dataclass(eq=False)
class Track:
    """One object over time, in working pixels.

    Attributes
    ----------
    identity : int
        Number of the object, from 1.
    x, y : float
        Focus of expansion.
    box : Box
        The part of the picture that moves as the focus does; before the flow shows it, the
        receptive field of the unit.
    response : float
        Response in the latest frame that showed the object.
    seen : int
        Time of that frame in ticks.
    time_to_contact_s, time_to_contact_error_s : float or None
        Estimate in that frame, and its error.
    """

    identity: int
    x: float
    y: float
    box: Box
    response: float
    seen: int
    contact: Contact = field(repr=False)
    time_to_contact_s: float | None = None
    time_to_contact_error_s: float | None = None

    def distance_to(self, x: float, y: float, near: float) -> float | None:
        """Return a point's distance from the middle of the box, 0 to 1; None outside the object.

        1 is half the size of the box, enlarged for its growth, or `near` (px) if that is larger.
        """
        middle_x, middle_y = self.box.centre
        reach_x, reach_y = (max(near, _GROWTH * side / 2) for side in self.box[2:])
        distance = max(abs(x - middle_x) / reach_x, abs(y - middle_y) / reach_y)
        return distance if distance <= 1 else None


class Places:
    """The looming objects of one video, from one frame to the next; past frames only.

    Parameters
    ----------
    params : PlaceParams
        Parameters of the search.
    """

    _maps: UnitMaps

    def __init__(self, params: PlaceParams) -> None:
        self._params = params
        self._tracks: list[Track] = []
        self._count = 0
        self._before: int | None = None  # time of the frame before in ticks

    def step(self, maps: UnitMaps, flow: Flow | None, time_s: float) -> list[Track]:
        """Find the objects of the latest frame.

        Parameters
        ----------
        maps : UnitMaps
            The units at that frame.
        flow : Flow or None
            The motion since an earlier picture; None if it is not known.
        time_s : float
            Time in seconds at which its picture was taken.

        Returns
        -------
        list of Track
            The objects of this frame, the largest response first. The frame's winning unit belongs
            to the first object.
        """
        self._maps, self._flow = maps, flow
        peaks = _peaks(maps, self._params)
        oldest = ticks(time_s) - ticks(self._params.gap_s)
        if self._before is not None:  # an object of the frame before stays, however long ago it was
            oldest = min(oldest, self._before)
        self._tracks = [track for track in self._tracks if track.seen >= oldest]
        shown: list[Track] = []
        for peak in peaks:
            track = self._owner(peak) or self._new_track(peak)
            if track not in shown:
                self._follow(track, peak, time_s)
                shown.append(track)
        self._before = ticks(time_s)
        return shown

    def _owner(self, peak: _Peak) -> Track | None:
        x, y = self._maps.centres_x[peak.column], self._maps.centres_y[peak.row]
        near = _NEAR * self._maps.field
        distances = [(track.distance_to(x, y, near), track) for track in self._tracks]
        own = [(away, track.identity, track) for away, track in distances if away is not None]
        return min(own)[2] if own else None

    def _new_track(self, peak: _Peak) -> Track:
        self._count += 1
        field = self._maps.box(peak.row, peak.column)
        track = Track(self._count, *field.centre, field, 0.0, 0, Contact(self._params))
        self._tracks.append(track)
        return track

    def _follow(self, track: Track, peak: _Peak, time_s: float) -> None:
        """Take an object's place in the latest frame; measure its box and its time to contact."""
        track.x, track.y = _focus(self._maps, peak.row, peak.column)
        track.response, track.seen = peak.response, ticks(time_s)
        flow = self._flow
        if flow is not None and (motion := motion_about(flow, track.x, track.y)):
            track.contact.add(time_s, flow.passed_s, motion)
            if edges := box_about(flow, track.x, track.y, motion):
                left, top, right, bottom = edges
                track.box = Box(left, top, right - left, bottom - top)
        remaining = track.contact.remaining(time_s)
        track.time_to_contact_s, track.time_to_contact_error_s = remaining or (None, None)


class Detections:
    """The looming objects of one video, in source pixels (``docs/places.md``).

    Parameters
    ----------
    working : WorkingSize
        Size of the working frames, and its scale.
    params : PlaceParams
        Parameters of the search.
    """

    def __init__(self, working: WorkingSize, params: PlaceParams) -> None:
        self._places = Places(params)
        self._working = working
        self._cause: int | None = None

    def step(self, maps: UnitMaps, flow: Flow | None, time_s: float) -> tuple[Detection, ...]:
        """Find the objects of the latest frame; :meth:`with_alarm` sets their alarms.

        Arguments and order are those of :meth:`Places.step`.
        """
        return tuple(
            Detection(
                track.identity,
                *self._in_source(track.box, (track.x, track.y)),
                track.response,
                alarm=False,
                time_to_contact_s=track.time_to_contact_s,
                time_to_contact_error_s=track.time_to_contact_error_s,
            )
            for track in self._places.step(maps, flow, time_s)
        )

    def with_alarm(
        self, found: Sequence[Detection], *, alarm: bool, threshold: float
    ) -> tuple[Detection, ...]:
        """Set for each object whether the detector's alarm is on because of this object.

        The alarm is on because of the objects with a response above the frame's threshold, and of
        the object that had the largest response when the alarm started. `found` is sorted: largest
        response first.
        """
        if not alarm:
            self._cause = None
        elif self._cause is None and found:
            self._cause = found[0].identity
        return tuple(
            detection._replace(
                alarm=alarm
                and (detection.identity == self._cause or detection.response > threshold)
            )
            for detection in found
        )

    def of_box(self, response: Response) -> tuple[Detection, ...]:
        """Return the only object of a detector without units: the box of its response.

        The box of `response` is in working pixels.
        """
        if response.box is None:
            return ()
        place = self._in_source(response.box, response.box.centre)
        return (Detection(1, *place, response.response, False, None),)

    def _in_source(self, box: Box, place: tuple[float, float]) -> tuple[Box, float, float]:
        """Return a box cut to the frame, and a place, in source pixels."""
        scale_x, scale_y = self._working.scale_x, self._working.scale_y
        left, top = max(0.0, box.x), max(0.0, box.y)
        right = min(float(self._working.width), box.x + box.width)
        bottom = min(float(self._working.height), box.y + box.height)
        size = (right - left) * scale_x, (bottom - top) * scale_y
        return Box(left * scale_x, top * scale_y, *size), place[0] * scale_x, place[1] * scale_y
