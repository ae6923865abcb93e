"""Effects of cameras: light that flickers, noise, a view that moves, bars, edges of the frame.

OppLoD's preset ``default`` removes these effects before it judges motion
(``docs/default-equations.md``).
"""

from __future__ import annotations

import cmath
import math
from collections import deque
from typing import TYPE_CHECKING, Any, NamedTuple

import cv2
import numpy as np

from oppload_cli.compute.loops import with_twin
from oppload_cli.models.dpc import grey_levels, smaller
from oppload_cli.motion.flow import SHORTEST_SIDE, inverse_search

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from numpy.typing import NDArray

    from oppload_cli.models.dpc import Map

    Grey = NDArray[np.uint8]
    Complex = NDArray[np.complexfloating]  # places or vectors, as x + i y
    # A matrix M, shape (3, 3): the pixel at (x, y) of one frame is at M (x, y, 1) in another one.
    Motion = NDArray[np.float64]

# Functions that turn a map so that its lines begin at the left, right, top or bottom of the frame.
_SIDES: tuple[Callable[[Map], Map], ...] = (
    lambda each: each,
    lambda each: each[:, ::-1],
    lambda each: each.T,
    lambda each: each[::-1].T,
)


# ---- Light ---------------------------------------------------------------------------------

_CELL = 8  # px; with larger cells, more moving gratings look like a change of the light
_DARKEST, _BRIGHTEST = 0.04, 0.997  # range of the luminance in which a gain can be measured
_LEAST_CELLS, _LEAST_USABLE = 20, 1 / 4  # cells in this range: least number, and least share
_LEAST_CHANGE = 1e-3  # least change of the logarithm of the luminance that counts
_MOST_CHANGE, _MOST_GAIN = 0.5, 0.7  # largest gain between two frames, and in all, as logarithms
# The gain must explain the change in this share of the cells. In a moving grating up to half of the
# cells can change by the same gain.
_EXPLAINED = 0.7
# The unexplained change may be at most this share of the median change. The share is smaller for
# one gain per row of cells, since such gains can also explain motion up or down.
_UNEXPLAINED, _UNEXPLAINED_BY_ROWS = 1 / 2, 1 / 4


class SteadyLight:
    """Changes frames so that the light of the video is steady.

    If a lamp flickers or a camera adapts its exposure, one gain multiplies the luminance of all
    pixels; with a rolling shutter each row has its own gain. The gain between two frames is the
    median, over cells of the frame, of the ratio of their luminance. It is used only if it explains
    most of the change. If the scene or the camera moves, it does not.

    Parameters
    ----------
    lasting : float
        Time constant in intervals with which a lasting change of the light passes, above 0.

    Source: ``docs/default-equations.md``.
    """

    def __init__(self, lasting: float) -> None:
        self._lasting = lasting
        self._before: Map | None = None
        self._gains: Map | None = None  # the logarithm of the gain of each row of cells

    def step(self, luma: Map, usual_step: float) -> Map:
        """Return the next frame without the changes of its light.

        `usual_step` is the usual number of intervals from one frame to the next. The result has
        luminance up to 2; if the light is steady it is `luma` itself.
        """
        cells = smaller(luma, _CELL)
        before, self._before = self._before, cells
        if before is None or self._gains is None:
            self._gains = np.zeros((len(cells), 1), np.float32)
            return luma
        self._gains *= np.float32(math.exp(-usual_step / self._lasting))
        self._gains += change_of_light(before, cells)
        np.clip(self._gains, -_MOST_GAIN, _MOST_GAIN, out=self._gains)
        if np.abs(self._gains).max() < _LEAST_CHANGE:
            return luma
        profile = cv2.resize(np.exp(-self._gains), (1, len(luma)), interpolation=cv2.INTER_LINEAR)
        return np.asarray(luma * profile, np.float32)


