"""ROC and precision-recall over scored windows, each with a weight."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

if TYPE_CHECKING:
    from oppload_cli.detection.evaluation.series import Flags, Numbers


class Curve(NamedTuple):
    """Both curves over all thresholds, from above the largest score to the smallest.

    Attributes
    ----------
    false_rate, true_rate : ndarray, shape (m + 1,)
        Share of the negative and of the positive windows at or above a threshold.
    precision : ndarray, shape (m + 1,)
        Share of positives among the windows at or above it; 1 where there is none.
    """

    false_rate: Numbers
    true_rate: Numbers
    precision: Numbers

    @property
    def auc(self) -> float:
        """Area under the ROC curve, 0 to 1: ties count half."""
        heights = (self.true_rate[1:] + self.true_rate[:-1]) / 2
        return float(np.sum(np.diff(self.false_rate) * heights))

    @property
    def average_precision(self) -> float:
        """Precision averaged over the steps of recall, 0 to 1; no interpolation."""
        return float(np.sum(np.diff(self.true_rate) * self.precision[1:]))


def curve(score: Numbers, positive: Flags, weight: Numbers) -> Curve | None:
    """Return the curves of some windows.

    Parameters
    ----------
    score : ndarray, shape (n,)
        Of each window.
    positive : ndarray of bool, shape (n,)
        Whether something approaches in it.
    weight : ndarray, shape (n,)
        How often it counts.

    Returns
    -------
    Curve or None
        None without a positive or without a negative window.
    """
    order = np.argsort(-score, kind="stable")
    score, positive, weight = score[order], positive[order], weight[order]
    # Equal scores share a threshold.
    last = np.flatnonzero(np.append(np.diff(score), -1.0)[: len(score)])
    hits = np.append(0, np.cumsum(weight * positive)[last])
    false = np.append(0, np.cumsum(weight * ~positive)[last])
    if not hits[-1] or not false[-1]:
        return None
    marked = hits + false
    precision = np.divide(hits, marked, out=np.ones(len(hits)), where=marked > 0)
    return Curve(false / false[-1], hits / hits[-1], precision)
