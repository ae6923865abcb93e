"""A trained linear receptive field per LPLC2 unit (after Zhou et al. 2022)."""

from __future__ import annotations

from dataclasses import dataclass
from importlib.resources import files
from typing import TYPE_CHECKING, ClassVar

import cv2
import numpy as np

from oppload_cli.errors import OpploadError, ParameterError
from oppload_cli.models.detector import AlarmRule, Detector, Response, inner
from oppload_cli.models.dpc import grey_levels
from oppload_cli.models.published.parts import EDGE, sigmoid
from oppload_cli.schema import Parameters, parameter

if TYPE_CHECKING:
    from typing import Any

    from oppload_cli.models.dpc import Map
    from oppload_cli.models.published.parts import Plane

_FIELD = 12  # side of a unit's receptive field in elements: 60 degrees
_WEIGHTS_FILE = "zhou_lrf.csv"
_UNIT_BIAS, HIT_BIAS = -0.966204, -1.944388  # b_e and b of the same training
_DELAY_KEPT = np.exp(-1 / 3)  # weight of the former value in the delayed signal
_AT_REST = sigmoid(HIT_BIAS)  # probability of a hit if nothing moves
_BLOCK_STEP = _FIELD // 2  # distance in elements of the units that give the probability of a hit


@dataclass(frozen=True, kw_only=True)
class ZhouLrfParams(Parameters):
    """Parameters of the trained receptive field."""

    element: int | None = parameter(
        None,
        "side of an element (5 degrees), even; auto: 1/30 of the working height, rounded down to "
        "even",
        unit="px",
        low=2,
        high=1000,
    )

    def __post_init__(self) -> None:
        super().__post_init__()
        if (self.element or 0) % 2:
            raise ParameterError(
                f"parameter 'element' of zhou_lrf must be even, not {self.element}"
            )


@dataclass(frozen=True)
class ZhouLrfResponse(Response):
    """The response of the trained receptive field to one frame, with its inner values."""

    r_max: float = inner(0.0, "", "largest response of a unit")
    x: int = inner(0, "px", "column of the centre of the winning unit's field, working size")
    y: int = inner(0, "px", "row of the centre of the winning unit's field, working size")
    r_sum: float = inner(0.0, "", "sum of the responses of all units")
    p_hit: float = inner(_AT_REST, "", "probability of a hit, 0 to 1")
    motion_abs: float = inner(0.0, "", "sum of the absolute horizontal and vertical motion")


def _weights() -> Plane:
    """Return the weights for motion to the right, shape (12, 12), top row first."""
    path = files(__package__) / _WEIGHTS_FILE
    try:
        lines = path.read_text("ascii").splitlines()
        return np.loadtxt(lines, delimiter=",").reshape(_FIELD, _FIELD)
    except (OSError, ValueError) as error:
        raise OpploadError(
            f"{path}: the weights of zhou_lrf cannot be read ({error}); reinstall oppload"
        ) from error


def _blur_kernel(element: int) -> Plane:
    """Return a Gaussian centred on a pixel corner: sigma half an element, radius two elements."""
    offsets = np.arange(-2 * element, 2 * element) + 0.5
    square = offsets[:, None] ** 2 + offsets**2
    kernel = np.exp(-square / (2 * (element / 2) ** 2))
    kernel[square > (2 * element) ** 2] = 0
    return np.asarray(kernel / kernel.sum(), np.float64)


class _Blur:
    """A Gaussian blur, computed only where it is needed: at the corners of half elements."""

    def __init__(self, element: int) -> None:
        self._step, self._reach = element // 2, 2 * element
        # The kernel is cut into bands of rows, each half an element high. Rows that have the same
        # number in their bands form one matrix, shape (columns, bands).
        bands = _blur_kernel(element).reshape(-1, self._step, 2 * self._reach)
        self._matrices = bands.transpose(1, 2, 0)

    def __call__(self, image: Plane, rows: int, columns: int) -> Plane:
        """Return the blurred image, shape (2 rows + 1, 2 columns + 1).

        `rows` and `columns` count elements. Outside the image the nearest pixel is repeated.
        """
        padded = cv2.copyMakeBorder(image, *(self._reach,) * 4, borderType=EDGE)
        wide = np.lib.stride_tricks.sliding_window_view(padded, 2 * self._reach, axis=1)
        wide = wide[:, : 2 * columns * self._step + 1 : self._step]
        count = self._matrices.shape[2]
        end = (2 * rows + count) * self._step
        sums = np.zeros((2 * rows + count, 2 * columns + 1, count))
        for row, matrix in enumerate(self._matrices):
            sums += np.ascontiguousarray(wide[row : end : self._step]) @ matrix
        # Row r of the result is the sum over n of the kernel's band n with the image's band r + n.
        out = np.zeros((2 * rows + 1, 2 * columns + 1))
        for number in range(count):
            out += sums[number : number + len(out), :, number]
        return out


