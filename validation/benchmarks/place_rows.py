"""Placing probes: how long, whether the cost of a corner grows with their number, how near to Embree, and how much memory.

    valley_place_s             bitmap, octree, tiles and indirection of `valley`, all of it at 1 m; scene and ray caster are there
    corner_cost_ratio_1e6_1e4  (time / corners tested) of its octree at 0.7 m over the same of pieces with about 1e4 corners each
    corner_rays_vs_embree      (rays / time of harmonic_mean) / (rays / time of the bare queries), the same rays in memory
    memory_per_probe_bytes     bytes of octree, layout, indirection and form factor rows over real probes, of a bake of `valley`

The floor of placing is its rays at Embree's own rate: 64 for each corner tested, fewer where the answer is known early. Pieces
are the same voxels with the same geometry around them, cut out of the bitmap: all together they are the same work. The ratio is
under 1, since every octree, however small, launches some fifty kernels (0.1 s of processor time).
"""

from __future__ import annotations

import dataclasses
import time
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

from ...reference import pipeline
from ...reference.config_placement import PlacementSettings
from ...reference.datatypes import F64, Scene
from ...reference.lattice import Grid, Octree, cells, distinct, make_grid, parent_keys
from ...reference.placement.distance import corner_rays, harmonic_mean
from ...reference.placement.octree import build_octree
from ...reference.placement.voxel_bitmap import VoxelBitmap
from ...reference.progress import Progress
from ...reference.visibility import Geometry, build_geometry
from ...reference.volume.indirection import build_indirection
from ...reference.volume.layout import build_layout
from .places import bundled
from .ray_rows import query_seconds
from .rows import Group, Row, Wanted, row_of
from .timing import interleaved, timed

VOXEL, MILLION_VOXEL = 1.0, 0.7  # m: as the time is asked for, and with 1e6 corners
SEED, REPEATS = 1, 3
PIECES = 13  # along each side of the valley, about 1e4 corners each
SAMPLE = 100_000  # corners whose rays are traced bare, too
STAGES = ("bitmap", "octree", "layout", "indirection")


@dataclass(frozen=True, eq=False)
class Place:
    """A scene ready to be placed."""

    scene: Scene
    geometry: Geometry
    grid: Grid
    settings: PlacementSettings


def fine_valley(voxel: float = VOXEL) -> Place:
    """`valley` with everything, volumes too, at voxels of `voxel` m."""
    scene = bundled("valley")
    settings = scene.settings.model_copy(
        update={
            "volumes": {k: v.model_copy(update={"probe_size": voxel}) for k, v in scene.settings.volumes.items()},
            "placement": scene.settings.placement.model_copy(update={"min_voxel": voxel, "max_probes": 10_000_000}),
        }
    )
    meshes = tuple(dataclasses.replace(mesh, probe_size=voxel) for mesh in scene.meshes)
    scene = dataclasses.replace(scene, settings=settings, meshes=meshes)
    g = build_geometry(scene)
    return Place(scene, g, make_grid(*pipeline.probe_bounds(scene, g), voxel), settings.placement)


def staged(p: Place, progress: Progress, repeats: int = REPEATS) -> Iterator[Row]:
    """Seconds of the whole, with those of its stages in the note."""
    seconds = np.zeros((repeats + 1, len(STAGES)))
    for repeat in range(repeats + 1):  # the first compiles
        progress("placing", repeat, repeats + 1)
        tree, layout, seconds[repeat] = _place(p)
    progress("placing", repeats + 1, repeats + 1)
    each = ", ".join(f"{name} {s:.2f} s" for name, s in zip(STAGES, np.median(seconds[1:], axis=0), strict=True))
    probes = len(tree.corners)
    note = (
        f"valley, voxels of {p.grid.finest:g} m: {probes} probes, {tree.corners_tested} corners tested, {layout.tiles} tiles; {each}; "
        f"plain subdivision would place {tree.plain_probes} probes, {1 - probes / tree.plain_probes:.1%} are saved"
    )
    yield row_of("valley_place_s", seconds[1:].sum(axis=1), "s", "lower", 10.0, note)


def _place(p: Place) -> tuple[Octree, Any, F64]:
    """Octree, layout, and the seconds of each stage."""
    at = [time.perf_counter()]
    marks = pipeline.bitmap(p.scene, p.grid)
    at.append(time.perf_counter())
    tree = build_octree(p.geometry, p.grid, marks, p.settings, SEED)
    at.append(time.perf_counter())
    layout = build_layout(tree)
    at.append(time.perf_counter())
    build_indirection(layout)
    return tree, layout, np.diff([*at, time.perf_counter()])


