"""The published detectors once more, as literal as their text: a row of values per frame.

Each function takes the grey levels of all frames, 0 to 255, and returns a dict per frame from
frame 1 on. Nothing is shared with the package.
"""

from __future__ import annotations

from functools import partial
from itertools import pairwise
from math import exp, floor, pi
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Sequence

    from numpy.typing import NDArray

    Plane = NDArray[np.float64]
    Row = dict[str, float]
    Frames = Sequence[NDArray[np.uint8]]

TI = 33  # ms per frame at 30 frames per second


def taps(x: Plane, kernel: Plane, border: str) -> Iterator[tuple[Plane, float, int, int]]:
    """Each neighbour's map with its weight and its offset."""
    side = len(kernel) // 2
    padded = np.pad(x, side, mode=border)  # type: ignore[call-overload]
    for dy in range(-side, side + 1):
        for dx in range(-side, side + 1):
            shifted = padded[side + dy :, side + dx :][: x.shape[0], : x.shape[1]]
            yield shifted, kernel[dy + side, dx + side], dy, dx


def convolved(x: Plane, kernel: Plane, border: str = "edge") -> Plane:
    return np.asarray(sum(each * weight for each, weight, _, _ in taps(x, kernel, border)))


def k3(centre: float, nearest: float, diagonal: float) -> Plane:
    d, n = diagonal, nearest
    return np.array([[d, n, d], [n, centre, n], [d, n, d]])


def gaussian(side: int, sigma: float) -> Plane:
    y, x = np.mgrid[:side, :side] - side // 2
    return np.asarray(np.exp(-(x**2 + y**2) / (2 * sigma**2)))


A3 = np.full((3, 3), 1 / 9)


def sig(u: float) -> float:
    return 1 / (1 + exp(-u))


def share(tau: float) -> float:
    return TI / (TI + tau)


def spread(x: Plane, before: Plane, weights: Sequence[float], taus: Sequence[float]) -> Plane:
    """ST: every tap low-passed with the previous input, then summed."""
    out = np.zeros_like(x)
    kernel = np.ones((3, 3))
    for (now, _, dy, dx), (then, *_) in zip(
        taps(x, kernel, "edge"), taps(before, kernel, "edge"), strict=True
    ):
        far = abs(dy) + abs(dx)
        a = share(taus[far])
        out += weights[far] * (a * now + (1 - a) * then)
    return out


def changes(frames: Frames) -> Iterator[Plane]:
    for before, now in pairwise(frames):
        yield now.astype(float) - before.astype(float)


class Sfa:
    def __init__(self, tau: float) -> None:
        self.hp, self.smp, self.sfa = tau / (tau + TI), 0.0, 0.0

    def step(self, smp: float) -> float:
        d = smp - self.smp
        sfa = self.hp * (self.sfa + d) if d <= 0.003 else self.hp * smp
        self.smp, self.sfa = smp, max(sfa, 0.5)
        return self.sfa


def on_off(p: Plane, on: Plane, off: Plane) -> tuple[Plane, Plane]:
    return (np.where(p >= 0.1, p, 0) + 0.1 * on, np.where(p < 0.1, np.abs(p), 0) + 0.1 * off)


def lgmd1_single(frames: Frames, *, absolute: bool = False) -> Iterator[Row]:
    n, nsp, latched = frames[0].size, 0, 0
    before = np.zeros(frames[0].shape)
    for p in changes(frames):
        e = abs(p) if absolute else p
        i = convolved(before, k3(0, 1 / 4, 1 / 8))
        ffi = float(np.abs(before).sum()) / n
        s = e - 0.6 * i
        s[(e * i <= 0) | (s < 30 - 1e-4)] = 0
        mp = 0.0 if ffi >= 10 else float(s.sum())
        smp = sig(mp / n)
        nsp = nsp + 1 if smp >= 0.78 else 0
        latched = latched or int(nsp >= 5)
        before = e
        yield {"mp": mp, "smp": smp, "ffi": ffi, "spike": int(smp >= 0.78), "nsp": nsp,
               "collision": latched}  # fmt: skip


