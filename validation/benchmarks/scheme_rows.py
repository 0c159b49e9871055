"""What the parts of placement save on house, and what they cost in error: child-only probes, the surface bitmap, the threshold.

`child_only_*`: against plain 3×3×3 subdivision, as mean over random lattices and on the scene's own. `bitmap_*`: the scene's
voxel bitmap, with a resolution for each mesh and volume, against subdividing to the finest size wherever the harmonic mean is short.
`surface_bitmap_*`: a bitmap of all surfaces at one
resolution (SURFACE_VOXEL) against none, so occupancy alone: half a voxel of margin for the sample offset leaves it next
to nothing to save.
`threshold_T_*`: a plane reads 4 h, so thresholds under 1.75 voxel sizes miss walls and make the error depend on where the lattice
falls: the spread is that over SHIFTS of it. `harmonic_saving_house`: probes that the default threshold saves against the
bitmap alone (threshold ∞).
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator
from typing import Any

import numpy as np

from ...fastpath.device import OpenDevice, open_device
from ...reference import pipeline
from ...reference.datatypes import F64, Scene
from ...reference.lattice import Grid, Octree, keys, make_grid
from ...reference.placement.octree import build_octree
from ...reference.placement.voxel_bitmap import VoxelBitmap
from ...reference.progress import Progress
from ...reference.variant import ensure_variant
from ..efficiency.curve import Key
from ..efficiency.judged import Judge, judges
from ..efficiency.placements import Place, Reached, adaptive, random_shifts, reached
from ..ground_truth import GroundTruth, ground_truth
from .places import bundled
from .rows import Group, Row, Wanted

SHIFTS, SEED = 4, 0
COUNTED = 16  # placements at which probes of both schemes are counted, and nothing is baked
SURFACE_VOXEL = 0.5  # m
THRESHOLDS = (1.0, 1.5, 1.75, 2.0, 2.5, 3.0)
EVERYWHERE = 1e9  # a threshold that no distance exceeds
KEY: Key = ("camera", "total")
CHILD_ROWS = ("child_only_saving_house", "child_only_saving_house_own_lattice", "child_only_error_raise_house")
BITMAP_ROWS = (
    "bitmap_saving_house",
    "bitmap_error_raise_house",
    "surface_bitmap_saving_house",
    "surface_bitmap_error_raise_house",
)
SWEEP_ROWS = (
    *(f"threshold_{t:g}_{what}" for t in THRESHOLDS for what in ("relrmse", "probes")),
    "harmonic_saving_house",
)


@dataclasses.dataclass(frozen=True, eq=False)
class Bench:
    """House, lit, and what is asked of it."""

    scene: Scene
    device: OpenDevice
    lit: tuple[pipeline.Surfaces, pipeline.PatchLight]
    truth: GroundTruth
    asked: list[Judge]
    shifts: F64
    progress: Progress

    def of(self, scene: Scene, place: Place = adaptive) -> Reached:
        """Placements of the scene with other settings."""
        return reached(scene, self.device, self.lit, self.truth, self.asked, self.shifts, SEED, self.progress, place)


def bench(progress: Progress) -> Bench:
    """The bench on house."""
    ensure_variant()
    scene = bundled("house")
    truth = ground_truth(scene, SEED, progress)
    surfaces = pipeline.bake_surfaces(scene, SEED, progress)
    lit = (surfaces, pipeline.light_patches(scene, surfaces, SEED, progress))
    shifts = random_shifts(scene, surfaces, SHIFTS, SEED)
    return Bench(scene, open_device(), lit, truth, list(judges(scene, truth, ("camera",))), shifts, progress)


def changed(scene: Scene, **placement: Any) -> Scene:
    """The scene with other placement settings, without culling: what is asked here is where probes are placed."""
    settings = scene.settings.placement.model_copy(update={"cull_error": None, **placement})
    return dataclasses.replace(scene, settings=scene.settings.model_copy(update={"placement": settings}))


def measured(wanted: Wanted, progress: Progress) -> Iterator[Row]:
    """The rows asked for. The scene's own placements, without culling, are in all of them and are baked once."""
    b = bench(progress)
    own = b.of(changed(b.scene))
    if wanted & set(CHILD_ROWS):
        yield from child_only(b, own)
    if wanted & set(BITMAP_ROWS):
        yield from bitmap(b, own)
    if wanted & set(SWEEP_ROWS):
        yield from threshold_sweep(b, own)


def child_only(b: Bench, own: Reached) -> Iterator[Row]:
    """Three rows. What is saved needs no light, so it is counted at COUNTED placements; the error at SHIFTS of them."""
    random = random_shifts(b.scene, b.lit[0], COUNTED, SEED)
    counts = np.array([_counts(b, shift) for shift in (None, *random)], dtype=np.float64)
    saved = 1.0 - counts[:, 0] / counts[:, 1]
    plain = b.of(changed(b.scene, subdivision="plain"))
    note = f"child-only: {counts[0, 0]:.0f} probes; plain 3×3×3: {counts[0, 1]:.0f}; the scene's own lattice"
    yield Row(CHILD_ROWS[1], float(saved[0]), "share", None, "higher", 0.0, 1, note)
    spread = float(saved[1:].std(ddof=1) / np.sqrt(COUNTED))
    note = f"{COUNTED} random lattices, {saved[1:].min():.1%} to {saved[1:].max():.1%}"
    yield Row(CHILD_ROWS[0], float(saved[1:].mean()), "share", 0.25, "higher", spread, COUNTED, note)
    yield _raise(CHILD_ROWS[2], own, plain, 0.02, "child-only", "plain 3×3×3")


