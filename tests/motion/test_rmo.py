"""ROM pairs and RMO: the closed form against the paper's construction, and known fields."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from oppload_cli.errors import ParameterError
from oppload_cli.motion.rmo import (
    RmoMetrics,
    RmoParams,
    opposite_pairs,
    rmo,
    rmo_metrics,
    rom_pairs,
)

Points = np.ndarray[tuple[int, ...], np.dtype[np.float64]]

WIDTH, HEIGHT, SPACING = 427, 240, 16
seeds = st.integers(0, 2**32 - 1)


def grid() -> Points:
    x, y = np.meshgrid(np.arange(8.0, WIDTH, SPACING), np.arange(8.0, HEIGHT, SPACING))
    return np.stack([x, y], axis=-1).reshape(-1, 2)


def quarter_turn(points: Points) -> Points:
    return np.stack([-points[:, 1], points[:, 0]], axis=-1)


def polar(length: Points, angle: Points) -> Points:
    return np.stack([length * np.cos(angle), length * np.sin(angle)], axis=-1)


# The construction of the paper's section "Problem Formulation", step by step.


def random_opposite(count: int) -> tuple[Points, Points, Points, Points]:
    """Return starts and vectors of pairs that depart by up to 30 degrees from antiparallel."""
    random = np.random.default_rng(7)
    angle = random.uniform(0.0, 2 * np.pi, count)
    # Exactly antiparallel lines never meet: step (1) is not defined for them.
    departure = np.radians(random.uniform(0.05, 30.0, count)) * random.choice([-1.0, 1.0], count)
    start1, start2 = random.uniform(-200.0, 200.0, (2, count, 2))
    v1 = polar(random.uniform(0.1, 20.0, count), angle)
    v2 = polar(random.uniform(0.1, 20.0, count), angle + np.pi + departure)
    return start1, v1, start2, v2


def projected(
    start1: Points, v1: Points, start2: Points, v2: Points
) -> tuple[Points, Points, Points, Points]:
    """Return P11, P12, P21, P22 on the axis along l_e whose origin is the midpoint's projection."""
    cross = v1[:, 0] * v2[:, 1] - v1[:, 1] * v2[:, 0]
    apart = start2 - start1
    reach = (apart[:, 0] * v2[:, 1] - apart[:, 1] * v2[:, 0]) / cross
    intersection = start1 + reach[:, np.newaxis] * v1  # (1)
    angle1 = np.arctan2(v1[:, 1], v1[:, 0])
    angle2 = np.arctan2(-v2[:, 1], -v2[:, 0])
    between = (angle2 - angle1 + np.pi) % (2 * np.pi) - np.pi
    line = polar(np.ones(len(v1)), angle1 + between / 2)  # (2)

    def along(point: Points) -> Points:
        products = (point - intersection) * line
        return products[:, 0] + products[:, 1]

    centre = along((start1 + start2) / 2)  # (4)
    ends = (start1, start1 + v1, start2, start2 + v2)  # (3)
    p11, p12, p21, p22 = (along(point) - centre for point in ends)
    return p11, p12, p21, p22


def test_closed_form_agrees_with_the_paper_on_20000_pairs() -> None:
    start1, v1, start2, v2 = random_opposite(20_000)
    p11, p12, p21, p22 = projected(start1, v1, start2, v2)
    np.testing.assert_allclose(p11, -p21, atol=1e-6)
    assert np.all((p12 - p11) * (p22 - p21) < 0)  # strictly opposite, as step (3) says
    # The integrand is 1 where x lies in the first segment and -x in the second.
    low = np.maximum(np.minimum(p11, p12), np.minimum(-p21, -p22))
    high = np.minimum(np.maximum(p11, p12), np.maximum(-p21, -p22))
    one_side = np.maximum(high - low, 0.0) / (np.abs(p12 - p11) + np.abs(p22 - p21))
    np.testing.assert_allclose(rmo(v1, v2, sides=1), one_side, atol=1e-6)
    np.testing.assert_allclose(rmo(v1, v2), 2 * one_side, atol=1e-6)
    assert one_side.max() <= 0.5 + 1e-9


