"""Bootstrap over clips: how far a measurement depends on the choice of clips."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from numpy.typing import NDArray

    from oppload_cli.evaluation.metrics.clips import Numbers

    Weights = NDArray[np.int64]


SEED = 20231
DRAWS = 1000
LEVEL = 95
RULE_OF_THREE = 3.0  # upper bound (95 %) of the expected events where none was seen


class Measurement(NamedTuple):
    """One row of ``evaluation.csv``.

    Attributes
    ----------
    detector, measure, condition : str
        The detector, the measure and the condition under which it was taken.
    value, low, high : float
        The value with the bounds of its interval; NaN where it is not determined.
    n : int
        Number of clips, windows, pairs or frames behind it.
    """

    detector: str
    measure: str
    condition: str
    value: float
    low: float
    high: float
    n: int


class Estimate(NamedTuple):
    """A value with its interval; NaN where it is not determined."""

    value: float
    low: float
    high: float


def draws_of(
    looming: Sequence[bool],
    count: int = DRAWS,
    seed: int = SEED,
    *,
    videos: Sequence[int] | NDArray[np.int64] | None = None,
) -> Weights:
    """Draw videos with replacement; the numbers with and without an approach stay the same.

    Parameters
    ----------
    looming : sequence of bool
        Of each clip, whether an object approaches.
    count : int
        Number of draws.
    seed : int
        Of the random numbers.
    videos : sequence of int, optional
        The number of each clip's video; each clip has one of its own if left out. Clips of one
        video are drawn together.

    Returns
    -------
    ndarray of int, shape (count, clips)
        How often each clip is in each draw.
    """
    random = np.random.default_rng(seed)
    numbers = np.arange(len(looming)) if videos is None else np.asarray(videos)
    weights = np.zeros((count, len(looming)), np.int64)
    for kind in (True, False):
        members = np.flatnonzero(np.array(looming, bool) == kind)
        drawn, which = np.unique(numbers[members], return_inverse=True)
        if len(drawn):
            shares = np.full(len(drawn), 1 / len(drawn))
            weights[:, members] = random.multinomial(len(drawn), shares, count)[:, which]
    return weights


def estimate(statistic: Callable[[Weights], float], draws: Weights) -> Estimate:
    """Return a statistic of all clips with its percentile interval over the draws.

    Parameters
    ----------
    statistic : callable
        Takes how often each clip counts, and returns a number, or NaN.
    draws : ndarray of int, shape (count, clips)
        From :func:`draws_of`.
    """
    value = statistic(np.ones(draws.shape[1], np.int64))
    return Estimate(value, *interval(np.array([statistic(each) for each in draws])))


def share_interval(share: float, count: int, low: float, high: float) -> tuple[float, float]:
    """Widen the interval of a share where all outcomes agree, and the bootstrap knows nothing.

    Parameters
    ----------
    share : float
        Of `count` outcomes, 0 to 1.
    count : int
        At least 0.
    low, high : float
        The interval of the bootstrap.

    Returns
    -------
    tuple of float
        For a share of 0 or 1 at least that of Clopper and Pearson (1934, Biometrika 26:404);
        else `low` and `high`.
    """
    if not count or share not in {0.0, 1.0}:
        return low, high
    reach = ((100 - LEVEL) / 200) ** (1 / count)
    return (min(low, reach), 1.0) if share else (0.0, max(high, 1 - reach))


def rate_interval(events: float, minutes: float) -> tuple[float, float]:
    """Return the interval of a rate of events that come by chance, one at a time.

    Parameters
    ----------
    events : float
        Their number, at least 0.
    minutes : float
        The time in which they came, above 0.

    Returns
    -------
    tuple of float
        Per minute: 0 and 3 over the minutes for no event (the rule of three), else the exact
        interval of a Poisson process (Garwood 1936, Biometrika 28:437).
    """
    if not events:
        return 0.0, RULE_OF_THREE / minutes
    tail = (100 - LEVEL) / 200
    low = _expected(lambda mean: 1 - _poisson(int(events) - 1, mean), tail)
    high = _expected(lambda mean: 1 - _poisson(int(events), mean), 1 - tail)
    return low / minutes, high / minutes


def _poisson(most: int, mean: float) -> float:
    """Return the chance of at most so many events where `mean` are expected."""
    logs = [k * math.log(mean) - mean - math.lgamma(k + 1) for k in range(most + 1)]
    return math.fsum(map(math.exp, logs))


def _expected(chance: Callable[[float], float], wanted: float) -> float:
    """Return the expected number of events at which a chance that rises with it is as wanted."""
    low, high = 0.0, 1.0
    while chance(high) < wanted:
        low, high = high, 2 * high
    for _ in range(60):
        middle = (low + high) / 2
        low, high = (middle, high) if chance(middle) < wanted else (low, middle)
    return high


def interval(values: Numbers) -> tuple[float, float]:
    """Return the bounds of the central 95 % of values.

    Parameters
    ----------
    values : ndarray, shape (count,)
        One value for each draw; NaN where a draw does not determine it.

    Returns
    -------
    tuple of float
        NaN if fewer than half of the draws determine the value.
    """
    known = values[~np.isnan(values)]
    if 2 * len(known) < len(values) or not len(known):
        return float("nan"), float("nan")
    tail = (100 - LEVEL) / 2
    # Ratios may be infinite, and between infinite ones nothing can be interpolated.
    low, high = np.percentile(known, [tail, 100 - tail], method="nearest")
    return float(low), float(high)


def weighted_mean(values: Numbers, weights: Weights) -> float:
    """Return the mean of values that count `weights` times each.

    NaN is left out; the mean is NaN if nothing else counts.
    """
    known = ~np.isnan(values)
    total = weights[known].sum()
    return float((values[known] * weights[known]).sum() / total) if total else float("nan")


def weighted_median(values: Numbers, weights: Weights) -> float:
    """Return the median of values that count `weights` times each.

    NaN is left out, infinite values count; the median is NaN if nothing counts.
    """
    known = ~np.isnan(values)
    repeated = np.sort(np.repeat(values[known], weights[known]))
    if not len(repeated):
        return float("nan")
    low, high = repeated[(len(repeated) - 1) // 2], repeated[len(repeated) // 2]
    return float(low if low == high else (low + high) / 2)
