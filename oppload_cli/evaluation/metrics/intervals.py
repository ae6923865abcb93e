"""Intervals of measurements, mostly by a bootstrap over the videos of the clips."""

from __future__ import annotations

import math
from functools import partial
from statistics import NormalDist
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from numpy.typing import NDArray

    from oppload_cli.evaluation.metrics.clips import Numbers, Positions

    Weights = NDArray[np.int64]


SEED = 20231
DRAWS = 1000
LEVEL = 95
RULE_OF_THREE = 3.0  # upper bound (95 %) of the expected number of events if none was seen


class Measurement(NamedTuple):
    """One row of ``evaluation.csv``."""

    detector: str
    measure: str
    condition: str
    value: float
    low: float  # bounds of the interval of the value; NaN where they are not known
    high: float
    n: int  # number of clips, windows, pairs or frames that were measured


def draws_of(
    looming: Sequence[bool],
    count: int = DRAWS,
    *,
    videos: Sequence[int] | NDArray[np.int64] | None = None,
) -> Weights:
    """Draw videos with replacement, those with and those without an approach separately.

    Parameters
    ----------
    looming : sequence of bool
        Whether an object approaches in each clip.
    count : int
        Number of draws.
    videos : sequence of int, optional
        The number of each clip's video; if left out, each clip is a video. Clips of one video are
        drawn together.

    Returns
    -------
    ndarray of int, shape (count, clips)
        How often each draw contains each clip.
    """
    random = np.random.default_rng(SEED)
    numbers = np.arange(len(looming)) if videos is None else np.asarray(videos)
    weights = np.zeros((count, len(looming)), np.int64)
    for kind in (True, False):
        members = np.flatnonzero(np.array(looming, bool) == kind)
        drawn, which = np.unique(numbers[members], return_inverse=True)
        if len(drawn):
            shares = np.full(len(drawn), 1 / len(drawn))
            weights[:, members] = random.multinomial(len(drawn), shares, count)[:, which]
    return weights


def estimate(statistic: Callable[[Weights], float], draws: Weights) -> tuple[float, float, float]:
    """Return a statistic of all clips, and the bounds of its percentile interval over the draws.

    Parameters
    ----------
    statistic : callable
        Takes an array that says how often each clip counts, and returns a number or NaN.
    draws : ndarray of int, shape (count, clips)
        From :func:`draws_of`.
    """
    value = statistic(np.ones(draws.shape[1], np.int64))
    return value, *interval(np.array([statistic(weights) for weights in draws]))


def share_interval(share: float, count: int, low: float, high: float) -> tuple[float, float]:
    """Widen the bootstrap's interval of a share of outcomes to the exact one.

    With few outcomes the bootstrap's holds the true share too seldom: with 12 outcomes and a share
    of 0.7 in 88 % of all cases.

    Parameters
    ----------
    share : float
        Share of `count` outcomes, 0 to 1; NaN without an outcome.
    count : int
        Number of outcomes. Each may itself be a share.
    low, high : float
        The interval of the bootstrap; NaN if it has none.

    Returns
    -------
    tuple of float
        At least the interval of Clopper and Pearson (1934, Biometrika 26:404) if the outcomes are
        0 and 1, or if the bootstrap has no interval, as for a single clip; else `low` and `high`.
        NaN for a share of NaN.
    """
    if math.isnan(share):
        return low, high
    # An outcome that is a share itself counts as 0 for the lower bound and as 1 for the upper one.
    least, most = math.floor(share * count + 1e-9), math.ceil(share * count - 1e-9)
    if least < most and not math.isnan(low):
        return low, high
    tail = (100 - LEVEL) / 200
    lower = _reaching(partial(_at_least, least, count), tail) if least else 0.0
    upper = _reaching(partial(_at_least, most + 1, count), 1 - tail) if most < count else 1.0
    # `fmin` and `fmax` ignore the NaN of a bootstrap without an interval.
    return float(np.fmin(low, lower)), float(np.fmax(high, upper))