def lgmd1_onoff(frames: Frames) -> Iterator[Row]:
    n, ffi, nsp, latched, sfa = frames[0].size, 0.0, 0, 0, Sfa(800)
    zero = np.zeros(frames[0].shape)
    ons, offs = [zero, zero], [zero, zero]
    for t, p in enumerate(changes(frames), start=1):
        ffi = share(90) * np.abs(p).sum() / n + (1 - share(90)) * ffi
        if ffi >= 10:
            mp, sfa.smp, sfa.sfa = 0.0, 0.5, 0.5
        else:
            on0, off0 = ons[(t - 1) % 2], offs[(t - 1) % 2]
            on, off = on_off(p, on0, off0)
            ons[t % 2], offs[t % 2] = on, off
            weights, taus = (0, 1 / 4, 1 / 8), (1, 30, 60)
            s = on - 0.5 * spread(on, on0, weights, taus) + spread(off, off0, weights, taus) - off
            s[s < 30] = 0
            mp = float(convolved(s, A3).sum())
            sfa.step(sig(mp / n))
        k = floor(exp(4 * (sfa.sfa - 0.78)))
        nsp = nsp + k if k else 0
        latched = latched or int(nsp >= 5)
        yield {"mp": mp, "smp": sfa.smp, "sfa": sfa.sfa, "ffi": ffi, "spike": k, "nsp": nsp,
               "collision": latched}  # fmt: skip


def lgmd1_group(
    frames: Frames, p1: float = 0.5, p2: float = 0.5, mask: Callable[[Plane], Plane] = lambda x: x
) -> Iterator[Row]:
    n = frames[0].size
    one = two = np.zeros(frames[0].shape)
    for t, p in enumerate(changes(frames), start=1):
        if t == 1:
            yield dict.fromkeys(("k", "sum_abs_g", "omega", "sum_abs_s", "sum_abs_p"), 0.0)
            continue
        q = p + p1 * one + p2 * two
        s = mask(q) - 0.3 * mask(convolved(mask(one), k3(0, 1 / 4, 1 / 8), "constant"))
        ce = convolved(s, A3, "constant")
        w = float(np.abs(ce).max()) / 4 + 0.01
        g = s * ce / w
        g[0.15 * g < 15] = 0
        one, two = q, one
        total_s, total_q = float(np.abs(s).sum()), float(np.abs(q).sum())
        yield {"k": sig(g.sum() / n), "sum_abs_g": float(np.abs(g).sum()), "omega": w,
               "sum_abs_s": total_s, "sum_abs_p": total_q}  # fmt: skip


def lgmd2(frames: Frames) -> Iterator[Row]:
    n, pm, nsp, sfa = frames[0].size, 0.0, 0, Sfa(800)
    on0 = off0 = np.zeros(frames[0].shape)
    for p in changes(frames):
        pm = share(90) * np.abs(p).sum() / n + (1 - share(90)) * pm
        w_on, w_off = max(pm / 8, 1), max(pm / 8, 0.5)
        on, off = on_off(p, on0, off0)
        so = on - w_on * spread(on, on0, (2, 1 / 2, 1 / 4), (15, 30, 45))
        sf = off - w_off * spread(off, off0, (1, 1 / 4, 1 / 8), (60, 120, 180))
        so, sf = np.maximum(so, 0), np.maximum(sf, 0)
        s = so + sf + so * sf
        ce = convolved(s, A3)
        g = s * ce / (0.01 + np.abs(ce).max() / 4)
        g[0.5 * g < 15] = 0
        mp, on0, off0 = float(g.sum()), on, off
        sfa.step(sig(mp / n))
        k = floor(exp(4 * (sfa.sfa - 0.78)))
        nsp = nsp + k if k else 0
        yield {"mp": mp, "smp": sfa.smp, "sfa": sfa.sfa, "pm": pm, "w_on": w_on, "w_off": w_off,
               "spike": k, "nsp": nsp, "collision": int(nsp >= 8)}  # fmt: skip


