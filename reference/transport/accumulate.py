"""Rays to compressed rows: trace a batch, sort each row's columns, sum the runs.

No atomics: a run of equal columns is summed by one lane in the order of its rays, so results repeat bit for bit.
The plain twin is `accumulate_plain`.

A batch goes through four hands: `prepare_batch` draws up the kernel, `start_batch` sets Dr.Jit's threads to it,
`collect_batch` waits for them, and `finish_batch` sorts and sums. Collecting waits for everything that was started, so
whoever wants one batch summed while the next is traced collects the one before starting the other. Summing is done by one
thread, in the place of one that would trace: a second one gained nothing (36 ms with one, 38 with two for 2 M rays on two
cores), since NumPy's threads hand Python's lock to and fro for each short step.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from ..datatypes import F32, F64, I32, I64, Bool
from ..device_arrays import to_u32, to_u64
from ..low_discrepancy import receiver_seeds, scrambled, sobol_table
from ..sh import COEFFICIENTS, Y0, Y1, Y2, Y20
from ..visibility import Geometry
from .hits import DevicePatches, columns_of_rays
from .receivers import Receivers

RAYS_PER_PART = 1 << 16  # sorted and counted at once: NumPy's steps then find their arrays in a core's own cache


@dataclass(frozen=True, eq=False)
class Batch:
    """Compressed rows of some receivers: rows (R,) receiver numbers, lengths (R,) entries per row, columns (nnz,) i32
    ascending within a row, values and se (nnz, K) f32, back_share (R,)."""

    rows: I64
    lengths: I64
    columns: I32
    values: F32
    se: F32
    back_share: F64


@dataclass(frozen=True, eq=False)
class Traced:
    """A batch on its way. keys (rows · rays,): column · rays + ray, mi.UInt32, or mi.UInt64 where that is too short;
    met_back (rows · rays,) mask; directions (rows · rays,) mi.Vector3f for probes, else None; components: K."""

    rows: I64
    rays: int
    replicates: int
    weight: float
    components: int
    keys: Any
    met_back: Any
    directions: Any


@dataclass(frozen=True, eq=False)
class Collected:
    """A batch traced to its end, and its keys and met_back (rows, rays) in NumPy, where they lie."""

    traced: Traced
    keys: npt.NDArray[np.unsignedinteger]
    met_back: Bool


def batch_rays(receivers: Receivers, rows: I64, rays: int, replicates: int, seed: int) -> tuple[Any, Any, Any]:
    """Origins, directions and number within its receiver of every ray (rows · rays,); not evaluated: a part of the
    caller's kernel."""
    import drjit as dr
    import mitsuba as mi

    points, shift = rays // replicates, rays.bit_length() - 1
    table = sobol_table(points)
    lane = dr.arange(mi.UInt32, len(rows) * rays)
    receiver = dr.gather(mi.UInt32, to_u32(rows), lane >> dr.opaque(mi.UInt32, shift))
    ray = lane & dr.opaque(mi.UInt32, rays - 1)
    index, replicate = ray & dr.opaque(mi.UInt32, points - 1), ray >> dr.opaque(mi.UInt32, points.bit_length() - 1)
    scramble = receiver_seeds(receiver, replicate, dr.opaque(mi.UInt32, seed))
    return *receivers.rays(receiver, lambda d: scrambled(table, index, scramble, d)), ray


def prepare_batch(
    g: Geometry, p: DevicePatches, receivers: Receivers, rows: I64, rays: int, replicates: int, seed: int
) -> Traced:
    """The kernel that traces `rays` rays from each of `rows`, drawn up but not started."""
    import drjit as dr
    import mitsuba as mi

    origins, directions, ray = batch_rays(receivers, rows, rays, replicates, seed)
    column, back = columns_of_rays(g, p, origins, directions)
    shift = rays.bit_length() - 1
    wide = p.columns << shift > 1 << 32
    key_type = mi.UInt64 if wide else mi.UInt32
    keys = (key_type(column) << dr.opaque(key_type, shift)) | key_type(ray)
    kept = directions if receivers.spherical else None
    return Traced(rows, rays, replicates, receivers.weight, receivers.components, keys, back, kept)