class Split(NamedTuple):
    """How two detectors differ in the approaches that they detect."""

    only_first: int  # number of approaches that only the first detector detects
    only_second: int
    p: float  # the probability of a split at least as uneven if both detect equally well


def split_of(first: Numbers, second: Numbers, videos: Positions) -> Split:
    """Compare two detectors on the same approaches, by an exact permutation test over videos.

    Parameters
    ----------
    first, second : ndarray of float, shape (approaches,)
        Whether each detector detects each approach: 1 or 0, or NaN, which does not count.
    videos : ndarray of int, shape (approaches,)
        The number of each approach's video.

    Returns
    -------
    Split
        Its p is two-sided: the share of all exchanges of the two detectors in some of the videos
        that give a difference at least as large. If each video has one approach, the test is the
        exact test of McNemar (1947, Psychometrika 12:153).
    """
    differences = np.nan_to_num(first - second)
    _, which = np.unique(videos, return_inverse=True)
    shares = np.ones(1)  # of the exchanges that give each total from -reach to reach
    for difference in np.abs(np.bincount(which, differences)).astype(int):
        nothing = np.zeros(2 * difference)
        shares = (np.append(shares, nothing) + np.append(nothing, shares)) / 2
    reach = len(shares) // 2
    least = abs(int(differences.sum()))
    p = math.fsum(shares[np.abs(np.arange(-reach, reach + 1)) >= least])
    return Split(int((differences > 0).sum()), int((differences < 0).sum()), min(1.0, p))


def _at_least(least: int, count: int, chance: float) -> float:
    """Return the probability of at least `least` events in `count` trials, each of a `chance`."""
    if chance == 1:
        return 1.0
    log_factorial = math.lgamma(count + 1)
    logs = [
        log_factorial
        - math.lgamma(k + 1)
        - math.lgamma(count - k + 1)
        + k * math.log(chance)
        + (count - k) * math.log1p(-chance)
        for k in range(least, count + 1)
    ]
    return math.fsum(map(math.exp, logs))


def area_interval(area: float, approaches: int, others: int) -> tuple[float, float]:
    """Return the interval of a ROC area.

    The bounds are the true areas from which `area` deviates as far as chance allows. The variance
    is that of Hanley and McNeil (1982, Radiology 143:29) at the possible true area, not at the
    measured one, so that the bounds hold near 1 and with few videos, where a bootstrap finds hardly
    any spread (Newcombe 2006, Stat Med 25:559, method 5).

    Parameters
    ----------
    area : float
        Measured area, 0 to 1; NaN if it is not known.
    approaches, others : int
        Number of independent videos with an approach, and of those that have windows without one.

    Returns
    -------
    tuple of float
        The bounds, 0 to 1; NaN for an area of NaN.
    """
    if math.isnan(area):
        return math.nan, math.nan
    deviation = NormalDist().inv_cdf(0.5 + LEVEL / 200)
    pairs, average = approaches * others, (approaches + others) / 2 - 1

    def deviations(measured: float, true: float) -> float:
        spread = 1 + average * ((1 - true) / (2 - true) + true / (1 + true))
        variance = true * (1 - true) * spread / pairs
        return (true - measured) / math.sqrt(variance) if variance > 0 else math.inf

    # If both kinds of videos change places, A becomes 1 - A, and the upper bound the lower one.
    low = 1 - _reaching(partial(deviations, 1 - area), deviation)
    return low, _reaching(partial(deviations, area), deviation)


