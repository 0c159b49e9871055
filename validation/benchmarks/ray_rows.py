"""Form factors by rays against the bare Embree query for the same rays.

    rays_vs_embree_*      = (rays / time of patch_form_factors) / (rays / time of the queries)
    rays_time_exponent    = slope of log time over log rays

Ours is the whole function: making the rays, tracing, columns, sorting, sums, standard errors, assembled rows. The bare
query finds origins and directions ready in memory and writes t, prim_index and prim_uv to memory that was touched before;
the rays come from the same receivers and scrambles, in the same order, over all rows. It is asked in launches of about
BARE_RAYS rays, which serve it best: ours takes smaller ones, to sum one while it traces the next.
"""

from __future__ import annotations

import time
from collections.abc import Iterator
from typing import Any

import numpy as np

from ...reference.datatypes import F64, I64
from ...reference.progress import Progress, silent
from ...reference.transport.accumulate import batch_rays
from ...reference.transport.form_factors import REPLICATES, patch_form_factors
from ...reference.transport.patches import Patches, build_patches
from ...reference.transport.receivers import Receivers, patch_receivers
from ...reference.variant import ensure_variant
from ...reference.visibility import Geometry, build_geometry
from .places import bundled
from .rows import Group, Row, Wanted, row_of
from .timing import Task, interleaved, timed

RAYS = 1024
BARE_RAYS = 1 << 21
RAY_COUNTS = (256, 512, 1024, 2048, 4096)
HOUSE_2K, HOUSE_20K, CORNELL_2K = ("house", 1.8), ("house", 0.38), ("cornell", 0.032)  # patch_size, m
SEED = 1


def patched(name: str, patch_size: float) -> tuple[Geometry, Patches]:
    """A bundled scene cut into patches of `patch_size` m."""
    ensure_variant()
    scene = bundled(name)
    g = build_geometry(scene)
    return g, build_patches(scene, g, patch_size)


def rays_in_memory(receivers: Receivers, rows: I64, rays: int, replicates: int, seed: int) -> tuple[Any, Any]:
    """Origins and directions (rows · rays,) that `accumulate.launch_batch` traces, evaluated."""
    import drjit as dr

    origins, directions, _ = batch_rays(receivers, rows, rays, replicates, seed)
    dr.eval(origins, directions)
    dr.sync_thread()
    return origins, directions


def touch(lanes: int) -> None:
    """Leave touched memory for four arrays of `lanes` floats with Dr.Jit's allocator: form factors hand all of theirs back, and
    the query's time should not hold the kernel's clearing of new pages."""
    import drjit as dr
    import mitsuba as mi

    made = [mi.Float(dr.arange(mi.UInt32, lanes)) + k for k in range(4)]
    dr.eval(made)
    dr.sync_thread()


def query_seconds(g: Geometry, origins: Any, directions: Any) -> float:
    """Seconds of the bare query for rays in memory."""
    import drjit as dr
    import mitsuba as mi

    touch(dr.width(origins))
    begin = time.perf_counter()
    found = g.caster.ray_intersect_preliminary(mi.Ray3f(origins, directions), coherent=False)
    dr.eval(found.t, found.prim_index, found.prim_uv)
    dr.sync_thread()
    return time.perf_counter() - begin


def bare(g: Geometry, receivers: Receivers, rays: int) -> Task:
    """The bare queries of all rows, in launches of equal size; only the queries are timed."""
    launches = max(1, round(receivers.count * rays / BARE_RAYS))

    def task(repeat: int) -> float:
        del repeat
        seconds = 0.0
        for rows in np.array_split(np.arange(receivers.count), launches):
            seconds += query_seconds(g, *rays_in_memory(receivers, rows, rays, REPLICATES, SEED))
        return seconds

    return task


def ours(g: Geometry, p: Patches, rays: int) -> Task:
    """The whole of patch_form_factors."""
    return timed(lambda: patch_form_factors(g, p, rays, SEED, silent))


def against_embree(
    place: tuple[str, float], suffix: str, target: float | None, repeats: int, progress: Progress, rays: int = RAYS
) -> Iterator[Row]:
    """The ratio, and both rates, on one scene at one patch size."""
    g, p = patched(*place)
    tasks = {"ours": ours(g, p, rays), "bare": bare(g, patch_receivers(g, p), rays)}
    s = interleaved(tasks, repeats, progress, f"rays {suffix}")
    note = f"{place[0]}, {p.count} patches, {rays} rays per patch"
    million = 1e-6 * p.count * rays
    yield row_of(f"rays_vs_embree_{suffix}", s["bare"] / s["ours"], "ratio", "higher", target, note)
    yield row_of(f"mrays_per_s_{suffix}", million / s["ours"], "Mrays/s", "higher", note=note)
    yield row_of(f"embree_mrays_per_s_{suffix}", million / s["bare"], "Mrays/s", "higher", note=note)


def exponents(counts: tuple[int, ...], seconds: F64) -> F64:
    """Slope (repeats,) of log seconds (counts, repeats) over log counts, by least squares."""
    return np.asarray(np.polyfit(np.log(counts), np.log(seconds), 1)[0])


def time_exponent(progress: Progress, counts: tuple[int, ...] = RAY_COUNTS, repeats: int = 5) -> Iterator[Row]:
    """How time grows with rays."""
    g, p = patched(*HOUSE_2K)
    s = interleaved({str(n): ours(g, p, n) for n in counts}, repeats, progress, "time against rays")
    note = f"house, {p.count} patches, {counts[0]} to {counts[-1]} rays per patch"
    found = exponents(counts, np.stack([s[str(n)] for n in counts]))
    yield row_of("rays_time_exponent", found, "exponent", "lower", 1.1, note)


def _embree(place: tuple[str, float], suffix: str, target: float | None, repeats: int) -> Group:
    def measure(wanted: Wanted, progress: Progress) -> Iterator[Row]:
        del wanted
        return against_embree(place, suffix, target, repeats, progress)

    return Group(tuple(f"{kind}_{suffix}" for kind in ("rays_vs_embree", "mrays_per_s", "embree_mrays_per_s")), measure)


GROUPS = (
    _embree(HOUSE_2K, "2k", 0.8, 7),
    _embree(HOUSE_20K, "20k", 0.6, 5),
    _embree(CORNELL_2K, "2k_cornell", None, 5),
    Group(("rays_time_exponent",), lambda wanted, progress: time_exponent(progress)),
)
