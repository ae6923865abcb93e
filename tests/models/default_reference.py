"""Preset `default` once more: literal, written from docs/default-equations.md.

Only for frames at a constant rate of 30 per second. Its sections have the numbers of that page.
Bars (section 3) are left out. Nothing is shared with the package.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import cv2
import numpy as np

from tests import reference

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator

    from numpy.typing import NDArray

    Array = NDArray[Any]

CELL, FIELD, BORDER, ENTERING = 12, 240, 6, 24  # px, at a working height of 240
HALVED_WEIGHT, HISTORY, PERSISTENCE, LEVEL = 2, 1 / 8, 0.45, 0.035
RESIDUAL_NOISE = 0.004
LIGHT, BACKGROUND, GUARD = 4 * 30, 4 * 30, 0.228 * 30 + 1 / 4  # frames
STRIDES = {1: 2, 2: 1}  # frames between compared frames, by the reduction of the frame
PASSING, DISPLACED = 0.25, (4, 20)  # px at half size
AXES, CONE = {45: (1, -1), 135: (-1, -1)}, 60  # degrees; right and down, times sqrt(2)


def cell_means(values: Array, side: int, *, centred: bool = False) -> Array:
    """Means over squares, without the rows and columns that fill none."""
    rows, columns = (length // side for length in values.shape[:2])
    top, left = ((length % side) // 2 if centred else 0 for length in values.shape[:2])
    part = values[top : top + rows * side, left : left + columns * side]
    return np.asarray(part.reshape(rows, side, columns, side, -1).mean(axis=(1, 3)).squeeze())


def quantile(values: Array, share: float) -> Any:
    return np.sort(values, axis=None)[int(share * values.size)]


# ---- 1. Steady light and noise filter --------------------------------------------------------


def gains_of_light(before: Array, now: Array) -> Array:
    """The logarithm of the gain of each row of squares; one value if all rows have the same."""
    none = np.zeros(1)
    usable = (np.minimum(before, now) > 0.04) & (np.minimum(before, now) < 0.997)
    if usable.sum() < 20 or usable.mean() < 1 / 4:
        return none
    change = np.log(np.where(usable, now, 1) / np.where(usable, before, 1))
    typical = quantile(np.abs(change[usable]), 1 / 2)
    if typical < 1e-3:
        return none
    gain = quantile(change[usable], 1 / 2)
    if abs(gain) < 0.5 and quantile(np.abs(change[usable] - gain), 0.7) <= typical / 2:
        return np.asarray(none + gain)
    contrast = np.abs(np.diff(before)) / np.maximum(before[:, 1:], 0.04)
    if usable.mean() < 0.7 or quantile(contrast, 1 / 2) < typical / 4:
        return none
    gains = np.array([quantile(row, 1 / 2) for row in change])
    left = np.abs(change - gains[:, None])[usable]
    explained = np.abs(gains).max() < 0.5 and quantile(left, 0.7) <= typical / 4
    return gains if explained else none


def steady_light(frames: Iterable[Array]) -> Iterator[Array]:
    before = None
    for luma in frames:
        cells = cell_means(luma, 8)
        if before is None:
            total = np.zeros(len(cells))
        else:
            total = total * np.exp(-1 / LIGHT) + gains_of_light(before, cells)
            total = np.clip(total, -0.7, 0.7)
        before = cells
        gains = np.exp(-total) if np.abs(total).max() >= 1e-3 else np.ones_like(total)
        places = (np.arange(len(luma)) + 0.5) * len(total) / len(luma) - 0.5
        yield luma * np.interp(places, np.arange(len(total)), gains)[:, None]


def noise_filter(frames: Iterable[Array]) -> Iterator[Array]:
    fine = np.array([[1, -2, 1], [-2, 4, -2], [1, -2, 1]]) / 6
    before, change, variance, count = None, None, 0.0, 0
    for luma in frames:
        if before is not None:
            earlier, change = change, cv2.filter2D(luma - before, -1, fine)
            if earlier is not None:
                count += 1
                measured = max(0, quantile(cell_means(-change * earlier, 16), 1 / 4))
                variance += max(1 / count, 1 / 30) * (measured - variance)
        before, blur = luma, np.sqrt(variance / (4 * np.pi)) / RESIDUAL_NOISE
        yield luma if blur < 0.4 else cv2.GaussianBlur(luma, (0, 0), min(blur, 3))


# ---- 2. Steady view --------------------------------------------------------------------------


def matrix(shift: complex, factor: complex, middle: complex) -> Array:
    """Multiplies places x + i y about the middle of a frame by a factor, and shifts them."""
    rest = shift + middle - factor * middle
    c, d = factor.real, factor.imag
    return np.array([[c, -d, rest.real], [d, c, rest.imag], [0, 0, 1]])


def warped(values: Array, motion: Array, outside: float, interpolation: int) -> Array:
    if values.dtype != np.uint8:  # OpenCV interpolates in another way in double precision
        values = values.astype(np.float32)
    flags, size = interpolation | cv2.WARP_INVERSE_MAP, values.shape[::-1]
    return cv2.warpAffine(
        values, motion[:2], size, flags=flags, borderMode=cv2.BORDER_CONSTANT, borderValue=outside
    )


def view_motion(before: Array, now: Array) -> Array:
    """The motion of the view from grey levels `now` to `before`, in their pixels."""
    still = np.eye(3)
    textured = cell_means(cv2.cornerMinEigenVal(now, 6), 6) > 6e-5
    if np.array_equal(before, now) or textured.mean() < 1 / 4:
        return still
    search = cv2.DISOpticalFlow.create(cv2.DISOPTICAL_FLOW_PRESET_FAST)
    flow = search.calc(now, before, np.zeros((*now.shape, 2), np.float32))
    f = cell_means(np.asarray(flow), 6)[textured].astype(float) @ (1, 1j)
    middle = complex(now.shape[1] - 1, now.shape[0] - 1) / 2
    z = (np.argwhere(textured) * 6 + 2.5) @ (1j, 1) - middle
    shift, change = complex(np.median(f.real), np.median(f.imag)), 0j
    for _ in range(5):
        errors = np.abs(shift + change * z - f)
        root = 1 / (1 + (errors / max(0.15, 1.4 * np.median(errors))) ** 2)
        equations = np.stack([root, root * z], axis=1)
        fitted = np.linalg.lstsq(equations, root * f, rcond=None)[0]
        shift, change = complex(fitted[0]), complex(fitted[1])
    factor = 1 + change
    if abs(shift) + abs(factor / abs(factor) - 1) * abs(middle) < 0.25:
        return still
    seen = warped(before, matrix(shift, factor, middle), 0, cv2.INTER_CUBIC)
    left, changed = (
        np.rint(cell_means(cv2.absdiff(now, each), 6)[textured]) for each in (seen, before)
    )
    w = min(1.0, max(0.0, (float(np.mean(left < 0.8 * changed)) - 0.35) / 0.3))
    return matrix(w * shift, (factor / abs(factor)) ** w, middle)


def enlarged(motion: Array, times: float) -> Array:
    """The same motion in pixels of frames that are so many times as large."""
    change = np.array([[times, 0, (times - 1) / 2], [0, times, (times - 1) / 2], [0, 0, 1]])
    return np.asarray(change @ motion @ np.linalg.inv(change))


def views(frames: list[Array]) -> Iterator[Array]:
    """The motion of the view from each frame to the first one."""
    view, before = np.eye(3), None
    times = max(1, round(min(frames[0].shape) / 120))
    rows, columns = (length // times for length in frames[0].shape)
    for luma in frames:
        # In single precision, as in the package: many means lie halfway between two grey levels.
        single = luma[: rows * times, : columns * times].astype(np.float32)
        small = cv2.resize(single, (columns, rows), interpolation=cv2.INTER_AREA)
        now = np.asarray(cv2.convertScaleAbs(small, alpha=255.0))
        if before is not None:
            view = view @ enlarged(view_motion(before, now), times)
        before = now
        yield view


# ---- 4. to 8. R in the frame, and in the frame at half its size ------------------------------


class Size:
    """P, S and R at one size of the frame."""

    def __init__(self, frames: list[Array], view: list[Array], times: int) -> None:
        self.times, self.stride = times, STRIDES[times]
        self.luma = [cell_means(each, times) for each in frames]
        self.view = [enlarged(each, 1 / times) for each in view]
        self.p = [self.photoreceptors(t) for t in range(len(frames))]
        kernel, w_i, mask = reference.kernel, reference.w_i, reference.mask
        self.w_e = kernel(reference.w_e)
        phis = [axis + turn for axis in AXES for turn in (0, 180)]
        both = zip(frames[0].shape, self.luma[0].shape, strict=True)
        self.down, self.across = (self.pooling(*sides) for sides in both)
        self.w_i = {phi: [kernel(w_i(n)) * kernel(mask(phi)) for n in (1, 2)] for phi in phis}

    def seen(self, maps: list[Array], then: int, now: int, outside: float, how: int) -> Array:
        if np.array_equal(self.view[then], self.view[now]):
            return maps[then]
        motion = np.linalg.inv(self.view[then]) @ self.view[now]
        return warped(maps[then], motion, outside, how)

    def photoreceptors(self, t: int) -> Array:
        then = max(0, t - self.stride)  # before the first comparison only whether P is 0 counts
        before = self.luma[then]
        seen = self.seen(self.luma, then, t, -1000, cv2.INTER_CUBIC)
        changes = [np.abs(self.luma[t] - each) for each in (before, seen)]
        return np.asarray(np.minimum(*changes))

    def lasts(self, t: int) -> bool:
        latest = range(t - 3 * self.stride + 1, t + 1)
        return latest[0] > 0 and all(self.p[each].any() for each in latest)

    def pathways(self, t: int) -> dict[int, Array]:
        p, p1, p2 = (
            self.seen(self.p, t - n * self.stride, t, 0, cv2.INTER_LINEAR) for n in range(3)
        )
        counts = self.counts(p)
        return {
            phi: counts * np.maximum(0, same(p, self.w_e) - same(p1, one) - same(p2, two))
            for phi, (one, two) in self.w_i.items()
        }

    def counts(self, p: Array) -> Array:
        """Where S counts: within the border, and where nothing enters."""
        counts = np.ones(p.shape, bool)
        border = BORDER // self.times
        for turns in range(4):
            lines, side = np.rot90(p, turns), np.rot90(counts, turns)
            side[:, :border] = False
            for line, counted in zip(lines, side, strict=True):
                least = max(0.02, 0.3 * line[:border].max())
                rests = np.flatnonzero(line[: ENTERING // self.times] < least)
                counted[: rests[0] if rests.size else ENTERING // self.times] = False
        return counts

    def pooling(self, frame: int, side: int) -> Array:
        """Weights of the pixels by cell; sigma is the side of a cell."""
        cell, far = CELL / self.times, 5 * CELL
        centres = np.array(reference.centres(frame, CELL)) / self.times
        distance = np.arange(-far, side + far) + 0.5 - centres[:, None]
        weights = np.exp(-((distance / cell) ** 2) / 2)
        return np.asarray(weights / weights.sum(axis=1, keepdims=True))[:, far:-far]

    def opponency(self, t: int) -> Array:
        """R, of the cells with a history and of all cells."""
        cells = {
            phi: np.sqrt(self.down @ s @ self.across.T / self.stride)
            for phi, s in self.pathways(t).items()
        }
        p = [
            cell_means(self.p[t - n * self.stride], CELL // self.times, centred=True)
            for n in range(3)
        ]
        now = largest_within(p[0], 1)
        earlier = np.minimum(largest_within(p[1], 6), largest_within(p[2], 6))
        counts = np.stack([earlier >= HISTORY * now, np.ones_like(now)])
        return outward({phi: each * counts for phi, each in cells.items()})


def same(image: Array, weights: Array) -> Array:
    flipped = weights[::-1, ::-1]
    return np.asarray(cv2.filter2D(image, -1, flipped, borderType=cv2.BORDER_CONSTANT))


def largest_within(cells: Array, reach: int) -> Array:
    side = 2 * reach + 1
    return np.asarray(cv2.dilate(cells, np.ones((side, side), np.uint8)))


def outward(cells: dict[int, Array]) -> Array:
    reach = FIELD // 2 // CELL
    rows, columns = cells[45].shape[1:]
    around = (0, 0), (reach, reach), (reach, reach)
    padded = {phi: np.pad(each, around) for phi, each in cells.items()}

    def at(phi: int, x: int, y: int) -> Array:
        return padded[phi][:, reach + y : reach + y + rows, reach + x : reach + x + columns]

    r = np.zeros_like(cells[45])
    for phi, (right, down) in AXES.items():
        difference = np.zeros_like(r)
        for y, x in np.argwhere(np.ones((2 * reach + 1, 2 * reach + 1))) - reach:
            along = (right * x + down * y) / np.sqrt(2)
            if abs(along) > np.cos(np.radians(CONE)) * np.hypot(x, y) - 1e-9:
                difference += np.sign(along) * at(phi, x, y) * at(phi + 180, -x, -y)
        r += np.maximum(0, difference)
    return r


# ---- 9. and 10. Passing objects, persistence and adaptation -----------------------------------


def sum_of_squares(values: Array) -> float:
    return float(np.vdot(values, values))


def without_passing(opponency: Array, half: Size, t: int) -> None:
    """Set R, in all cells with a history, to 0 about winning units where an object passes."""
    if opponency[0].max() <= LEVEL:
        return
    winner = np.unravel_index(opponency[0].argmax(), opponency[0].shape)
    centres = [np.array(reference.centres(2 * side, CELL)) for side in half.p[t].shape]
    middle = [each[index] for each, index in zip(centres, winner, strict=True)]
    parts = [
        slice(max(0, round((at - FIELD / 2) / 2)), min(side, round((at + FIELD / 2) / 2)))
        for at, side in zip(middle, half.p[t].shape, strict=True)
    ]
    before = half.seen(half.p, t - 1, t, 0, cv2.INTER_LINEAR)[tuple(parts)]
    least, most = DISPLACED
    now = np.pad(half.p[t], most)
    errors = [
        sum_of_squares(before - now[y : y + before.shape[0], x : x + before.shape[1]])
        for y in range(parts[0].start, parts[0].start + 2 * most + 1)
        for x in range(parts[1].start, parts[1].start + 2 * most + 1)
        if np.hypot(y - parts[0].start - most, x - parts[1].start - most) >= least
    ]
    if min(errors) < PASSING * sum_of_squares(before):
        near = [np.abs(each - at) <= FIELD / 2 for each, at in zip(centres, middle, strict=True)]
        opponency[0][np.ix_(*near)] = 0
        without_passing(opponency, half, t)


def responses(frames: Iterable[Array]) -> list[float]:
    """R of the winning unit in each frame, 0 before the first response."""
    light = steady_light(np.asarray(each, np.float64) for each in frames)
    frames = list(noise_filter(light))
    view = list(views(frames))
    sizes = [(1, Size(frames, view, 1)), (HALVED_WEIGHT, Size(frames, view, 2))]
    nothing = np.zeros_like(sizes[0][1].opponency(0))
    kept, background, found = nothing, list[float](), []
    for t, luma_change in enumerate(each.mean() for each in sizes[0][1].p):
        parts = [weight * size.opponency(t) for weight, size in sizes if size.lasts(t)]
        if parts:
            now = np.asarray(sum(parts))
            without_passing(now, sizes[1][1], t)
            kept = (1 - PERSISTENCE) * now + PERSISTENCE * kept
        else:
            kept = nothing
        r, of_all = (float(each.max()) for each in kept)
        if of_all and luma_change >= 1e-4:
            background.append(of_all)
        end = max(0, math.ceil(len(background) - 1 - GUARD))
        earlier = background[max(0, end - BACKGROUND) : end]
        found.append(r * min(1, LEVEL / np.median(earlier)) if earlier else r)
    return found