def precision_interval(precision: float, approaches: int, others: int) -> tuple[float, float]:
    """Return the interval of an average precision.

    It is the interval of Wilson (1927, J Am Stat Assoc 22:209) of a share of as many outcomes as
    there are videos of the rarer kind. An interval for shares, with the number of positives, holds
    the true value more often than a bootstrap does (Boyd, Eng and Page 2013, ECML PKDD, p. 451);
    with few videos without an approach it would be too narrow.

    Parameters
    ----------
    precision : float
        Measured average precision, 0 to 1; NaN if it is not known.
    approaches, others : int
        As for :func:`area_interval`.

    Returns
    -------
    tuple of float
        The bounds, 0 to 1; NaN for a precision of NaN.
    """
    if math.isnan(precision):
        return math.nan, math.nan
    count = min(approaches, others)
    squared = NormalDist().inv_cdf(0.5 + LEVEL / 200) ** 2
    middle = precision + squared / (2 * count)
    half_width = math.sqrt(squared * (precision * (1 - precision) + squared / (4 * count)) / count)
    low, high = ((middle + side) / (1 + squared / count) for side in (-half_width, half_width))
    return max(0.0, low), min(1.0, high)  # rounding may lead a little beyond


def rate_interval(events: float, minutes: float, low: float, high: float) -> tuple[float, float]:
    """Widen the bootstrap's interval of a rate to that of a Poisson process.

    Parameters
    ----------
    events : float
        Number of events, at least 0.
    minutes : float
        The time in which they were counted; 0 if there was none.
    low, high : float
        The interval of the bootstrap, in events per minute; NaN if it has none.

    Returns
    -------
    tuple of float
        Without an event from 0 to at least 3 / `minutes` (the rule of three). With events at least
        the exact interval of a Poisson process (Garwood 1936, Biometrika 28:437).
    """
    if not minutes:
        return low, high
    if not events:
        return 0.0, float(np.fmax(high, RULE_OF_THREE / minutes))
    tail = (100 - LEVEL) / 200
    least = _reaching(lambda mean: 1 - _poisson(int(events) - 1, mean), tail)
    most = _reaching(lambda mean: 1 - _poisson(int(events), mean), 1 - tail)
    return float(np.fmin(low, least / minutes)), float(np.fmax(high, most / minutes))


def _poisson(most: int, mean: float) -> float:
    """Return the probability of at most `most` events if `mean` events are expected."""
    logs = [k * math.log(mean) - mean - math.lgamma(k + 1) for k in range(most + 1)]
    return math.fsum(map(math.exp, logs))


def _reaching(rising: Callable[[float], float], wanted: float) -> float:
    """Return the number above 0 at which a `rising` function reaches `wanted`."""
    low, high = 0.0, 1.0
    while rising(high) < wanted:
        low, high = high, 2 * high
    for _ in range(60):
        middle = (low + high) / 2
        low, high = (middle, high) if rising(middle) < wanted else (low, middle)
    return high


def interval(values: Numbers) -> tuple[float, float]:
    """Return the bounds of the central 95 % of values, of which there is one for each draw.

    NaN counts as no value. The bounds are NaN if fewer than half of the draws have a value, and if
    they are equal: draws that agree do not say how far the value may be from the true one.
    """
    known = values[~np.isnan(values)]
    if 2 * len(known) < len(values) or not len(known):
        return float("nan"), float("nan")
    tail = (100 - LEVEL) / 2
    # Without interpolation, because ratios may be infinite.
    low, high = np.percentile(known, [tail, 100 - tail], method="nearest")
    agree = math.isclose(low, high)  # sums of floats, such as a ROC area of 1, differ in rounding
    return (float("nan"), float("nan")) if agree else (float(low), float(high))


def weighted_mean(values: Numbers, weights: Weights) -> float:
    """Return the mean of the values without NaN; value i counts `weights[i]` times.

    NaN if no value counts.
    """
    known = ~np.isnan(values)
    total = weights[known].sum()
    return float((values[known] * weights[known]).sum() / total) if total else float("nan")


def weighted_median(values: Numbers, weights: Weights) -> float:
    """Return the median of the values without NaN; value i counts `weights[i]` times.

    Infinite values count too. NaN if no value counts.
    """
    known = ~np.isnan(values)
    repeated = np.sort(np.repeat(values[known], weights[known]))
    if not len(repeated):
        return float("nan")
    # Several times as fast as np.median, which the draws of the bootstrap would call too often.
    low, high = repeated[(len(repeated) - 1) // 2], repeated[len(repeated) // 2]
    return float((low + high) / 2)