def change_of_light(before: Map, now: Map) -> NDArray[np.float32]:
    """Return the logarithm of the gain of the light between two frames.

    `before` and `now` are the mean luminance over cells, 0 to 1, shape (rows, columns). The result
    is one gain, shape (1, 1), or one for each row of cells, shape (rows, 1); 0 if neither explains
    the change.
    """
    no_gain = np.zeros((1, 1), np.float32)
    darker = np.minimum(before, now)
    usable = (darker > _DARKEST) & (darker < _BRIGHTEST)
    if np.count_nonzero(usable) < max(_LEAST_CELLS, _LEAST_USABLE * usable.size):
        return no_gain
    logarithms = np.log(now, where=usable, out=np.zeros_like(now))
    logarithms -= np.log(before, where=usable, out=np.zeros_like(now))
    change = _quantile(np.abs(logarithms[usable]), 1 / 2)
    if change < _LEAST_CHANGE:
        return no_gain
    gain = _quantile(logarithms[usable], 1 / 2)
    unexplained = _quantile(np.abs(logarithms[usable] - gain), _EXPLAINED)
    if abs(gain) < _MOST_CHANGE and unexplained <= _UNEXPLAINED * change:
        return no_gain + np.float32(gain)
    # If rows of cells have little contrast, motion up or down looks like a gain of each row.
    contrast = np.abs(before[:, 1:] - before[:, :-1]) / np.maximum(before[:, 1:], _DARKEST)
    if usable.mean() < _EXPLAINED or not contrast.size or _quantile(contrast, 1 / 2) < change / 4:
        return no_gain
    gains = np.sort(logarithms, axis=1)[:, logarithms.shape[1] // 2, None]
    unexplained = _quantile(np.abs(logarithms - gains)[usable], _EXPLAINED)
    if np.abs(gains).max() < _MOST_CHANGE and unexplained <= _UNEXPLAINED_BY_ROWS * change:
        return gains
    return no_gain


def _quantile(values: NDArray[np.floating], share: float) -> float:
    """Return the value below which a share of the values lies, ten times faster than NumPy does."""
    ordered = np.sort(values, axis=None)
    return float(ordered[int(share * len(ordered))])


# ---- Noise ---------------------------------------------------------------------------------

# A sum over 3 x 3 px that is 0 where luminance rises evenly, and that keeps the variance of noise.
_FINE = np.array([[1, -2, 1], [-2, 4, -2], [1, -2, 1]], np.float32) / 6
_NOISE_CELL = 16  # px
_STEADIEST = 1 / 4  # quantile over the cells: fast motion looks like noise in the cells above
_NOISE_LASTS = 30  # intervals over which the variance of the noise is averaged
_LEAST_BLUR, _MOST_BLUR = 0.4, 3.0  # px, standard deviation


class NoiseFilter:
    """Blurs frames as much as their noise requires, so that little noise is left.

    If noise makes a pixel too bright in one frame, the next frame takes this change back. So the
    mean product of two successive changes is minus the variance of the noise. The product of slow
    motion is positive, and fast motion seldom fills the picture. Only the fine structure of the
    changes is multiplied, because that of motion is mostly coarse.

    Parameters
    ----------
    residual : float
        Standard deviation of the noise that may be left, in luminance of 0 to 1, above 0.

    Source: ``docs/default-equations.md``, section 1; the 3 x 3 sum is that of Immerkaer 1996.
    """

    def __init__(self, residual: float) -> None:
        self._residual = residual
        self._fine: Map | None = None  # the fine structure of the latest frame
        self._change: Map | None = None  # its latest change
        self._measured = 0
        self._variance = 0.0

    def step(self, luma: Map, usual_step: float) -> Map:
        """Return the next frame, blurred; `usual_step` is as for :class:`SteadyLight`.

        A frame with little noise is returned itself.
        """
        before, self._fine = self._fine, np.asarray(cv2.filter2D(luma, -1, _FINE))
        if before is not None:
            change_before, self._change = self._change, self._fine - before
            if change_before is not None:
                products = -self._change * change_before
                self._measure(smaller(products, _NOISE_CELL), usual_step)
        blur = math.sqrt(self._variance / (4 * math.pi)) / self._residual
        if blur < _LEAST_BLUR:
            return luma
        return np.asarray(cv2.GaussianBlur(luma, (0, 0), min(blur, _MOST_BLUR)), np.float32)

    def _measure(self, variances: Map, usual_step: float) -> None:
        """Average the variance of the noise, given by cells, over time."""
        variance = max(0.0, _quantile(variances, _STEADIEST))
        self._measured += 1
        share = max(1 / self._measured, min(1.0, usual_step / _NOISE_LASTS))
        self._variance += share * (variance - self._variance)


# ---- View ----------------------------------------------------------------------------------

_FLOW_SIDE = 120  # px; flow is measured in frames whose shorter side is reduced to about this
_FLOW_CELL = 6  # px of a reduced frame
# Of a straight edge only the motion across it is known. So cells count in which the luminance
# changes in every direction, by about a grey level per px: then `cornerMinEigenVal` is above this.
_LEAST_TEXTURE = 6e-5
_LEAST_TEXTURED = 1 / 4  # least share of the cells that have texture
_FITS = 5  # number of fits, each with the weights that follow from the fit before
_LEAST_SPREAD = 0.15  # px; errors of the flow of this size do not lower a weight
_LEAST_MOTION_PX = 0.25  # of a reduced frame; less motion in an interval is left in the picture
# The motion explains a cell with texture if it leaves less than 0.8 of the change there.
_REMAINING = 0.8
# Shares of the cells that it explains, up to which none and from which all of the motion is the
# view's. With one limit instead, rounding in one cell can decide whether the view moves.
_NONE_EXPLAINED, _ALL_EXPLAINED = 0.35, 0.65
_MOST_FRAMES = 16  # frames per interval; at higher frame rates the view is compared sooner


class SteadyView:
    """Measures how the view of the camera moves, so that P can leave its motion out.

    A camera that pans, shakes or rolls moves the picture of everything. The motion of the ground
    then inhibits the response to an object that approaches. This class fits a shift, a turn and a
    growth of the complete picture to the optical flow from one interval ago. If they explain the
    change of most cells, the shift and the turn are the motion of the view; if they explain that of
    about half, a part of them. The growth is not: an object that fills the picture grows too.

    Source: ``docs/default-equations.md``; for the flow (dense inverse search) Kroeger et al. 2016.
    """

    def __init__(self) -> None:
        self._latest: deque[tuple[Grey, Motion]] = deque(maxlen=_MOST_FRAMES)

    def step(self, luma: Map, usual_step: float) -> Motion:
        """Take the next frame; return the motion of the view from the first frame to this one.

        `usual_step` is as for :class:`SteadyLight`. The result leads from the place of a pixel in
        this frame to its place in the first one.
        """
        reduction = max(1, round(min(luma.shape) / _FLOW_SIDE))
        small = smaller(luma, reduction)
        now = grey_levels(small, small.shape)
        view: Motion = np.eye(3)
        if self._latest:
            # At 75 frames/s an interval is 2.5 frames; 0.01 more, and rounding does not decide.
            frames = max(1, round(1 / usual_step + 0.01))
            before, view = self._latest[-min(len(self._latest), frames)]
            if (motion := view_motion(before, now)) is not None:
                view = view @ reduced(motion, 1 / reduction)
        self._latest.append((now, view))
        return view


def view_motion(before: Grey, now: Grey) -> Motion | None:
    """Return the motion of the view between two reduced frames; None if none is found.

    Both frames are uint8, of the same shape. The result leads from places in `now` to places in
    `before`, in their pixels.
    """
    if min(now.shape) < SHORTEST_SIDE or np.array_equal(before, now):
        return None
    textured = _cell_means(cv2.cornerMinEigenVal(now, _FLOW_CELL)) > _LEAST_TEXTURE
    if textured.mean() < _LEAST_TEXTURED:
        return None
    search = inverse_search(now.shape, cv2.DISOPTICAL_FLOW_PRESET_FAST)
    flow = search.calc(now, before, np.zeros((*now.shape, 2), np.float32))
    middle = complex(now.shape[1] - 1, now.shape[0] - 1) / 2
    y, x = np.mgrid[: textured.shape[0], : textured.shape[1]] * _FLOW_CELL + (_FLOW_CELL - 1) / 2
    vectors = _cell_means(flow)[textured].astype(np.float64) @ (1, 1j)
    shift, factor = fitted_motion((x + 1j * y - middle)[textured], vectors)
    turn = cmath.phase(factor)
    if abs(shift) + abs(cmath.rect(1, turn) - 1) * abs(middle) < _LEAST_MOTION_PX:
        return None
    seen = seen_from(before, _matrix(shift, factor, middle), 0)
    remaining, change = (_cell_means(cv2.absdiff(now, each))[textured] for each in (seen, before))
    explained = np.mean(remaining < _REMAINING * change)
    share = float(np.interp(explained, (_NONE_EXPLAINED, _ALL_EXPLAINED), (0, 1)))
    return _matrix(share * shift, cmath.rect(1, share * turn), middle) if share else None


def fitted_motion(places: Complex, flow: Complex) -> tuple[complex, complex]:
    """Fit a shift, a turn and a growth to the flow at some places, as most of them move.

    Parameters
    ----------
    places, flow : ndarray of complex, shape (n,)
        Places and flow vectors, as ``x + i y``, in px.

    Returns
    -------
    tuple of complex
        The shift in px, and the factor by which places are multiplied: its angle is the turn, its
        absolute value the growth.
    """
    shift, change = complex(np.median(flow.real), np.median(flow.imag)), 0j
    for _ in range(_FITS):
        errors = np.abs(shift + change * places - flow)
        spread = max(_LEAST_SPREAD, 1.4 * float(np.median(errors)))
        weights = (1 + (errors / spread) ** 2) ** -2
        weights /= weights.sum()
        place, vector = weights @ places, weights @ flow
        centred = places - place
        size = float(weights @ np.abs(centred) ** 2)
        change = complex(weights @ (np.conj(centred) * (flow - vector))) / max(size, 1e-9)
        shift = complex(vector - change * place)
    return shift, 1 + change


def _matrix(shift: complex, factor: complex, middle: complex) -> Motion:
    """Return the motion that multiplies places about the middle of the frame and shifts them."""
    origin = shift + middle - factor * middle
    return np.array(
        [
            [factor.real, -factor.imag, origin.real],
            [factor.imag, factor.real, origin.imag],
            [0, 0, 1],
        ]
    )


def _cell_means(values: NDArray[Any]) -> NDArray[np.float32]:
    rows, columns = (side // _FLOW_CELL for side in values.shape[:2])
    part = values[: rows * _FLOW_CELL, : columns * _FLOW_CELL]
    return np.asarray(cv2.resize(part, (columns, rows), interpolation=cv2.INTER_AREA), np.float32)


def reduced(motion: Motion, reduction: float) -> Motion:
    """Return a motion in the pixels of frames whose sides are divided by `reduction`."""
    offset = (reduction - 1) / 2
    enlarged = np.array([[reduction, 0, offset], [0, reduction, offset], [0, 0, 1]])
    return np.asarray(np.linalg.inv(enlarged) @ motion @ enlarged)


def seen_from(
    values: NDArray[Any], motion: Motion, outside: float, interpolation: int = cv2.INTER_CUBIC
) -> NDArray[Any]:
    """Return a map of an earlier frame as a later view shows it.

    Parameters
    ----------
    values : ndarray of float32 or uint8, shape (height, width)
        The map.
    motion : ndarray, shape (3, 3)
        From places in the later frame to places in the earlier one.
    outside : float
        Value at the places that the earlier frame does not show.
    interpolation : int
        OpenCV's constant; cubic interpolation blurs textures less than linear, in 4 times the time.
    """
    # Not BORDER_TRANSPARENT: with cubic interpolation, OpenCV 5 takes values of other places there.
    flags, size = interpolation | cv2.WARP_INVERSE_MAP, values.shape[::-1]
    return cv2.warpAffine(
        values, motion[:2], size, flags=flags, borderMode=cv2.BORDER_CONSTANT, borderValue=outside
    )


# ---- Bars ----------------------------------------------------------------------------------

_TOLERANCE, _EDGE = 6 / 255, 10 / 255  # variation of a bar's luminance; least step at its edge
_BEYOND = 3  # px from the first line of the edge to the line that is tested: scaling blurs edges
_LEAST_EDGE = 0.8  # least share of the pixels of that line that differ
# Intervals that a strip must last to be a bar: a little less than a quarter of a second, which is a
# whole number of frames at many rates, so that the rounding of the times would decide.
_LASTING = 7.4
_WIDEST = 0.45  # largest width of a bar, as a share of the frame's side


class Widths(NamedTuple):
    """Widths in pixels of the bars along the four sides of the frame."""

    left: int = 0
    right: int = 0
    top: int = 0
    bottom: int = 0


NO_BARS = Widths()


class Bars:
    """Plain strips along the sides of the frame, as beside a portrait video in a wide frame.

    An edge that appears from behind a bar meets no inhibition, like an edge that enters the frame.
    A strip is a bar if its width has been the same for 7.4 intervals, nearly a quarter of a second.
    It must also end in a straight edge along most of the side.

    Attributes
    ----------
    widths : Widths
        The bars of the latest frame.
    """

    def __init__(self) -> None:
        self.widths = NO_BARS
        self._candidates = [0, 0, 0, 0]
        self._lasted = [0.0, 0.0, 0.0, 0.0]

    def step(self, luma: Map, usual_step: float) -> None:
        """Take the next frame; `usual_step` as for :class:`SteadyLight`."""
        widths = list(self.widths)
        for n, side in enumerate(_SIDES):
            width, edge = _plain_strip(side(luma).T)
            if width is None:
                continue
            if width < widths[n] - 1:  # an object moves over the strip: it is no bar
                widths[n] = 0
            if abs(width - self._candidates[n]) > 1 or not edge:
                self._candidates[n], self._lasted[n] = width, 0.0
                continue
            self._lasted[n] += usual_step
            if self._lasted[n] >= _LASTING:
                widths[n] = self._candidates[n]
        self.widths = Widths(*widths)


def _plain_strip(lines: Map) -> tuple[int | None, bool]:
    """Return the number of plain lines along a side, and whether an edge follows them.

    The lines are ordered from the side inwards. The number is None if all lines up to the largest
    width of a bar are plain.
    """
    first = lines[0]
    colour = float(first[len(first) // 2])
    if float(np.abs(first - colour).max()) > _TOLERANCE:
        return 0, False
    most = int(_WIDEST * len(lines))
    differs = np.abs(lines[: most + 1] - colour).max(axis=1) > _TOLERANCE
    if not differs.any():
        return None, False
    plain = int(differs.argmax())
    beyond = np.abs(lines[min(plain + _BEYOND, len(lines) - 1)] - colour) > _EDGE
    return plain, float(beyond.mean()) >= _LEAST_EDGE


# ---- Edges of the frame --------------------------------------------------------------------

# Least P of a pixel that moves: as luminance, and as a share of the largest P beside the edge.
_LEAST_P, _LEAST_P_SHARE = 0.02, 0.3


def leave_out_entering(
    maps: Sequence[Map], change: Map, reach: int, border: int, bars: Widths = NO_BARS
) -> None:
    """Set S_phi to 0 where the motion may have come from outside the frame.

    A fast edge that enters the frame moves by more than the kernels' radius from frame to frame.
    Its earlier motion, which would inhibit it, was outside the frame. A fast edge that leaves the
    frame is cut off. Both excite the pathways of both directions. The function sets S_phi to 0 at
    changed pixels that reach the edge of the frame without a break.

    Parameters
    ----------
    maps : sequence of four ndarray of float32, shape (height, width)
        S_phi; changed in place.
    change : ndarray of float32, shape (height, width)
        P(t), 0 to 1.
    reach, border : int
        `reach` is the largest distance from the edge at which S_phi is set to 0. The P of the
        motion is the largest P up to the distance `border`. Both are in px, at least 0.
    bars : Widths
        Bars beside the picture; their edges count as edges of the frame.

    Source: ``docs/default-equations.md``.
    """
    height, width = change.shape
    picture = np.s_[bars.top : height - bars.bottom, bars.left : width - bars.right]
    p, *pathways = (each[picture] for each in (change, *maps))
    for side in _SIDES:
        strips = [side(pathway)[:, :reach] for pathway in pathways]
        leave_out_moving(strips, side(p)[:, :reach], border, _LEAST_P, _LEAST_P_SHARE)


@with_twin
def leave_out_moving(
    maps: Sequence[Map], change: Map, border: int, least: float, share: float
) -> None:
    """Set S_phi to 0 at the start of each line, up to the first pixel that does not move.

    Parameters
    ----------
    maps : sequence of four ndarray of float32, shape (lines, pixels)
        S_phi; changed in place. The views of all maps and of `change` have the same strides.
    change : ndarray of float32, shape (lines, pixels)
        P(t), 0 to 1.
    border : int
        Number of pixels at the start of each line; their largest P is the P of the line's motion.
    least, share : float
        Least P of a pixel that moves: as luminance, and as a share of the P of the line's motion.
    """
    at_edge = change[:, :border].max(axis=1, initial=0.0, keepdims=True)
    rests = np.ones((len(change), change.shape[1] + 1), np.bool_)
    rests[:, :-1] = change < np.maximum(np.float32(least), np.float32(share) * at_edge)
    kept = np.arange(change.shape[1]) >= rests.argmax(axis=1)[:, None]
    for each in maps:
        np.multiply(each, kept, out=each)