def lgmd_plus(frames: Frames) -> Iterator[Row]:
    (h, w), n = frames[0].shape, frames[0].size
    ffi, latched, sfa, counts = 0.0, 0, Sfa(783), [0] * 10
    on0 = off0 = g0 = np.zeros((h, w))
    y, x = np.mgrid[:h, :w]
    cy, cx, s0 = h // 2, w // 2, 0.5307723
    field = np.exp(-4.5 * (((y - cy) / cy) ** 2 + ((x - cx) / cx) ** 2)) / (
        2 * pi * s0 * h / w * s0
    )
    v_local = np.maximum(1 - field, 0.1)
    kernel = gaussian(3, 1) / gaussian(3, 1).sum()
    for p in changes(frames):
        b = sum(np.trunc(each * weight) for each, weight, _, _ in taps(p, kernel, "edge"))
        ffi = share(10) * np.abs(p).sum() / n + (1 - share(10)) * ffi
        r = 1 - ffi / 12 if 1 - ffi / 12 >= 0 else 0.5
        bias = max(ffi / 12, 0.6190473)
        on, off = on_off(np.asarray(b), on0, off0)
        weights, taus = (1, 1 / 4, 1 / 8), (10, 20, 30)
        so = np.maximum(on - v_local * bias * spread(on, on0, weights, taus), 0)
        sf = np.maximum(off - v_local * bias * spread(off, off0, weights, taus), 0)
        s = 2 * so + sf
        ce = convolved(s, A3)
        v = s * ce / (0.5 + np.abs(ce).max() / 4)
        v[0.5 * v < 18] = 0
        g0 = share(10 * r) * v + (1 - share(10 * r)) * g0
        mp, on0, off0 = float(g0.sum()), on, off
        sfa.step(sig(mp / (0.6 * n)))
        k = floor(exp(10 * (sfa.sfa - 0.68)))
        counts = [*counts[1:], k]
        rate = 1000 * sum(counts) / (10 * TI)
        latched = latched or int(rate >= 56)
        yield {"mp": mp, "smp": sfa.smp, "sfa": sfa.sfa, "ffi": ffi, "spike": k,
               "spike_rate": rate, "bias": bias, "tau_g": 10 * r, "collision": latched}  # fmt: skip


def lgmd_contrast(frames: Frames) -> Iterator[Row]:
    n = frames[0].size
    m0 = [np.zeros(frames[0].shape)] * 2
    kernel = gaussian(9, 5) / gaussian(9, 5).sum()
    for p in changes(frames):
        m = [np.tanh(x / (convolved(x, kernel, "reflect") + 3)) for x in
             (np.maximum(p, 0), np.maximum(-p, 0))]  # fmt: skip
        c = [np.abs(convolved(each, k3(1, -1 / 8, -1 / 8), "reflect")) for each in m]
        i = [convolved(each, k3(0, 1 / 4, 1 / 8), "reflect") for each in m0]
        on, off = (np.maximum(m[k] - 0.4 * i[k] - c[k], 0) for k in (0, 1))
        s = on + off + on * off
        ce = convolved(s, A3, "reflect")
        g = s * ce / (ce.max() / 4 + 0.01)
        g[0.5 * g < 0.7] = 0
        m0 = m
        yield {"mp": sig(g.sum() / (0.1 * n)), "sum_s": float(s.sum()),
               "sum_m_on": float(m[0].sum()), "sum_m_off": float(m[1].sum()),
               "sum_c_on": float(c[0].sum()), "sum_i_off": float(i[1].sum())}  # fmt: skip