def test_interval_length_is_the_integral_of_the_paper() -> None:
    def piecewise(x: Points, start: float, end: float) -> Points:
        inside = (min(start, end) <= x) & (x <= max(start, end))
        return np.where(inside, x, 1.0)

    start1, v1, start2, v2 = random_opposite(40)
    segments = np.stack(projected(start1, v1, start2, v2), axis=-1)
    for (p11, p12, p21, p22), value in zip(segments, rmo(v1, v2, sides=1), strict=True):
        reach = np.abs([p11, p12, p21, p22]).max() + 1.0
        x = np.linspace(-reach, reach, 400_001)
        indicator = piecewise(x, p11, p12) + piecewise(-x, p21, p22) == 0
        length = np.count_nonzero(indicator) * (x[1] - x[0])
        assert length / (abs(p12 - p11) + abs(p22 - p21)) == pytest.approx(value, abs=1e-2)


def test_rmo_of_known_pairs() -> None:
    assert rmo([3.0, 4.0], [-3.0, -4.0]) == pytest.approx(1.0)
    assert rmo([3.0, 0.0], [-1.0, 0.0]) == pytest.approx(0.5)
    assert rmo([3.0, 0.0], [-1.0, 0.0], sides=1) == pytest.approx(0.25)
    both_zero_then_one = rmo([[0.0, 0.0], [2.0, 0.0]], [[0.0, 0.0], [0.0, 0.0]])
    assert both_zero_then_one.tolist() == [0.0, 0.0]


# Which pairs: every pair tested by its angles, one by one.


def test_pairs_are_those_that_the_angles_say() -> None:
    random = np.random.default_rng(3)
    starts, vectors = random.normal(size=(2, 60, 2))
    expected_opposite, expected_rom = [], []
    for first in range(60):
        for second in range(first + 1, 60):
            v1, v2 = vectors[first], vectors[second]
            shared = v1 / np.hypot(*v1) - v2 / np.hypot(*v2)
            if angle_between(v1, -v2) < 30:
                expected_opposite.append((first, second))
                if angle_between(starts[first] - starts[second], shared) < 45:
                    expected_rom.append((first, second))
    assert list(zip(*opposite_pairs(vectors), strict=True)) == expected_opposite
    assert list(zip(*rom_pairs(starts, vectors), strict=True)) == expected_rom
    assert len(expected_rom) > 20


def angle_between(one: Points, other: Points) -> float:
    cosine = one @ other / np.hypot(*one) / np.hypot(*other)
    return float(np.degrees(np.arccos(np.clip(cosine, -1, 1))))


@pytest.mark.parametrize(("departure", "count"), [(0, 1), (29.99, 1), (-29.99, 1), (30.01, 0)])
@pytest.mark.parametrize("heading", [0, 75, 180, -179, 271])
def test_opposite_wraps_around(heading: float, departure: float, count: int) -> None:
    angles = np.radians([heading, heading + 180 + departure])
    first, second = opposite_pairs(polar(np.ones(2), angles))
    assert len(first) == len(second) == count


def test_vectors_at_the_tolerance_itself_are_not_opposite() -> None:
    vectors = np.array([[1.0, 0.0], [0.0, 1.0], [0.0, -1.0]])
    assert np.array(opposite_pairs(vectors, 90)).tolist() == [[1], [2]]
    assert rmo_metrics(vectors, vectors, RmoParams(opposite_tolerance=90)).rom_pairs == 1


@pytest.mark.parametrize(("turn", "outward"), [(44.99, 1), (-44.99, 1), (45.01, 0), (135.01, 0)])
def test_outward_tolerance(turn: float, outward: int) -> None:
    starts = np.vstack([polar(np.array([5.0]), np.radians([turn])), [[0.0, 0.0]]])
    metrics = rmo_metrics(starts, [[1.0, 0.0], [-1.0, 0.0]])
    assert metrics.rom_pairs == outward
    assert metrics.rmo_index == (1.0 if outward else -1.0 if turn > 135 else 0.0)


def test_many_pairs_are_measured_as_few_are() -> None:
    # More pairs than one block holds.
    random = np.random.default_rng(11)
    starts, vectors = random.normal(size=(2, 700, 2))
    first, second = rom_pairs(starts, vectors)
    values = rmo(vectors[first], vectors[second])
    metrics = rmo_metrics(starts, vectors)
    assert metrics.rom_pairs == len(first) > 8_000
    assert metrics.rom_share == pytest.approx(len(first) / (700 * 699 / 2))
    assert metrics.rmo_mean == pytest.approx(values.mean(), rel=1e-12)
    assert metrics.rmo_max == values.max()


# Changes of the vectors that leave every number as it is.


def sample(seed: int) -> tuple[Points, Points]:
    random = np.random.default_rng(seed)
    starts, vectors = random.normal(size=(2, 25, 2))
    return starts * 50, vectors


def same(one: RmoMetrics, other: RmoMetrics) -> bool:
    return bool(tuple(one) == pytest.approx(tuple(other), rel=1e-6, abs=1e-9))