def _counts(b: Bench, shift: F64 | None) -> tuple[int, int]:
    """Probes of both schemes. shift: of the lattice, None for the scene's own."""
    tree = pipeline.place(b.scene, b.lit[0], SEED) if shift is None else adaptive(b.scene, b.lit[0], shift)
    return len(tree.corners), tree.plain_probes


def bitmap(b: Bench, own: Reached) -> Iterator[Row]:
    """Four rows."""
    unmarked = b.of(changed(b.scene), _without_bitmap)
    yield from _against(BITMAP_ROWS[:2], own, unmarked, (0.12, 0.02), "voxel bitmap", "no bitmap")
    one_size = changed(_one_resolution(b.scene), min_voxel=SURFACE_VOXEL)
    marked, everywhere = b.of(one_size), b.of(one_size, _without_bitmap)
    yield from _against(BITMAP_ROWS[2:], marked, everywhere, (None, None), "surface bitmap", "no bitmap")


def _one_resolution(scene: Scene) -> Scene:
    """No mesh and no volume asks for a resolution of its own."""
    meshes = tuple(dataclasses.replace(m, probe_size=None) for m in scene.meshes)
    return dataclasses.replace(scene, meshes=meshes, settings=scene.settings.model_copy(update={"volumes": {}}))


def _without_bitmap(scene: Scene, surfaces: pipeline.Surfaces, shift: F64) -> Octree:
    """Subdivided wherever the harmonic mean is short."""
    s = scene.settings.placement
    grid = make_grid(*pipeline.probe_bounds(scene, surfaces.geometry), s.min_voxel, shift)
    return build_octree(
        surfaces.geometry,
        grid,
        VoxelBitmap(tuple(_all_voxels(grid, level) for level in range(grid.level + 1))),
        s,
        SEED,
    )


def _all_voxels(grid: Grid, level: int) -> Any:
    axes = [np.arange(n + 1) for n in grid.last(level)]
    return np.sort(keys(np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)))


def _against(
    rows: tuple[str, ...], ours: Reached, other: Reached, targets: tuple[float | None, float | None], us: str, them: str
) -> Iterator[Row]:
    """Share of probes saved, and raise of the error, of `ours` against `other`."""
    saved = 1.0 - ours.cost["probes"] / other.cost["probes"]
    note = f"{us}: {ours.cost['probes']:.0f} probes; {them}: {other.cost['probes']:.0f}; {SHIFTS} random placements of both"
    yield Row(rows[0], saved, "share", targets[0], "higher", 0.0, SHIFTS, note)
    yield _raise(rows[1], ours, other, targets[1], us, them)


def _raise(name: str, ours: Reached, other: Reached, target: float | None, us: str, them: str) -> Row:
    """By how much of itself the error of `ours` is above that of `other`; the spread is that of the placements, one by one."""
    raised = ours.error[KEY].value / other.error[KEY].value - 1.0
    each = np.array(ours.each[KEY]) / np.array(other.each[KEY])
    note = (
        f"{us}: {ours.cost['probes']:.0f} probes, {ours.error[KEY].value:.2%}; {them}: {other.cost['probes']:.0f}, "
        f"{other.error[KEY].value:.2%}; camera points, {SHIFTS} random placements of both"
    )
    return Row(name, raised, "share", target, "lower", float(each.std(ddof=1) / np.sqrt(SHIFTS)), SHIFTS, note)


def threshold_sweep(b: Bench, own: Reached) -> Iterator[Row]:
    """Error and probes by threshold, and what the harmonic mean saves beyond plain occupancy."""
    default = b.scene.settings.placement.threshold
    for threshold in THRESHOLDS:
        found = own if threshold == default else b.of(changed(b.scene, threshold=threshold))
        errors = np.array(found.each[KEY])
        name, note = f"threshold_{threshold:g}", "spread: standard deviation over random placements"
        yield Row(
            f"{name}_relrmse", float(errors.mean()), "share", None, "lower", float(errors.std(ddof=1)), SHIFTS, note
        )
        yield Row(f"{name}_probes", found.cost["probes"], "probes", None, "lower", 0.0, SHIFTS)
    occupied = changed(b.scene, threshold=EVERYWHERE)
    every = float(np.mean([len(adaptive(occupied, b.lit[0], shift).corners) for shift in b.shifts]))
    note = f"threshold {default:g} against the bitmap alone: {every:.0f} probes"
    yield Row("harmonic_saving_house", 1.0 - own.cost["probes"] / every, "share", None, "higher", 0.0, SHIFTS, note)


GROUPS = (Group((*CHILD_ROWS, *BITMAP_ROWS, *SWEEP_ROWS), measured),)