def ci_lmd(frames: Frames) -> Iterator[Row]:
    n = frames[0].size
    on0 = off0 = np.zeros(frames[0].shape)
    ge, gi = gaussian(5, 4) / (2 * pi * 16), gaussian(9, 2) / (2 * pi * 4)
    w = k3(0, 1 / 4, 1 / 8)
    for p in changes(frames):
        e, i = convolved(p, ge), convolved(p, gi)
        d = np.where((e >= 0) & (i >= 0), abs(e - i), np.where((e < 0) & (i < 0), -abs(e - i), 0))
        on, off = np.maximum(d, 0) + 0.1 * on0, np.maximum(-d, 0) + 0.1 * off0
        so = on - 0.4 * convolved(on0, w) - 0.25 * off
        sf = off - 0.6 * convolved(off0, w) - 0.3 * on
        g = convolved(so + 0.9 * sf + 0.5 * so * sf, A3)
        g[g < 10] = 0
        on0, off0 = on, off
        yield {"ci_lmd": sig(g.sum() / (0.9 * n))}


def area_growth(frames: Frames) -> Iterator[Row]:
    light = [frame / 255 for frame in frames]
    sizes = [0.0]
    for before, now in pairwise(light):
        area = int((abs(now - light[0]) > 0.1).sum())
        sizes.append(area**0.5)
        dsize = (sizes[-1] - sizes[-4]) / 3 if len(sizes) > 3 else 0.0
        yield {"area": area, "size": sizes[-1], "dsize": dsize,
               "growth": dsize / sizes[-1] if area else 0.0,
               "frame_diff": float(abs(now - before).mean())}  # fmt: skip


def fitted(ex: Plane, ey: Plane, et: Plane, *window: int) -> Plane:
    cy, cx, m = window
    at = slice(max(0, cy - m), cy + m + 1), slice(max(0, cx - m), cx + m + 1)
    y, x = np.mgrid[: len(ex), : ex.shape[1]]
    g = (x - cx) * ex + (y - cy) * ey
    columns = np.stack([each[at].ravel() for each in (ex, ey, g)], axis=1)
    change = et[at].ravel()
    n = len(change)
    matrix = columns.T @ columns + 1e-6 * n * np.diag([1, 1, m**2])
    motion = np.linalg.solve(matrix, -columns.T @ change)
    rest, power = ((change + columns @ motion) ** 2).sum(), (change**2).sum()
    r2 = max(0.0, 1 - rest / power) if power > 1e-12 else 0.0
    return np.array([*motion, r2])


def ttc_gradient(frames: Frames) -> Iterator[Row]:
    h, w = frames[0].shape
    sigma = 2 * h / 150
    radius = round(4 * sigma)
    line = gaussian(2 * radius + 1, sigma)[radius]
    kernel = np.outer(line, line) / line.sum() ** 2
    smooth = [convolved(frame / 255, kernel) for frame in frames]
    half = round(5 * h / 12) // 2
    for e1, e2 in pairwise(smooth):
        cube = np.array([[[e[y : h - 1 + y, x : w - 1 + x] for x in (0, 1)] for y in (0, 1)]
                         for e in (e1, e2)])  # fmt: skip
        ex = (cube[:, :, 1] - cube[:, :, 0]).mean((0, 1))
        ey = (cube[:, 1] - cube[:, 0]).mean((0, 1))
        et = (cube[1] - cube[0]).mean((0, 1))

        fit = partial(fitted, ex, ey, et)
        a, b, c, r2 = fit((h - 1) // 2, (w - 1) // 2, max(h, w))
        best = (-1.0, 0, 0, 0.0, 0.0)
        step = max(1, round(h / 30))
        for cy in range(half, h - 1 - half, step):
            for cx in range(half, w - 1 - half, step):
                _, _, ci, ri = fit(cy, cx, half)
                if max(ci, 0) * ri > best[0]:
                    best = (max(ci, 0) * ri, cx, cy, ci, ri)
        yield {"a": a, "b": b, "c": c, "r2": r2, "best_score": best[0], "best_x": best[1],
               "best_y": best[2], "best_c": best[3], "best_r2": best[4]}  # fmt: skip
