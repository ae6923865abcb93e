"""Time to contact from brightness gradients (Horn, Fang and Masaki 2007), a baseline."""

from __future__ import annotations

import itertools
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar

import cv2
import numpy as np

from oppload_cli.models.detector import AlarmRule, Box, Detector, Response, inner
from oppload_cli.models.dpc import check_frame
from oppload_cli.schema import Parameters, parameter

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from oppload_cli.models.dpc import Map

    Numbers = NDArray[np.float64]

_MADE_FOR = 150  # px, the height at which the blur is given
_REACH = 4  # radius of the blur's kernel, in sigmas
_RIDGE = 1e-6
_LEAST_CHANGE = 1e-12  # a window whose sum of Et^2 is at most this counts as unchanged


@dataclass(frozen=True, kw_only=True)
class TtcGradientParams(Parameters):
    """Parameters of time to contact."""

    sigma: float = parameter(
        2.0,
        "sigma of the blur at a working height of 150 px; in proportion at other heights",
        unit="px",
        above=0,
        high=100,
    )
    window: float = parameter(
        5 / 12, "side of the windows, as a share of the working height", low=0.02, high=1
    )


@dataclass(frozen=True)
class TtcGradientResponse(Response):
    """The response of time to contact, with its inner values."""

    a: float = inner(0.0, "px/frame", "horizontal motion at the centre of the frame")
    b: float = inner(0.0, "px/frame", "vertical motion at the centre of the frame")
    c: float = inner(0.0, "1/frame", "expansion of the complete frame; 1/c is the time to contact")
    r2: float = inner(0.0, "0 to 1", "share of the change that this motion explains")
    best_score: float = inner(0.0, "1/frame", "max(c, 0) r2 of the best window")
    best_x: int = inner(0, "px", "column of the centre of the best window")
    best_y: int = inner(0, "px", "row of the centre of the best window")
    best_c: float = inner(0.0, "1/frame", "expansion of the best window")
    best_r2: float = inner(
        0.0, "0 to 1", "share of the change in the best window that its motion explains"
    )