def start_batch(t: Traced) -> None:
    """Start tracing; returns at once."""
    import drjit as dr

    dr.eval(t.keys, t.met_back, t.directions)  # together, else the rays are traced once for each


def launch_batch(
    g: Geometry, p: DevicePatches, receivers: Receivers, rows: I64, rays: int, replicates: int, seed: int
) -> Traced:
    """Prepare and start."""
    t = prepare_batch(g, p, receivers, rows, rays, replicates, seed)
    start_batch(t)
    return t


def collect_batch(t: Traced) -> Collected:
    """Wait until this batch, and whatever else was started, is traced."""
    keys, met_back = (np.array(a, copy=False).reshape(len(t.rows), t.rays) for a in (t.keys, t.met_back))
    return Collected(t, keys, met_back)


def finish_batch(c: Collected) -> Batch:
    """Sort and sum a traced batch. The keys are sorted where they lie: a batch can be finished once."""
    t, keys = c.traced, c.keys
    step = max(1, RAYS_PER_PART // t.rays)
    found = [_runs(t, keys[i : i + step]) for i in range(0, len(keys), step)]
    lengths, columns = (np.concatenate([f[k] for f in found]) for k in (0, 1))
    if t.directions is None:
        values, se = (np.concatenate([f[k] for f in found])[:, None] for k in (2, 3))
    else:
        starts = np.concatenate([f[4] + n * step * t.rays for n, f in enumerate(found)])
        values, se = _sum_runs(t, starts, keys)
    back = np.count_nonzero(c.met_back, axis=1) if c.met_back.any() else np.zeros(len(t.rows), np.int64)
    return Batch(t.rows, lengths, columns, values, se, back / t.rays)


def _runs(t: Traced, keys: npt.NDArray[np.unsignedinteger]) -> tuple[I64, I32, F32, F32, I64]:
    """Runs of equal columns of some rows: entries per row, columns, share of the rays and its standard error, starts.

    s² of a sum of M replicate counts x_r: M/(M-1) (Σ x_r² - (Σ x_r)²/M), exact in integers.
    """
    keys.sort(axis=1)
    flat, unsigned, m = keys.ravel(), keys.dtype.type, t.replicates
    # Bits in which a key differs from the one before it: from those of the replicate up, another part of a run begins.
    part = t.rays // m if t.directions is None else t.rays
    differs = np.empty_like(flat)
    np.bitwise_xor(flat[1:], flat[:-1], out=differs[1:])
    differs[:: t.rays] = np.iinfo(keys.dtype).max
    part_starts = np.flatnonzero(differs >= unsigned(part))
    first = np.flatnonzero(differs.take(part_starts) >= unsigned(t.rays))  # parts with which a run begins
    starts = part_starts.take(first)
    lengths = np.diff(np.searchsorted(starts, np.arange(0, keys.size + 1, t.rays)))
    columns = (flat.take(starts) >> unsigned(t.rays.bit_length() - 1)).astype(np.int32)
    if t.directions is not None:
        return lengths, columns, np.zeros(0, np.float32), np.zeros(0, np.float32), starts
    upto = _lengths(part_starts, keys.size)
    np.cumsum(np.multiply(upto, upto, out=upto), out=upto)
    squares = np.diff(upto.take(np.append(first[1:], len(upto)) - 1), prepend=0)
    counts = _lengths(starts, keys.size)
    spread = (m * squares - counts * counts).astype(np.float32)
    scale = np.float32(t.weight / t.rays)
    se = np.sqrt(spread) * np.float32(scale / np.sqrt(m - 1.0))
    return lengths, columns, counts.astype(np.float32) * scale, se, starts


def _lengths(starts: I64, end: int) -> I64:
    """How far it is from each start to the next, from the last to the end."""
    out = np.empty_like(starts)
    np.subtract(starts[1:], starts[:-1], out=out[:-1])
    out[-1] = end - starts[-1]
    return out


def _sum_runs(t: Traced, starts: I64, keys: npt.NDArray[np.unsignedinteger]) -> tuple[F32, F32]:
    """Sum of each run of equal columns, and its standard error from the replicates: one lane per run.

    s² of a sum S of M replicate sums x_r: M/(M-1) (Σ (x_r - c)² - (S - M c)²/M), over all M (absent ones are 0). c is the
    mean if all rays were as the first: float32 then does not lose a small spread of large sums.
    """
    import drjit as dr
    import mitsuba as mi

    k, m = t.components, t.replicates
    begin, end = to_u32(starts), to_u32(np.append(starts[1:], keys.size))
    mask, shift = dr.opaque(mi.UInt32, t.rays - 1), dr.opaque(mi.UInt32, (t.rays // t.replicates).bit_length() - 1)
    row_start = begin & ~mask
    sorted_keys = to_u32(keys) if keys.dtype == np.uint32 else to_u64(keys)

    def ray_at(i: Any) -> Any:
        return mi.UInt32(dr.gather(type(sorted_keys), sorted_keys, i)) & mask

    zero = [mi.Float(0) for _ in range(k)]
    centre = [y * (mi.Float(end - begin) / m) for y in _terms(t, row_start + ray_at(begin))]

    def step(i: Any, present: Any, last: Any, *state: Any) -> tuple[Any, ...]:
        total, part, squares = (list(state[n * k : (n + 1) * k]) for n in range(3))
        ray = ray_at(i)
        replicate = ray >> shift
        terms = _terms(t, row_start + ray)
        new = replicate != last
        squares = [s + dr.select(new, dr.square(x - c), 0.0) for s, x, c in zip(squares, part, centre, strict=True)]
        total = [s + dr.select(new, x, 0.0) for s, x in zip(total, part, strict=True)]
        part = [dr.select(new, 0.0, x) + y for x, y in zip(part, terms, strict=True)]
        return (i + 1, present + dr.select(new, 1.0, 0.0), replicate, *total, *part, *squares)

    state = (begin, mi.Float(1), ray_at(begin) >> shift, *zero, *zero, *zero)
    present, _, *sums = dr.while_loop(state, lambda i, *_: i < end, step)[1:]
    before, part, squares = sums[:k], sums[k : 2 * k], sums[2 * k :]
    total = [s + x for s, x in zip(before, part, strict=True)]
    scale = dr.opaque(mi.Float, t.weight / t.rays)
    values = [s * scale for s in total]
    spread = [
        q + dr.square(x - c) + (m - present) * dr.square(c) - dr.square(s - m * c) / m
        for q, x, c, s in zip(squares, part, centre, total, strict=True)
    ]
    se = [dr.sqrt(dr.maximum(v * (m / (m - 1.0)), 0.0)) * scale for v in spread]
    dr.eval(values, se)
    return np.stack([np.array(v) for v in values], axis=1), np.stack([np.array(v) for v in se], axis=1)


def _terms(t: Traced, lane: Any) -> list[Any]:
    """What ray `lane` of the batch adds before weighting: 1, or the SH basis (order of `sh.basis`) in its direction."""
    import drjit as dr
    import mitsuba as mi

    if t.directions is None:
        return [mi.Float(1.0)]
    x, y, z = (dr.gather(mi.Float, t.directions[axis], lane) for axis in range(3))
    first = [mi.Float(Y0), Y1 * y, Y1 * z, Y1 * x]
    if t.components == COEFFICIENTS:
        return first
    return [*first, Y2 * x * y, Y2 * y * z, Y20 * (3.0 * z * z - 1.0), Y2 * x * z, 0.5 * Y2 * (x * x - y * y)]


def accumulate_plain(found: I64, terms: F64, replicates: int) -> dict[int, tuple[F64, F64]]:
    """One row the slow way: found (N,) columns, terms (N, K); column -> sum and standard error of the sum, (K,) each."""
    out = {}
    parts = np.arange(len(found)) // (len(found) // replicates)
    for column in sorted(set(found.tolist())):
        mine = (found == column)[:, None] * terms
        sums = np.stack([mine[parts == r].sum(axis=0) for r in range(replicates)])
        out[column] = (sums.sum(axis=0), np.sqrt(replicates * sums.var(axis=0, ddof=1)))
    return out
