"""Models of LPLC2 neurons once more: literal, slow, in double precision throughout.

Each generator takes whole grey levels and yields, from frame 1 on, the values of the frame by
their names in the tables. Source: ``docs/detectors.md`` only.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Literal

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Iterator

    Frames = Any  # a sequence of arrays of uint8, shape (height, width)
    Plane = Any  # an array of float64, shape (height, width)


def padded_sum(values: Plane, kernel: Plane, mode: Literal["constant", "edge"]) -> Plane:
    """Correlate tap by tap; `mode` as `numpy.pad`."""
    reach = len(kernel) // 2
    around = np.pad(values, reach, mode=mode)
    height, width = values.shape
    out = np.zeros(values.shape)
    for (i, j), weight in np.ndenumerate(kernel):
        out += weight * around[i : i + height, j : j + width]
    return out


def gaussian(size: int, sigma: float) -> Plane:
    line = np.exp(-((np.arange(size) - size // 2) ** 2) / (2 * sigma**2))
    kernel: Plane = np.outer(line, line) / line.sum() ** 2
    return kernel


def emd_lplc2_gf(frames: Frames, scale: float = 1.0) -> Iterator[dict[str, Any]]:
    """EMD-LPLC2-GF at 200 x 150 px, each arm summed pixel by pixel."""
    luma = [frame / 255 * scale for frame in frames]
    shape = luma[0].shape
    filtered, low_on, low_off = np.zeros(shape), np.zeros(shape), np.zeros(shape)
    v, input_before, active_before, spiked = -60.0, 0.0, 0, 0
    for t in range(1, len(luma)):
        filtered = 25 / 26 * (luma[t] - luma[t - 1]) + 25 / 26 * filtered
        on = np.where(filtered > 0, filtered, 0)
        off = np.where(filtered < 0.05, np.abs(filtered - 0.05), 0)
        low_on, low_off = on / 6 + 5 / 6 * low_on, off / 6 + 5 / 6 * low_off
        h = np.zeros((shape[0] - 1, shape[1] - 1))
        down = h.copy()
        for now, late in ((on, low_on), (off, low_off)):
            h += late[:-1, :-1] * now[:-1, 1:] - now[:-1, :-1] * late[:-1, 1:]
            down += late[:-1, :-1] * now[1:, :-1] - now[:-1, :-1] * late[1:, :-1]
        around_h, around_v = np.pad(h, 50), np.pad(down, 50)
        units = np.ones(h.shape)
        for around, sign, rows, columns in (
            (around_h, -1, (-19, 20), (-49, 0)),
            (around_h, 1, (-19, 20), (1, 50)),
            (around_v, -1, (-49, 0), (-19, 20)),
            (around_v, 1, (1, 50), (-19, 20)),
        ):
            arm = np.zeros(h.shape)
            for i in range(50 + rows[0], 51 + rows[1]):
                for j in range(50 + columns[0], 51 + columns[1]):
                    arm += around[i : i + len(h), j : j + h.shape[1]]
            units *= np.where(sign * arm > 2, sign * arm, 0)
        active = int((units > 0).sum())
        drive = active / 2500
        current = 250 * drive * (drive - input_before) / 0.01 / 57.6 if active_before else 0.0
        input_before, active_before, spikes = drive, active, 0
        for _ in range(20):
            v = max(-80.0, v) if v <= -80 else _runge_kutta(v, current)
            if v > -50:
                spikes, v = spikes + 1, -70.0
        spiked = int(spiked or spikes > 0)
        y, x = np.unravel_index(units.argmax(), units.shape) if active else (-1, -1)
        yield {
            "active": active,
            "lplc2_sum": units.sum(),
            "lplc2_max": units.max(),
            "max_x": x,
            "max_y": y,
            "lplc2_centre": units[len(h) // 2 - 1, h.shape[1] // 2 - 1],
            "motion_abs": np.abs(h).sum() + np.abs(down).sum(),
            "current": current,
            "spikes": spikes,
            "v_end": v,
            "collision": spiked,
        }


def _runge_kutta(v: float, current: float) -> float:
    step = 0.0005

    def slope(v: float) -> float:
        return (-v - 60 + 10 * current) / 0.3

    one = slope(v)
    two = slope(v + step / 2 * one)
    three = slope(v + step / 2 * two)
    four = slope(v + step * three)
    return v + step / 6 * (one + 2 * two + 2 * three + four)


def zhou_lrf(frames: Frames, weights: Plane, e: int) -> Iterator[dict[str, Any]]:
    """The trained receptive field, each Gaussian summed tap by tap."""
    offsets = np.arange(-2 * e, 2 * e) + 0.5
    distance = offsets[:, None] ** 2 + offsets**2
    blur = np.where(distance <= (2 * e) ** 2, np.exp(-distance / (2 * (e / 2) ** 2)), 0)
    blur /= blur.sum()
    turned = [np.rot90(weights, turn) for turn in (0, 2, 1, 3)]
    late: list[Plane] = []
    for t, frame in enumerate(frames):
        around = np.pad(1 - frame / 255, 3 * e, mode="edge")
        rows, columns = (size // e for size in frame.shape)

        def sample(y: int, x: int, around: Plane = around) -> float:
            corner_y, corner_x = y + 3 * e - 2 * e, x + 3 * e - 2 * e
            patch = around[corner_y : corner_y + 4 * e, corner_x : corner_x + 4 * e]
            return float((blur * patch).sum())

        places = ((e // 2, 0), (e // 2, e), (e, e // 2), (0, e // 2))
        now = [
            np.array([[sample(r * e + y, c * e + x) for c in range(columns)] for r in range(rows)])
            for y, x in places
        ]
        if t == 0:
            late = now
            continue
        keep = np.exp(-1 / 3)
        late = [keep * old + (1 - keep) * new for old, new in zip(late, now, strict=True)]
        across = now[1] * late[0] - late[1] * now[0]
        up = now[3] * late[2] - late[3] * now[2]
        r = np.zeros((rows - 11, columns - 11))
        for i, j in np.ndindex(*r.shape):
            block = slice(i, i + 12), slice(j, j + 12)
            parts = zip((across, -across, up, -up), turned, strict=True)
            drive = sum((np.maximum(each[block], 0) * w).sum() for each, w in parts)
            r[i, j] = max(0.0, -0.966204 + drive)
        y, x = np.unravel_index(r.argmax(), r.shape)
        yield {
            "r_max": r.max(),
            "x": (x + 6) * e,
            "y": (y + 6) * e,
            "r_sum": r.sum(),
            "p_hit": 1 / (1 + np.exp(1.944388 - r[::6, ::6].sum())),
            "motion_abs": np.abs(across).sum() + np.abs(up).sum(),
        }


def hua(frames: Frames, *, literal: bool) -> Iterator[dict[str, Any]]:
    """The network after Hua et al., from frame 2 on."""
    height, width = frames[0].shape
    y, x = np.mgrid[:height, :width]
    cy, cx = height // 2, width // 2
    bias = np.exp(-4.5 * (((y - cy) / cy) ** 2 + ((x - cx) / cx) ** 2)) / (
        2 * np.pi * height / width
    )
    right, lower = x + 1 >= width // 2, y + 1 >= height // 2
    a = (1000 / 30) / (1000 / 30 + 30)
    state = [np.zeros((7, height, width)) for _ in range(2)]  # signal, delay, contrast, motion
    sums = np.zeros(4)
    for t in range(2, len(frames)):
        p = frames[t].astype(float) - frames[t - 1]
        band = padded_sum(p, gaussian(3, 1), "edge") - padded_sum(p, gaussian(5, 2), "edge")
        motion = np.zeros((4, height, width))
        for sign, exponent, own in ((1, 0.9, state[0]), (-1, 0.5, state[1])):
            own[0] = np.maximum(sign * band, 0) + 0.1 * own[0]
            s = padded_sum(own[0], gaussian(11, 5), "edge")
            own[1] = a * s + (1 - a) * own[1]
            contrast = np.abs(s - (padded_sum(s, np.ones((3, 3)), "edge") - s) / 8)
            rise, own[2] = contrast - own[2], contrast
            for k, (dy, dx) in enumerate(((0, 1), (0, -1), (1, 0), (-1, 0))):
                there = slice(1 + dy, 1 + dy + height), slice(1 + dx, 1 + dx + width)
                s_q, d_q = np.pad(s, 1, mode="edge")[there], np.pad(own[1], 1, mode="edge")[there]
                own[3 + k] = a * bias * s * s_q * (own[1] - d_q) + (1 - a) * own[3 + k]
                motion[k] += np.maximum(0, own[3 + k] - rise) ** exponent
        across, down = motion[0] - motion[1], motion[2] - motion[3]
        if literal:
            down = -down
        else:
            sums = np.zeros(4)
        for k, (h, v, where) in enumerate(
            (
                (across, down, right & lower),
                (-across, down, ~right & lower),
                (-across, -down, ~right & ~lower),
                (across, -down, right & ~lower),
            )
        ):
            sums[k] += (_gelu(h) + _gelu(v))[where].sum()
        names = "q_right_down", "q_left_down", "q_left_up", "q_right_up"
        yield {
            **dict(zip(names, sums.tolist(), strict=True)),
            "product": np.prod(np.maximum(sums, 0)),
        }


def _gelu(x: Plane) -> Plane:
    return np.asarray(x / 2 * (1 + np.tanh(0.7978846 * (x + 0.044715 * x**3))))


def mlplc2(frames: Frames) -> Iterator[dict[str, Any]]:
    """mLPLC2, scanned pixel by pixel as its authors do."""
    height, width = frames[0].shape
    in_band = np.ones((height, width), bool)
    in_band[5:-5, 5:-5] = False
    slots = [np.zeros((height, width)), np.zeros((height, width))]
    signal, before = np.zeros((2, height, width)), np.zeros((2, height, width))
    t_motion = np.zeros((2, 4, height, width))
    reach = padded_sum(np.ones((height, width)), gaussian(5, 20), "constant")
    fields: list[dict[str, Any]] = []
    opened, ti = 0, 1000 / 30
    for t in range(1, len(frames)):
        slots[t % 2] = frames[t].astype(float) - frames[t - 1]
        e = _cut(slots[1], gaussian(7, 10)[:3, :3], in_band)
        i = _cut(slots[0], gaussian(11, 20)[:5, :5], in_band)
        s = np.where(e >= 0, np.maximum(e - 1.2 * i, 0), np.minimum(e - 1.2 * i, 0))
        signal = np.array([np.where(s >= 0, s, 0), np.where(s < 0, -s, 0)]) + 0.1 * signal
        c = np.tanh(signal / (0.2 + signal * reach))
        c = np.where(c > 0.75, c, 0)
        m = np.zeros((4, height, width))
        for k, exponent in enumerate((0.9, 0.5)):
            correlated = _correlated(c[k], before[k], ti)
            a = ti / (ti + 30)
            t_motion[k] = a * correlated + (1 - a) * t_motion[k]
            m += 10 * t_motion[k] ** exponent
        before = c
        right, left, down, up = m
        net = [right - left, left - right, down - up, up - down]
        lm = [np.where(each >= 2, each, 0) for each in net]
        mag = np.sqrt((right + left) ** 2 + (down + up) ** 2)
        largest: Any = 0.0
        best: Any = 0.0
        place, found = (0, 0), (0, 0)
        for y, x in np.ndindex(height, width):
            if mag[y, x] > largest:
                largest, place = mag[y, x], (y, x)
            inside = any(
                f["y"] - 75 <= place[0] < f["y"] + 75 and f["x"] - 75 <= place[1] < f["x"] + 75
                for f in fields
            )
            if not inside and mag[y, x] > best:
                best, found = mag[y, x], (y, x)
        if best > 0:
            opened += 1
            fields.append(
                {"id": opened, "y": found[0], "x": found[1], "birth": t, "v": [], "out": []}
            )
        for f in list(fields):
            f["q"] = _quadrants(f["y"], f["x"], lm)
            f["v"].append(sum(f["q"]) if all(f["q"]) else 0)
            f["out"].append(sum(f["v"][-5:]))
            if t > f["birth"] + 5 and sum(f["out"][-5:]) < 10_000 and len(fields) > 1:
                fields.remove(f)
        old: dict[str, Any] = (
            fields[0] if fields else {"id": 0, "x": -1, "y": -1, "q": [0] * 4, "out": [0]}
        )
        y, x = place
        yield {
            "max_mag": largest,
            "max_x": x,
            "max_y": y,
            "sum_lm": sum(each.sum() for each in lm),
            "n_fields": len(fields),
            "field_id": old["id"],
            "field_x": old["x"],
            "field_y": old["y"],
            **dict(zip(("q_ru", "q_lu", "q_lb", "q_rb"), old["q"], strict=True)),
            "field_out": old["out"][-1],
            "best_out": max([f["out"][-1] for f in fields], default=0),
        }


def _cut(p: Plane, kernel: Plane, in_band: Plane) -> Plane:
    reach = len(kernel) // 2
    around, band = np.pad(p, reach), np.pad(in_band, reach, constant_values=True)
    out = np.zeros(p.shape)
    for (i, j), weight in np.ndenumerate(kernel):
        there = slice(i, i + len(p)), slice(j, j + p.shape[1])
        out = np.where(band[there], 0, out + weight * around[there])
    return out


def _correlated(c: Plane, before: Plane, ti: float) -> Plane:
    height, width = c.shape
    inner = slice(5, height - 5), slice(5, width - 5)
    out = np.zeros((4, height, width))
    for distance, tau in enumerate((80, 70, 60, 50, 40), 1):
        a = ti / (ti + tau)
        d = a * c + (1 - a) * before
        for k, (dy, dx) in enumerate(((0, 1), (0, -1), (1, 0), (-1, 0))):
            y, x = 5 + distance * dy, 5 + distance * dx
            there = slice(y, y + height - 10), slice(x, x + width - 10)
            e = d[inner] * d[there] * c[there] - 1.5 * d[inner] * c[inner] * d[there]
            out[k][inner] += np.where((e < 0) | (e > 1), 0, e)
    return out


def _quadrants(cy: int, cx: int, lm: list[Plane]) -> list[float]:
    right, left, down, up = lm
    height, width = right.shape
    q = [0.0] * 4
    for y in range(max(0, cy - 75), min(height, cy + 75)):
        for x in range(max(0, cx - 75), min(width, cx + 75)):
            if y <= cy and x > cx:
                q[0] += right[y, x] + up[y, x]
            elif y < cy and x <= cx:
                q[1] += left[y, x] + up[y, x]
            elif y >= cy and x < cx:
                q[2] += left[y, x] + down[y, x]
            else:
                q[3] += right[y, x] + down[y, x]
    return q