class TtcGradient(Detector):
    """Time to contact without optical flow.

    The image of an approaching surface moves by ``u = A + C x``, ``v = B + C y``. If a moving
    point keeps its brightness, ``A Ex + B Ey + C G = -Et`` with ``G = x Ex + y Ey``. This equation
    is solved by least squares in every window. C is the expansion per frame, and 1/C the time to
    contact in frames. The response is the largest ``max(C, 0) r2`` of all windows, where r2 is
    the share of Et^2 that the motion explains.

    Source: Horn, Fang and Masaki 2007; ``docs/detectors.md``.
    """

    name = "ttc_gradient"
    label = "TTC gradient"
    colour = "#666666"
    meaning = "time to contact from brightness gradients: largest expansion of a window"
    unit = "1/frame"
    response_column = "1/frame", "expansion of the best window, weighted with its r2"
    responses = TtcGradientResponse
    parameters = TtcGradientParams
    alarm: ClassVar = AlarmRule(0.1)
    evaluated = False
    year = 2007
    reference = "Horn, Fang and Masaki, IEEE Intelligent Vehicles"
    answers_to = "expansion of textured surfaces of any contrast"
    made_for = "any size and rate"
    cost_ms = 1.4
    least_size = 9, 9
    places = True

    params: TtcGradientParams

    def __init__(
        self, shape: tuple[int, int], params: TtcGradientParams | None = None, **others: Any
    ) -> None:
        super().__init__(shape, params, **others)
        height, width = shape
        side = min(shape)
        self._sigma = self.params.sigma * side / _MADE_FOR
        self._radius = max(1, round(_REACH * self._sigma))
        # Windows have at least 3 x 3 pixels: one pixel does not determine A, B and C.
        self._half = max(1, round(self.params.window * side) // 2)
        step = max(1, round(side / 30))
        ends = height - 1 - self._half, width - 1 - self._half
        centres = [np.arange(self._half, end, step) for end in ends]
        self._windows = [_Windows(along, self._half) for along in centres]
        self._middle = (height - 1) // 2, (width - 1) // 2
        self._y = np.arange(height - 1, dtype=np.float32)[:, None] - self._middle[0]
        self._x = np.arange(width - 1, dtype=np.float32) - self._middle[1]
        self.reset()

    def reset(self) -> None:
        """Forget all frames: the next frame is frame 0."""
        self._before: Map | None = None

    def step(self, luma: Map) -> TtcGradientResponse | None:
        """Take the next frame; None for the first one."""
        check_frame(luma, self.shape)
        side, sigma = 2 * self._radius + 1, self._sigma
        now = cv2.GaussianBlur(luma, (side, side), sigma, borderType=cv2.BORDER_REPLICATE)
        before, self._before = self._before, np.asarray(now, np.float32)
        if before is None:
            return None
        height, width = self.shape
        down, across = self._windows
        rows = down.sums(self._products(self._before, before), 0)
        sums = np.moveaxis(across.sums(rows, 2), 1, 0)
        pixels = (height - 1) * (width - 1)
        of_frame = _fitted(sums[:, -1, -1:], 0, 0, pixels, max(self.shape))
        a, b, c, r2 = (float(values[0]) for values in of_frame)
        if sums.shape[1] == 1 or sums.shape[2] == 1:  # no window lies within the frame
            return TtcGradientResponse(0.0, None, a, b, c, r2)
        half, side = self._half, 2 * self._half + 1
        grid = np.meshgrid(down.centres, across.centres, indexing="ij")
        ys, xs = (values.ravel() for values in grid)
        windows = sums[:, :-1, :-1].reshape(len(sums), -1)
        middle_y, middle_x = self._middle
        _, _, best_c, best_r2 = _fitted(windows, ys - middle_y, xs - middle_x, side**2, half)
        scores = np.maximum(best_c, 0) * best_r2
        best = int(np.argmax(scores))
        score, x, y = float(scores[best]), int(xs[best]), int(ys[best])
        # Derivative i lies on the border of pixels i and i + 1.
        box = Box(x - half + 0.5, y - half + 0.5, side, side) if score > 0 else None
        shares = float(best_c[best]), float(best_r2[best])
        return TtcGradientResponse(score, box, a, b, c, r2, score, x, y, *shares)

    def _products(self, now: Map, before: Map) -> Map:
        """Return the ten products of derivatives, shape (height - 1, 10, width - 1).

        Each derivative is taken over cubes of 2 x 2 pixels and 2 frames. The products with G use x
        and y from the middle of the frame.
        """
        total, change = now + before, now - before
        of_rows = total[1:] + total[:-1]
        ex = (of_rows[:, 1:] - of_rows[:, :-1]) / 4
        of_columns = total[:, 1:] + total[:, :-1]
        ey = (of_columns[1:] - of_columns[:-1]) / 4
        of_rows = change[1:] + change[:-1]
        et = (of_rows[:, 1:] + of_rows[:, :-1]) / 4
        g = self._x * ex + self._y * ey
        pairs = (
            *((ex, ex), (ey, ey), (ex, ey), (g, ex), (g, ey), (g, g)),
            *((ex, et), (ey, et), (g, et), (et, et)),
        )
        out = np.empty((len(et), len(pairs), et.shape[1]), np.float32)
        for number, (one, other) in enumerate(pairs):
            np.multiply(one, other, out=out[:, number])
        return out


class _Windows:
    """Sums over the windows along one axis, from ``centre - half`` to ``centre + half``."""

    def __init__(self, centres: NDArray[np.int_], half: int) -> None:
        self.centres = centres
        starts, ends = centres - half, centres + half + 1
        self._edges = np.unique([0, *starts, *ends])
        self._starts, self._ends = (
            np.searchsorted(self._edges, places) for places in (starts, ends)
        )

    def sums(self, values: NDArray[np.floating[Any]], axis: int) -> Numbers:
        """Return the sum over each window along the axis, then the sum over the complete axis."""
        moved = np.moveaxis(values, axis, 0)
        edges = [edge for edge in self._edges if edge < len(moved)]
        parts = itertools.pairwise([*edges, len(moved)])
        # This loop sums each part between two edges; NumPy's `reduceat` takes three times as long.
        sums = [moved[start:end].sum(0, dtype=values.dtype) for start, end in parts]
        to_edge = np.zeros((len(sums) + 1, *moved.shape[1:]))  # sums from 0 up to each edge
        for number, part in enumerate(sums):
            np.add(to_edge[number], part, out=to_edge[number + 1])
        of_windows = to_edge[self._ends] - to_edge[self._starts]
        return np.moveaxis(np.concatenate([of_windows, to_edge[-1:]]), 0, axis)


def _fitted(
    sums: Numbers, cy: Any, cx: Any, pixels: int, half: int
) -> tuple[Numbers, Numbers, Numbers, Numbers]:
    """Return A, B, C and r2 of some windows, from the sums of their ten products.

    In these sums, G uses x and y from the middle of the frame. `cy` and `cx` are the windows'
    centres, also from the middle of the frame. `pixels`, the number of pixels of a window, and
    `half`, half its side, scale the ridge term that keeps the equations solvable.
    """
    xx, yy, xy, gx, gy, gg, xt, yt, gt, tt = sums
    # Convert the sums with G to x and y from the centre of each window.
    gg = gg + cx**2 * xx + cy**2 * yy - 2 * (cx * gx + cy * gy - cx * cy * xy)
    gx, gy = gx - cx * xx - cy * xy, gy - cx * xy - cy * yy
    gt = gt - cx * xt - cy * yt
    rows = [[xx, xy, gx], [xy, yy, gy], [gx, gy, gg]]
    matrix = np.moveaxis(np.array(rows), 2, 0)
    right = -np.stack([xt, yt, gt], axis=1)
    ridge = _RIDGE * pixels * np.diag([1.0, 1.0, half**2])
    motion = np.linalg.solve(matrix + ridge, right[..., None])[..., 0]
    explained = 2 * np.sum(motion * right, 1) - np.einsum("wi,wij,wj->w", motion, matrix, motion)
    still = tt <= _LEAST_CHANGE
    r2 = np.where(still, 0, np.maximum(0, explained / np.where(still, 1, tt)))
    return motion[:, 0], motion[:, 1], motion[:, 2], r2