class ZhouLrf(Detector):
    """Units over 12 x 12 motion detectors, with weights trained to tell hits from misses.

    The constants count frames, and assume 30 frames per second as in the training. The weights were
    trained again as the paper describes, because the authors did not publish their weights.

    Source: Zhou et al. 2022 (eLife); ``docs/detectors.md``.
    """

    name = "zhou_lrf"
    label = "Zhou LRF"
    colour = "#036A28"
    meaning = "LPLC2 units with a trained linear receptive field (after Zhou et al. 2022)"
    response_column = "", "largest response of a unit"
    year = 2022
    reference = "after Zhou et al. 2022, eLife; weights retrained"
    answers_to = (
        "motion outward from a unit's middle, more at high contrast; not misses, retreats, rotation"
    )
    made_for = "60 degrees over 12 elements, 30 frames/s"
    cost_ms = 0.9
    responses = ZhouLrfResponse
    parameters = ZhouLrfParams
    evaluated = False
    alarm: ClassVar = AlarmRule(3.0)

    params: ZhouLrfParams

    def __init__(
        self, shape: tuple[int, int], params: ZhouLrfParams | None = None, **others: Any
    ) -> None:
        super().__init__(shape, params, **others)
        self._element = self.params.element or max(2, 2 * (min(shape) // 60))
        self._grid = shape[0] // self._element, shape[1] // self._element
        self.need_size(shape, (_FIELD * self._element,) * 2)
        self._blur = _Blur(self._element)
        right = _weights()
        # Weights for the four directions: those for motion to the right, turned by 90 degrees.
        self._weights = [np.rot90(right, turn) for turn in (0, 2, 1, 3)]
        self.reset()

    def reset(self) -> None:
        """Forget all frames: the next frame is frame 0."""
        self._delayed: list[Plane] | None = None

    def step(self, luma: Map) -> Response | None:
        """Take the next frame; None for the first one."""
        samples = self._samples(1 - grey_levels(luma, self.shape) / 255)
        before = self._delayed
        if before is None:
            self._delayed = samples  # as if the first frame had been shown for a long time
            return None
        self._delayed = [
            _DELAY_KEPT * old + (1 - _DELAY_KEPT) * new
            for old, new in zip(before, samples, strict=True)
        ]
        return self._respond(samples, self._delayed)

    def _samples(self, brightness: Plane) -> list[Plane]:
        """Return the blurred brightness at each element's left, right, lower and upper edge."""
        corners = self._blur(brightness, *self._grid)
        across, along = corners[1::2, ::2], corners[::2, 1::2]
        return [across[:, :-1], across[:, 1:], along[1:], along[:-1]]

    def _respond(self, samples: list[Plane], delayed: list[Plane]) -> Response:
        left, right, lower, upper = samples
        late_left, late_right, late_lower, late_upper = delayed
        across = right * late_left - late_right * left
        up = upper * late_lower - late_upper * lower
        channels = [np.maximum(speed, 0) for speed in (across, -across, up, -up)]
        rows, columns = (size - _FIELD + 1 for size in self._grid)
        drive = sum(
            cv2.filter2D(channel, -1, weights, anchor=(0, 0))[:rows, :columns]
            for channel, weights in zip(channels, self._weights, strict=True)
        )
        units = np.maximum(0, _UNIT_BIAS + drive)
        row, column = divmod(int(units.argmax()), columns)
        largest = float(units[row, column])
        hit = HIT_BIAS + float(units[::_BLOCK_STEP, ::_BLOCK_STEP].sum())
        return ZhouLrfResponse(
            largest,
            r_max=largest,
            x=(column + _BLOCK_STEP) * self._element,
            y=(row + _BLOCK_STEP) * self._element,
            r_sum=float(units.sum()),
            p_hit=sigmoid(hit),
            motion_abs=float(np.abs(across).sum() + np.abs(up).sum()),
        )