def pieces(marks: VoxelBitmap, grid: Grid, sides: int) -> list[VoxelBitmap]:
    """The bitmap's finest voxels in `sides` × `sides` columns, x by z, each with those that hold them; empty columns left out."""
    key = marks.occupied[-1]
    column = cells(key)[:, [0, 2]] // -(-grid.extent[[0, 2]] // sides) @ np.array([sides, 1])
    found = []
    for number in np.unique(column):
        levels = [key[column == number]]
        for _ in marks.occupied[1:]:
            levels.append(distinct(parent_keys(levels[-1])))
        found.append(VoxelBitmap(tuple(reversed(levels))))
    return found


def corner_cost(p: Place, progress: Progress, sides: int = PIECES, repeats: int = REPEATS) -> Iterator[Row]:
    """What a corner costs among many and among few."""
    marks = pipeline.bitmap(p.scene, p.grid)
    parts = pieces(marks, p.grid, sides)

    tested: dict[str, list[int]] = {}

    def build(name: str, bitmaps: list[VoxelBitmap]) -> None:
        tested[name] = [build_octree(p.geometry, p.grid, m, p.settings, SEED).corners_tested for m in bitmaps]

    tasks = {"many": timed(lambda: build("many", [marks])), "few": timed(lambda: build("few", parts))}
    s = interleaved(tasks, repeats, progress, "cost of a corner")
    each = {name: s[name] / sum(tested[name]) for name in tasks}
    many, few = tested["many"][0], tested["few"]
    note = (
        f"valley, voxels of {p.grid.finest:g} m: all of it, {many} corners tested at {1e6 * np.median(each['many']):.2f} µs, against "
        f"{len(few)} pieces of {min(few)} to {max(few)} at {1e6 * np.median(each['few']):.2f} µs; whole octrees, the bitmap is there"
    )
    yield row_of("corner_cost_ratio_1e6_1e4", each["many"] / each["few"], "ratio", "lower", 1.25, note)


def against_embree(p: Place, progress: Progress, sample: int = SAMPLE, repeats: int = REPEATS) -> Iterator[Row]:
    """The kernel with all its rays against bare queries for the same rays, at corners of the finest occupied voxels."""
    finest = pipeline.bitmap(p.scene, p.grid).occupied[-1]
    first = len(finest) // 3  # neighbours in memory, as octrees ask for them, from the middle of the valley
    key = finest[first : first + sample]
    where, rays = p.grid.corner_positions(cells(key)), p.settings.rays
    origins, directions = corner_rays(p.geometry, where, key, rays, SEED)
    tasks = {
        "ours": timed(lambda: harmonic_mean(p.geometry, where, key, rays, SEED)),
        "bare": lambda repeat: query_seconds(p.geometry, origins, directions),
    }
    s = interleaved(tasks, repeats, progress, "corners against Embree")
    million = 1e-6 * len(key) * rays
    note = f"{len(key)} corners, {rays} rays each; ours {million / np.median(s['ours']):.1f} Mrays/s, whole function"
    yield row_of("corner_rays_vs_embree", s["bare"] / s["ours"], "ratio", "higher", note=note)


def array_bytes(*things: Any) -> int:
    """Bytes of all arrays in dataclasses, and in tuples in them."""
    total = 0
    for thing in things:
        for field in dataclasses.fields(thing):
            value = getattr(thing, field.name)
            for array in value if isinstance(value, tuple) else (value,):
                total += array.nbytes if isinstance(array, np.ndarray) else 0
    return total


def memory(scene: Scene, progress: Progress) -> Iterator[Row]:
    """Bytes per real probe of a bake at the scene's own settings."""
    surfaces = pipeline.bake_surfaces(scene, SEED, progress)
    probes = pipeline.bake_probes(scene, surfaces, pipeline.place(scene, surfaces, SEED), SEED, progress)
    count = len(probes.octree.corners)
    parts = {
        "octree": array_bytes(probes.octree),
        "layout": array_bytes(probes.layout),
        "indirection": array_bytes(probes.indirection),
        "rows": probes.rows.bytes,
    }
    each = ", ".join(f"{name} {size / count:.0f}" for name, size in parts.items())
    virtual = probes.layout.virtual_probes
    note = f"{scene.name}, {count} real and {virtual} virtual probes; {each}; standard errors of the rows and texels not counted"
    yield row_of("memory_per_probe_bytes", sum(parts.values()) / count, "B", "lower", note=note)


def _of_valley(wanted: Wanted, progress: Progress) -> Iterator[Row]:
    p = fine_valley()
    if "valley_place_s" in wanted:
        yield from staged(p, progress)
    if "corner_cost_ratio_1e6_1e4" in wanted:
        yield from corner_cost(fine_valley(MILLION_VOXEL), progress)
    if "corner_rays_vs_embree" in wanted:
        yield from against_embree(p, progress)


GROUPS = (
    Group(("valley_place_s", "corner_cost_ratio_1e6_1e4", "corner_rays_vs_embree"), _of_valley),
    Group(("memory_per_probe_bytes",), lambda wanted, progress: memory(bundled("valley"), progress)),
)
