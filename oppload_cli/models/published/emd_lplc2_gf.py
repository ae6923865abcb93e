"""EMD-LPLC2-GF: motion detectors, an array of LPLC2 units and a giant fibre (Zhao et al. 2023)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

import cv2
import numpy as np

from oppload_cli.models.detector import AlarmRule, Box, Response, inner
from oppload_cli.models.published.parts import ChangeDetector
from oppload_cli.schema import Parameters, parameter

if TYPE_CHECKING:
    from oppload_cli.models.published.parts import Plane

_LOW_PASS = 1 / 6  # weight of the input in each low-passed value
_HIGH_PASS = 25 / 26
_OFF_LEVEL = 0.05  # OFF signal of a pixel at rest

_AUTHORS_PIXELS = 200 * 150
_SATURATING_UNITS = 2500  # number of active units in the authors' array that gives an input of 1
_VELOCITY_SCALE = 57.6  # (2116 - 676) / 2500 / 0.01 s
_STEP_S = 0.01  # duration of the authors' frames

_REST_MV, _SPIKE_MV, _RESET_MV, _LOWEST_MV = -60.0, -50.0, -70.0, -80.0
_MEMBRANE_STEPS, _MEMBRANE_STEP_S, _MEMBRANE_TAU_S = 20, 0.0005, 0.3


@dataclass(frozen=True, kw_only=True)
class EmdLplc2GfParams(Parameters):
    """Parameters of EMD-LPLC2-GF."""

    height: int = parameter(
        150, "working height to which larger frames are reduced", unit="px", low=8, high=10000
    )
    receptive_field: int | None = parameter(
        None, "side of a field; auto: 2/3 of the reduced height", unit="px", low=4, high=10000
    )
    full_scale: float = parameter(1.0, "number that stands for white, such as 1 or 255", above=0)
    arm_threshold: float = parameter(
        2.0, "an arm counts only if the sum of its motion is above this threshold", low=0
    )
    current_gain: float = parameter(250.0, "factor of the giant fibre's input", low=0)


@dataclass(frozen=True)
class EmdLplc2GfResponse(Response):
    """The response of EMD-LPLC2-GF to one frame, with its inner values."""

    active: int = inner(0, "", "units above 0")
    lplc2_sum: float = inner(0.0, "", "sum of all units")
    lplc2_max: float = inner(0.0, "", "largest unit")
    max_x: int = inner(-1, "px", "column of the largest unit at the reduced size; -1: none")
    max_y: int = inner(-1, "px", "row of the largest unit at the reduced size; -1: none")
    lplc2_centre: float = inner(0.0, "", "the unit in the middle")
    motion_abs: float = inner(0.0, "", "sum of the absolute horizontal and vertical motion")
    current: float = inner(0.0, "", "input of the giant fibre")
    spikes: int = inner(0, "", "spikes of the giant fibre in this frame")
    v_end: float = inner(_REST_MV, "mV", "voltage of the giant fibre at the end of the frame")
    collision: int = inner(0, "", "1 once the fibre has spiked; it stays 1")


def _add_elementary_motion(signal: Plane, delayed: Plane, motion: Plane) -> None:
    """Add the motion to the right and downwards between neighbouring pixels.

    This is Reichardt's correlation: the delayed signal of a pixel times the signal of its
    neighbour, minus the same product for the opposite direction.
    """
    here, late = signal[:-1, :-1], delayed[:-1, :-1]
    for way, there in enumerate((np.s_[:-1, 1:], np.s_[1:, :-1])):
        motion[way] += late * signal[there]
        motion[way] -= here * delayed[there]


def _lplc2_units(right: Plane, down: Plane, field: int, threshold: float) -> Plane:
    """Return the response of the unit at every pixel: the product of its four arms.

    Each arm sums the motion away from the unit over a rectangle, half of the field long and two
    fifths of the field wide. Motion beyond the frame is 0. An arm whose sum is not above the
    threshold is 0.
    """
    half, width = field // 2, round(field * 2 / 5)
    units = _arms(right, half, width, threshold)
    if units.any():  # in most frames all units are already 0
        units *= _arms(np.ascontiguousarray(down.T), half, width, threshold).T
    return units


def _arms(motion: Plane, length: int, width: int, threshold: float) -> Plane:
    """Return the product of the two arms along the rows, which sum motion away from each pixel."""
    height, columns = motion.shape
    padded = cv2.copyMakeBorder(motion, width, width, length, length, cv2.BORDER_CONSTANT)
    table = cv2.integral(padded)
    first = width + 1 - width // 2  # rows from 1 - width // 2 to width // 2 around each
    bands = table[width + 1 + width // 2 :][:height] - table[first : first + height]
    middle = bands[:, length + 1 :][:, :columns]
    before = bands[:, 1:][:, :columns] - middle
    after = bands[:, 2 * length + 1 :][:, :columns] - middle
    before *= before > threshold
    after *= after > threshold
    before *= after
    before += 0  # makes -0, the product of a negative sum, to 0, so that tables do not show it
    return np.asarray(before, np.float64)


def _membrane(voltage: float, current: float) -> tuple[float, int]:
    """Return the giant fibre's voltage in mV after one frame, and its number of spikes.

    ``dv/dt = (-v - 60 + 10 I) / 0.3`` is solved by 20 Runge-Kutta steps of fourth order over
    0.01 s. A voltage above -50 mV is a spike, which sets it to -70 mV. It is at least -80 mV.
    """
    # The equation is linear: each step multiplies the distance to its fixed point by one factor.
    ratio = _MEMBRANE_STEP_S / _MEMBRANE_TAU_S
    factor = 1 - ratio + ratio**2 / 2 - ratio**3 / 6 + ratio**4 / 24
    goal = _REST_MV + 10 * current
    spikes = 0
    for _ in range(_MEMBRANE_STEPS):
        voltage = _LOWEST_MV if voltage <= _LOWEST_MV else goal + (voltage - goal) * factor
        if voltage > _SPIKE_MV:
            spikes += 1
            voltage = _RESET_MV
    return voltage, spikes


class EmdLplc2Gf(ChangeDetector):
    """Reichardt motion detectors, LPLC2 units with four arms, and a spiking giant fibre.

    All constants count frames; the authors chose them for 100 frames/s. Larger frames are reduced
    to the authors' working height of 150 px. The first spike is the authors' alarm.

    Source: Zhao J. et al. 2023 (iScience) and the authors' published code; ``docs/detectors.md``.
    """

    name = "emd_lplc2_gf"
    label = "EMD-LPLC2-GF"
    colour = "#63477F"
    meaning = "EMD array, LPLC2 units with four arms, spiking giant fibre (Zhao et al. 2023)"
    unit = "giant fibre input"
    response_column = "", "input of the giant fibre, at least 0"
    year = 2023
    reference = "Zhao J. et al. 2023, iScience"
    answers_to = (
        "motion outward on all four sides; not recession, translation, pans, noise, dimming"
    )
    made_for = "200 x 150 px, 100 frames/s"
    cost_ms = 0.7
    least_size = (8, 8)
    responses = EmdLplc2GfResponse
    parameters = EmdLplc2GfParams
    alarm: ClassVar = AlarmRule(1.0)
    places = True
    precision = np.float64

    params: EmdLplc2GfParams

    def _forget(self) -> None:
        # Of portrait frames the width is reduced to the authors' height, see docs/glossary.md.
        side = min(self.shape)
        reduced = min(side, self.params.height)
        self._rows, self._columns = (round(length * reduced / side) for length in self.shape)
        self._field = self.params.receptive_field or 2 * round(reduced / 3)
        self._filtered, self._on, self._off = np.zeros((3, self._rows, self._columns))
        self._voltage, self._input, self._active, self._collision = _REST_MV, 0.0, 0, 0

    def at_rest(self) -> EmdLplc2GfResponse:
        """Return the response, 0, to a frame in which nothing changed."""
        return EmdLplc2GfResponse(0.0, v_end=self._voltage, collision=self._collision)

    def _respond(self, p: Plane) -> EmdLplc2GfResponse:
        size = self._columns, self._rows
        if p.shape[::-1] != size:
            p = np.asarray(cv2.resize(p, size, interpolation=cv2.INTER_AREA), np.float64)
        right, down = self._motion(p * (self.params.full_scale / 255))
        units = _lplc2_units(right, down, self._field, self.params.arm_threshold)
        return self._fibre(units, cv2.norm(right, cv2.NORM_L1) + cv2.norm(down, cv2.NORM_L1))

    def _motion(self, change: Plane) -> Plane:
        """Return the motion to the right and downwards, the sum of the ON and the OFF signal's."""
        self._filtered = (self._filtered + change) * _HIGH_PASS
        motions = np.zeros((2, self._rows - 1, self._columns - 1))
        for low_passed, level, sign in ((self._on, 0, 1), (self._off, _OFF_LEVEL, -1)):
            now = np.maximum(level + sign * self._filtered, 0)
            cv2.addWeighted(now, _LOW_PASS, low_passed, 1 - _LOW_PASS, 0, dst=low_passed)
            _add_elementary_motion(now, low_passed, motions)
        return motions

    def _fibre(self, units: Plane, motion: float) -> EmdLplc2GfResponse:
        height, width = units.shape
        active = int(np.count_nonzero(units > 0))
        drive = active / _SATURATING_UNITS * _AUTHORS_PIXELS / (self._rows * self._columns)
        velocity = (drive - self._input) / _STEP_S / _VELOCITY_SCALE
        current = self.params.current_gain * drive * velocity if self._active else 0.0
        self._input, self._active = drive, active
        self._voltage, spikes = _membrane(self._voltage, current)
        self._collision |= int(spikes > 0)
        largest = float(units.max())
        y, x = divmod(int(units.argmax()), width) if largest > 0 else (-1, -1)
        centre = units[max(0, height // 2 - 1), max(0, width // 2 - 1)]
        box = self._box(y, x) if largest > 0 else None
        units_of_frame = active, float(units.sum()), largest, x, y, float(centre)
        fibre = current, spikes, self._voltage, self._collision
        return EmdLplc2GfResponse(max(0.0, current), box, *units_of_frame, motion, *fibre)

    def _box(self, y: int, x: int) -> Box:
        scale_y, scale_x = self.shape[0] / self._rows, self.shape[1] / self._columns
        half = self._field / 2
        left, top = (x + 1 - half) * scale_x, (y + 1 - half) * scale_y
        return Box(left, top, self._field * scale_x, self._field * scale_y)
