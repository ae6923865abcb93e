"""Threads, processes, and the signals that stop them."""

from __future__ import annotations

import math
import os
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Iterator

_GROUPS, _OWN_GROUPS = Path("/sys/fs/cgroup"), Path("/proc/self/cgroup")


def cores() -> int:
    """Return the number of cores that this process may use.

    The affinity mask limits them. On Linux the control groups of the process do too, as in a
    container with ``--cpus 2``; a part of a core counts as a core.
    """
    allowed = (
        len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    )
    return math.ceil(min(allowed, _quota()))


@cache
def _quota() -> float:
    """Return the cores that the control groups allow; infinity without a limit."""
    try:
        groups = _OWN_GROUPS.read_text(encoding="utf-8", errors="replace").splitlines()
    except OSError:  # not Linux
        return math.inf
    return min((limit for line in groups for limit in _limits(line)), default=math.inf)


def _limits(group: str) -> Iterator[float]:
    """Yield the limits of a line of /proc/self/cgroup, from the group up to the root."""
    number, _, rest = group.partition(":")
    controllers, _, path = rest.partition(":")
    names = ["cpu.max"]
    if number == "0":  # version 2 of control groups
        root = _GROUPS
    elif "cpu" in controllers.split(","):
        root, names = _GROUPS / "cpu", ["cpu.cfs_quota_us", "cpu.cfs_period_us"]
    else:
        return
    own = Path(path.lstrip("/"))
    for folder in (root / own, *(root / parent for parent in own.parents)):
        try:
            words = " ".join((folder / name).read_text() for name in names).split()
            quota, period = (float(word) for word in words)
        except (OSError, ValueError):  # no such file: a container sees only its root; or "max"
            continue
        if quota > 0 and period > 0:
            yield quota / period
