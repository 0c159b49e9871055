"""G5, G6: kernels compiled and memory kept while the same work is done again and again with other lights."""

from __future__ import annotations

import dataclasses
import gc
import mmap
from collections.abc import Callable, Mapping
from functools import cache
from pathlib import Path

from .case import Reading

COARSE = {"placement": {"min_voxel": 0.28, "probe_rays": 128}, "radiosity": {"patch_size": 0.2, "rays": 128}}
KEPT_BYTES = 1 << 16
PAGE_KIB = 4


@cache
def warm() -> Callable[[int], None]:
    """One iteration of the product's own loop on the coarse Cornell box: light of that number's colour through patches, probes and
    tiles to samples. Warm: a few have been done."""
    from ...fastpath.device import open_device
    from ...reference import pipeline
    from ...reference.progress import silent
    from ...reference.scene import load_scene
    from ...reference.variant import ensure_variant
    from ..bake import bake
    from ..sources import resolve_scene

    ensure_variant()
    scene = load_scene(resolve_scene("cornell"), COARSE)
    surfaces = pipeline.bake_surfaces(scene, 0)
    light = pipeline.light_patches(scene, surfaces, 0)
    baked = bake(scene, open_device(), (surfaces, light), pipeline.place(scene, surfaces, 0), 0, silent)
    points = baked.texture.origin + 0.2 + surfaces.patches.centroid * 0.0
    normals = surfaces.patches.normal

    def once(number: int) -> None:
        brighter = 1.0 + 0.01 * number
        meshes = tuple(dataclasses.replace(m, emission=m.emission * brighter) for m in scene.meshes)
        lit = dataclasses.replace(scene, meshes=meshes)
        now = pipeline.light_patches(lit, surfaces, number)
        pipeline.update(lit, surfaces, baked.probes, now)
        baked.sampler(points, normals)

    for number in range(4):
        once(number)
    return once


def compiled(iterations: float, seed: int) -> Mapping[str, Reading]:
    """G5: kernels that were compiled in so many iterations after the first few; the same for a loop with a literal, and for an
    opaque one."""
    once = warm()
    import drjit as dr
    import mitsuba as mi

    n = int(iterations)
    made = {"ours": misses(lambda k: once(100 * n + k), n)}

    def literal(k: int) -> None:
        dr.eval(dr.arange(mi.Float, 16) * (1000.0 * n + k + 0.5 + 1e-3 * seed))

    def opaque(k: int) -> None:
        dr.eval(dr.arange(mi.Float, 16) * dr.opaque(mi.Float, 1000.0 * n + k))

    opaque(0)
    return {
        "kernels compiled": Reading(made["ours"], n=n),
        "with a literal": Reading(misses(literal, n), n=n),
        "with dr.opaque": Reading(misses(opaque, n), n=n),
    }


def misses(work: Callable[[int], None], times: int) -> int:
    """Kernels among those launched by `work(0)` … that Dr.Jit did not have in memory: one that it finds on disk, from an earlier run,
    would have been compiled in that run's loop just so."""
    import drjit as dr

    with dr.scoped_set_flag(dr.JitFlag.KernelHistory, True):
        dr.kernel_history_clear()
        for k in range(times):
            work(k)
        found = dr.kernel_history([dr.KernelType.JIT])
    return sum(not kernel["cache_hit"] or kernel["cache_disk"] for kernel in found)


def grown(iterations: float, seed: int) -> Mapping[str, Reading]:
    """G6: MiB that resident memory grew by per 100 iterations; beside it a loop that keeps 64 KiB each time."""
    once = warm()
    n = int(iterations)
    for k in range(10):
        once(k)
    ours = growth(once, n)
    kept: list[mmap.mmap] = []

    def keep(_: int) -> None:  # fresh pages: the allocator has freed ones left, which would hide them
        kept.append(mmap.mmap(-1, KEPT_BYTES))
        kept[-1].write(b"\x01" * KEPT_BYTES)

    leak = growth(keep, n)
    return {"memory kept": Reading(ours * 100.0 / n, n=n), "64 KiB kept each time": Reading(leak * 100.0 / n, n=n)}


def growth(work: Callable[[int], object], times: int) -> float:
    """MiB of resident memory after `times` times more than before."""
    gc.collect()
    before = resident_pages()
    for k in range(times):
        work(k)
    gc.collect()
    return (resident_pages() - before) * PAGE_KIB / 1024.0


def resident_pages() -> int:
    """Pages of this process in memory (Linux)."""
    return int(Path("/proc/self/statm").read_text(encoding="ascii").split()[1])
