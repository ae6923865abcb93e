"""The models once more: literal, slow, written from docs/model.md only.

Nothing is shared with the package. Loops and direct convolutions in float64.
"""

from __future__ import annotations

import itertools
from math import cos, exp, pi, radians, sin, sqrt
from typing import TYPE_CHECKING, Any

import numpy as np
from scipy.ndimage import convolve

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from numpy.typing import NDArray

    Array = NDArray[Any]

SIGMA_E, SIGMA_I, A, R = 1.5, 5.0, 1.5, 6
ALPHA_TAU, BETA, LAMBDA = -0.1, 0.5, 0.7


def kernel(value: Callable[[int, int], float], radius: int = R) -> Array:
    side = range(-radius, radius + 1)
    return np.array([[value(x, y) for x in side] for y in side])


def gaussian(x: int, y: int, sigma: float) -> float:
    return exp(-(x * x + y * y) / (2 * sigma**2)) / (sigma * sqrt(2 * pi))


def delay(x: int, y: int) -> int:
    tau = ALPHA_TAU + 1 / (BETA + exp(-(LAMBDA**2) * (x * x + y * y)))
    return 0 if tau < 1 else 1 if tau <= 1.8999 else 2


def w_e(x: int, y: int) -> float:
    if delay(x, y) != 0:
        return 0.0
    return max(0.0, gaussian(x, y, SIGMA_E) - A * gaussian(x, y, SIGMA_I))


def w_i(frames: int) -> Callable[[int, int], float]:
    return lambda x, y: A * gaussian(x, y, SIGMA_I) if delay(x, y) == frames else 0.0


def mask(phi: float) -> Callable[[int, int], float]:
    return lambda x, y: 1 / (1 + exp(sqrt(2) * (x * cos(radians(phi)) - y * sin(radians(phi)))))


def same(image: Array, weights: Array) -> Array:
    return np.asarray(convolve(image, weights, mode="constant"))  # 0 outside


def photoreceptors(luma: Sequence[Array]) -> list[Array]:
    """P(1), P(2), ... of L(0), L(1), ..."""
    frames = [np.asarray(frame, np.float64) for frame in luma]
    return [np.abs(now - before) for before, now in itertools.pairwise(frames)]


def excitation(p: Sequence[Array], radius: int = R) -> Array:
    return same(p[-1], kernel(w_e, radius))


def inhibition(p: Sequence[Array], radius: int = R) -> Array:
    return same(p[-2], kernel(w_i(1), radius)) + same(p[-3], kernel(w_i(2), radius))


def directional_inhibition(p: Sequence[Array], phi: float, radius: int = R) -> Array:
    m = kernel(mask(phi), radius)
    one, two = kernel(w_i(1), radius), kernel(w_i(2), radius)
    return same(p[-2], one * m) + same(p[-3], two * m)


def presynaptic(p: Sequence[Array], radius: int = R) -> Array:
    """S."""
    return np.asarray(np.maximum(0, excitation(p, radius) - inhibition(p, radius)))


def pathway(p: Sequence[Array], phi: float, radius: int = R) -> Array:
    """S_phi."""
    i_phi = directional_inhibition(p, phi, radius)
    return np.asarray(np.maximum(0, excitation(p, radius) - i_phi))


def grouped(s: Array, side: int, threshold: float, limit: float) -> Array:
    """G: MATLAB's conv2(S, ones(side), 'same') times S, with a threshold and a limit."""
    g = np.zeros_like(s)
    # The part of the full convolution that 'same' keeps starts at its row side / 2, rounded down.
    ahead = side // 2 + 1
    for y in range(s.shape[0]):
        for x in range(s.shape[1]):
            rows = slice(max(0, y + ahead - side), y + ahead)
            columns = slice(max(0, x + ahead - side), x + ahead)
            value = s[y, x] * s[rows, columns].sum()
            g[y, x] = 0 if value < threshold else min(value, limit)
    return g


def dlgmd(p: Sequence[Array]) -> tuple[Array, Array]:
    """S and G."""
    s = presynaptic(p)
    return s, grouped(s, 4, min(1.2 * p[-3].mean(), 0.3), 1)


def centres(length: int, cell: int) -> list[float]:
    count = max(1, length // cell)
    return [(length - count * cell) / 2 + (k + 0.5) * cell for k in range(count)]


def pooled(s: Array, cell: int, sigma_cells: float) -> Array:
    """Gaussian of unit sum on an endless plane, sampled at the cells' centres."""
    height, width = s.shape
    sigma = sigma_cells * cell
    far = int(8 * sigma)

    def weights(centre: float, length: int) -> Array:
        total = sum(exp(-(k * k) / (2 * sigma**2)) for k in range(-far, far + 1))
        return np.array(
            [exp(-((k + 0.5 - centre) ** 2) / (2 * sigma**2)) / total for k in range(length)]
        )

    down = [weights(centre, height) for centre in centres(height, cell)]
    across = [weights(centre, width) for centre in centres(width, cell)]
    return np.asarray(np.array(down) @ s @ np.array(across).T)


def opponent_products(one: Array, other: Array, phi: float, reach: int, *, w_p: float) -> Array:
    """out(c) - w_p in(c) of the pathways phi (one) and phi + 180 (other)."""
    rows, columns = one.shape
    sums = np.zeros((rows, columns))
    for y, x, uy, ux in itertools.product(
        range(rows), range(columns), range(-reach, reach + 1), range(-reach, reach + 1)
    ):
        if not all(0 <= y + s * uy < rows and 0 <= x + s * ux < columns for s in (1, -1)):
            continue
        along = ux * cos(radians(phi)) - uy * sin(radians(phi))
        if abs(along) < 1e-9:
            continue
        product = one[y + uy, x + ux] * other[y - uy, x - ux]
        sums[y, x] += product if along > 0 else -w_p * product
    return sums


def opponency(
    p: Sequence[Array], *, field: int, cell: int, sigma: float, axes: int, w_p: float
) -> Array:
    """R(c) of opplod_reference."""
    reach = int(field / 2 / cell)
    parts = []
    for phi in (axes, axes + 90):
        one, other = (pooled(pathway(p, phi + turn), cell, sigma) for turn in (0, 180))
        parts.append(np.maximum(0, opponent_products(one, other, phi, reach, w_p=w_p)))
    return np.asarray(sum(parts))


def paper_response(
    p: Sequence[Array], *, field: int, grid: tuple[int, int], threshold: float, gain: float
) -> float:
    """The paper to the letter: both orders, both axis pairs, all units, literally."""
    maps = {phi: pathway(p, phi) for phi in (45, 135, 225, 315)}
    height, width = next(iter(maps.values())).shape
    columns, rows = grid
    response = 0.0
    for row in range(rows):
        for column in range(columns):
            top = round(row * (height - field) / (rows - 1))
            left = round(column * (width - field) / (columns - 1))
            crop = {phi: s[top : top + field, left : left + field] for phi, s in maps.items()}
            for phi in (45, 135):
                for first, second in ((phi, phi + 180), (phi + 180, phi)):
                    product = crop[first] * np.rot90(crop[second], 2)
                    selected = np.where(product > threshold, product, 0)
                    response += gain * float((selected**2).sum())
    return response