@pytest.mark.once
@settings(max_examples=60)
@given(seed=seeds, order=seeds)
def test_symmetric_in_the_vectors(seed: int, order: int) -> None:
    starts, vectors = sample(seed)
    shuffled = np.random.default_rng(order).permutation(len(starts))
    assert same(rmo_metrics(starts[shuffled], vectors[shuffled]), rmo_metrics(starts, vectors))
    np.testing.assert_array_equal(rmo(vectors, starts), rmo(starts, vectors))


@pytest.mark.once
@settings(max_examples=60)
@given(seed=seeds, speed=st.floats(1e-3, 1e3), size=st.floats(1e-3, 1e3))
def test_scale_invariant(seed: int, speed: float, size: float) -> None:
    starts, vectors = sample(seed)
    assert same(rmo_metrics(starts * size, vectors * speed), rmo_metrics(starts, vectors))


@pytest.mark.once
@settings(max_examples=60)
@given(seed=seeds, angle=st.floats(-360, 360), mirrored=st.booleans())
def test_rotation_invariant(seed: int, angle: float, mirrored: bool) -> None:
    starts, vectors = sample(seed)
    cosine, sine = np.cos(np.radians(angle)), np.sin(np.radians(angle))
    turn = np.array([[cosine, -sine], [sine, cosine]])
    if mirrored:
        turn[0] *= -1
    assert same(rmo_metrics(starts @ turn.T, vectors @ turn.T), rmo_metrics(starts, vectors))


@pytest.mark.once
@settings(max_examples=60)
@given(seed=seeds, x=st.floats(-1e4, 1e4), y=st.floats(-1e4, 1e4))
def test_translation_invariant(seed: int, x: float, y: float) -> None:
    starts, vectors = sample(seed)
    assert same(rmo_metrics(starts + np.array([x, y]), vectors), rmo_metrics(starts, vectors))


# The index of known fields.

inside_x, inside_y = st.floats(0, WIDTH - 1), st.floats(0, HEIGHT - 1)


def from_nearest_corner(x: float, y: float) -> float:
    return max(min(x, WIDTH - 1 - x), min(y, HEIGHT - 1 - y))


@pytest.mark.once
@settings(max_examples=100)
@given(x=inside_x, y=inside_y, rate=st.floats(0.001, 0.5))
def test_expansion_and_contraction(x: float, y: float, rate: float) -> None:
    outward = rate * (grid() - [x, y])
    expansion, contraction = rmo_metrics(grid(), outward), rmo_metrics(grid(), -outward)
    assert contraction.rmo_index == -expansion.rmo_index
    if from_nearest_corner(x, y) >= 1.5 * SPACING:
        assert expansion.rmo_index == 1.0
    else:
        # From a corner all vectors go into one quadrant: there may be no opposite pair.
        assert expansion.rmo_index in (0.0, 1.0)


def test_no_opposite_pair_when_the_focus_is_in_a_corner() -> None:
    assert len(opposite_pairs(grid() - [2.0, 2.0])[0]) == 0
    assert rmo_metrics(grid(), grid() - [2.0, 2.0]).rmo_index == 0.0


@pytest.mark.parametrize("velocity", [(1.0, 0.0), (-0.3, 2.0), (-5.0, -5.0)])
def test_translation_is_exactly_zero(velocity: tuple[float, float]) -> None:
    metrics = rmo_metrics(grid(), np.tile(velocity, (len(grid()), 1)))
    assert metrics == RmoMetrics(flow_vectors=len(grid()))


@pytest.mark.once
@settings(max_examples=60)
@given(x=inside_x, y=inside_y, rate=st.floats(0.001, 0.5), sense=st.sampled_from([-1, 1]))
def test_rotation_has_no_rom_pair(x: float, y: float, rate: float, sense: int) -> None:
    metrics = rmo_metrics(grid(), sense * rate * quarter_turn(grid() - [x, y]))
    assert (metrics.rom_pairs, metrics.rmo_index) == (0, 0.0)


def test_the_literal_outward_test_finds_rom_pairs_in_a_rotation() -> None:
    spinning = 0.02 * quarter_turn(grid() - [200.3, 110.7])
    literal = rmo_metrics(grid(), spinning, RmoParams(outward_tolerance=90.0))
    assert literal.rom_share > 0.05


@pytest.mark.once
def test_random_vectors_are_near_zero() -> None:
    random = np.random.default_rng(0)
    starts = grid()
    indices = []
    for _ in range(200):
        angles = random.uniform(0, 2 * np.pi, len(starts))
        vectors = polar(random.uniform(0.2, 4.0, len(starts)), angles)
        indices.append(rmo_metrics(starts, vectors).rmo_index)
    assert np.abs(indices).max() < 0.15
    assert np.std(indices) < 0.05


def test_literal_sides_halve_the_opponency_only() -> None:
    starts, vectors = sample(5)
    both, one = rmo_metrics(starts, vectors), rmo_metrics(starts, vectors, RmoParams(sides=1))
    assert both.rmo_mean > 0
    assert one.rmo_mean == pytest.approx(both.rmo_mean / 2)
    assert one.rmo_index == pytest.approx(both.rmo_index)


# Degenerate input.


@pytest.mark.parametrize(
    ("starts", "vectors", "expected"),
    [
        (np.empty((0, 2)), np.empty((0, 2)), RmoMetrics()),
        ([[1, 2]], [[3, 4]], RmoMetrics(1)),
        ([[0, 0], [9, 0]], [[0, 0], [1, 0]], RmoMetrics(1)),
        ([[0, 0], [9, 0]], [[0, 0], [0, 0]], RmoMetrics()),
        ([[0, 0], [9, 0]], [[-1, 0], [1, 0]], RmoMetrics(2, 1, 1.0, 1.0, 1.0, 1.0)),
        ([[0, 0], [9, 0]], [[1, 0], [-3, 0]], RmoMetrics(2, 0, 0.0, 0.0, 0.0, -1.0)),
        ([[0, 0], [9, 0]], [[-1, -0.0], [1, -0.0]], RmoMetrics(2, 1, 1.0, 1.0, 1.0, 1.0)),
        ([[5, 5], [5, 5]], [[-1, 0], [1, 0]], RmoMetrics(2)),
        ([[0, 0], [0, 9]], [[-1, 0], [1, 0]], RmoMetrics(2)),
        ([[0, 0], [9, 0]], [[-1e-300, 0], [1e-300, 0]], RmoMetrics(2, 1, 1.0, 1.0, 1.0, 1.0)),
    ],
    ids=[
        "none",
        "one",
        "one zero",
        "all zero",
        "antiparallel",
        "head on",
        "negative zero",
        "same start",
        "sideways",
        "tiny",
    ],
)
def test_degenerate(starts: Points, vectors: Points, expected: RmoMetrics) -> None:
    assert rmo_metrics(starts, vectors) == expected
    assert len(rom_pairs(starts, vectors)[0]) == expected.rom_pairs


def test_zero_tolerances_leave_no_pair() -> None:
    starts, vectors = [[0, 0], [9, 0]], [[-1, 0], [1, 0]]
    assert rmo_metrics(starts, vectors, RmoParams(opposite_tolerance=0.0)) == RmoMetrics(2)
    assert rmo_metrics(starts, vectors, RmoParams(outward_tolerance=0.0)) == RmoMetrics(2)


@pytest.mark.parametrize(
    ("starts", "vectors", "message"),
    [
        (np.zeros((3, 2)), np.zeros((2, 2)), "one shape"),
        (np.zeros(2), np.zeros(2), "one shape"),
        (np.zeros((2, 3)), np.zeros((2, 3)), "last axis"),
        (np.zeros((2, 2)), [[np.nan, 1], [1, 1]], "vectors holds numbers that are not finite"),
        ([[np.inf, 1], [1, 1]], np.zeros((2, 2)), "starts holds numbers that are not finite"),
        (np.zeros((2, 2)), [["left", 1], [1, 1]], "vectors holds something other than pairs of"),
        (np.zeros((2, 2)), [[1, 1], [1]], "vectors holds something other than pairs of"),
    ],
)
def test_arrays_of_the_wrong_kind(starts: Points, vectors: Points, message: str) -> None:
    with pytest.raises(ParameterError, match=message):
        rmo_metrics(starts, vectors)


def test_as_many_vectors_of_both() -> None:
    assert rmo((1, 0), [(-1, 0), (-3, 0)]).tolist() == [1, 0.5]
    with pytest.raises(ParameterError, match=r"hold \(3,\) and \(2,\) vectors; give as many of"):
        rmo(np.ones((3, 2)), np.ones((2, 2)))


@pytest.mark.parametrize(
    "values", [{"sides": 3}, {"opposite_tolerance": 91.0}, {"grid": 3}, {"reduction": 3}]
)
def test_parameters_check_themselves(values: dict[str, int]) -> None:
    with pytest.raises(ParameterError, match=next(iter(values))):
        RmoParams().replaced(**values)
