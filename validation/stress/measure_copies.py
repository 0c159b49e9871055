"""Light copied into dead edges (failure-catalogue D6): before virtual probes are made, the same in every tile, never through a
wall."""

from __future__ import annotations

import math
from collections.abc import Mapping
from unittest import mock

import numpy as np

from ...reference.config_placement import PlacementSettings
from ...reference.datatypes import F32, F64, I32, Bool, Mesh
from ...reference.lattice import Octree, make_grid
from ...reference.placement import dead_edges
from ...reference.placement.octree import uniform_octree
from ...reference.placement.validity import back_share
from ...reference.variant import ensure_variant
from ...reference.visibility import Geometry, build_geometry
from ...reference.volume.sampler import sample
from ...reference.volume.tiles import probe_texels, with_copies
from ..metrics.seams import measure_seams, seam_points
from .case import Reading
from .scenes import box, scene_of
from .trees import Filled, filled, random_tree

VOXEL = 0.5
ROOM = 4.0
TOLERANCE = PlacementSettings().backface_tolerance
PLACES = 6000
Placed = tuple[Geometry, Octree, Bool]
Corner = tuple[float, float, float]


def copies(thickness: float, seed: int) -> Mapping[str, Reading]:
    """A lit room and a sealed one, whose wall of `thickness` m has a block just behind it; and a block with a slot as wide; a
    sealed crack of 0.2 m behind a wall 0.3 m thicker, which holds no probe.

    leak_…: most light that copies bring to a place of the sealed room, over the light beyond: `ours`, and `unbarred`, where a
    neighbour may always lend; crack_…: the same in the crack. mended: share of dead edges across the slot's mouths on which a
    sample finds light without asking a coarser level. seam_…: largest seam in a tree with copies: `ours`; `late`, copied after
    virtual probes were made; `apart`, each tile choosing for itself."""
    ensure_variant()
    behind = 2.0 + thickness
    p, beyond = _placed(_two_rooms(behind), 0.35, seed), ((behind, 0, 0), (ROOM, ROOM, ROOM))
    crack = (2.3 + thickness, 0.5, 0.5), (2.5 + thickness, 3.5, 3.5)
    q = _placed([_lit(), box(*crack)], VOXEL, seed)
    found = {
        "leak_ours": _leak(p, beyond, _lenders(p, seed), seed),
        "crack_ours": _leak(q, crack, _lenders(q, seed), seed),
    }
    with (
        mock.patch.object(dead_edges, "allowed", lambda g, tree, valid, pairs: np.ones(len(pairs), np.bool_)),
        mock.patch.object(dead_edges, "crossings", _no_walls),
    ):
        free, free_crack = _lenders(p, seed), _lenders(q, seed)
    found |= {"leak_unbarred": _leak(p, beyond, free, seed), "crack_unbarred": _leak(q, crack, free_crack, seed)}
    found["mended"] = _mended(_placed(_slot(thickness), VOXEL, seed), seed)
    return found | _seams(seed)


class _Clear:
    """What `segments.crossings` gives where no surface is."""

    def __init__(self, count: int) -> None:
        self.through = np.zeros(count, dtype=np.bool_)


def _no_walls(g: Geometry, start: F64, end: F64) -> _Clear:
    del g, end
    return _Clear(len(start))


def _lit() -> Mesh:
    return box((0, 0, 0), (2, ROOM, ROOM))


def _block(low: Corner, high: Corner) -> Mesh:
    return box(low, high, inward=False)


def _two_rooms(behind: float) -> list[Mesh]:
    return [
        _lit(), box((behind, 0, 0), (ROOM, ROOM, ROOM)),
        _block((behind + 0.05, 0.6, 0.6), (2.9, 3.4, 3.4)), _block((3.1, 0.6, 0.6), (3.95, 3.4, 3.4)),
    ]  # fmt: skip


def _slot(width: float) -> list[Mesh]:
    """Two blocks with a slot between them, in the middle between two columns of probes: edges across it have both ends in the
    blocks."""
    low, high = 2.0 - 0.5 * width, 2.0 + 0.5 * width
    return [
        box((0, 0, 0), (ROOM, ROOM, ROOM)),
        _block((0.5, 0.6, 0.6), (low, 2.2, 3.4)), _block((high, 0.6, 0.6), (3.5, 2.2, 3.4)),
    ]  # fmt: skip


def _placed(meshes: list[Mesh], voxel: float, seed: int) -> Placed:
    """Geometry, a uniform grid over it, and which of its probes are valid."""
    g = build_geometry(scene_of(meshes))
    tree = uniform_octree(make_grid(g.lower, g.upper, voxel))
    return g, tree, back_share(g, tree.positions, seed) <= TOLERANCE


def _lenders(p: Placed, seed: int) -> I32:
    return dead_edges.light_from(*p, TOLERANCE, seed)


def _leak(p: Placed, dark: tuple[Corner, Corner], source: I32, seed: int) -> Reading:
    """Largest share of the light at a place between two corners of something sealed that comes from copies of the lit room's probes, of
    light 1: weights of a sample do not depend on light, so what copies add is what they alone would give."""
    g, tree, valid = p
    lent = (source >= 0) & ~valid & (tree.positions[np.maximum(source, 0), 0] < 2.0)
    light = np.zeros((len(valid), 4, 3), dtype=np.float32)
    light[lent, 0] = 1.0
    rng = np.random.default_rng([seed, 116])
    places = rng.uniform(*dark, (PLACES, 3))
    places = places[back_share(g, places, seed + 1) <= TOLERANCE]
    got = sample(filled(tree, probe_texels(light, source >= 0)).texture, places, np.zeros_like(places))
    one = 0.5 * math.sqrt(math.pi)  # irradiance, in the mean over normals, of L00 = 1
    return Reading(float(got.irradiance.max()) / one, 0.0, len(places))


def _mended(p: Placed, seed: int) -> Reading:
    """Of the finest dead edges at the slot's upper mouth: share that find light at the finest level."""
    g, tree, valid = p
    source = _lenders(p, seed)
    edges = dead_edges.exposed(g, tree, dead_edges.dead_edges(tree, valid), TOLERANCE, seed)
    ends = tree.positions[edges.ends]
    at_mouth = (
        (edges.level == tree.grid.level) & (ends[:, 0, 1] > 2.2 - 0.5) & ((ends[:, :, 0] - 2.0).prod(axis=1) < 0.0)
    )
    lit = (source[edges.ends[at_mouth]] >= 0).any(axis=1)
    return Reading(float(lit.mean()) if len(lit) else 0.0, 0.0, len(lit))


def _seams(seed: int) -> dict[str, Reading]:
    """Seams with a third of the probes invalid, half of which take some valid probe's light."""
    rng = np.random.default_rng([seed, 117])
    tree = random_tree(5, 0.4, rng)
    count = len(tree.corners)
    valid = rng.random(count) > 0.35
    own = np.where(valid, np.arange(count), -1).astype(np.int32)
    lender = rng.choice(np.flatnonzero(valid), count).astype(np.int32)
    source = np.where(~valid & (rng.random(count) < 0.5), lender, own).astype(np.int32)
    light = rng.random((count, 4, 3)).astype(np.float32)
    light[:, 0] += 1.0
    ours, without = (filled(tree, probe_texels(*with_copies(light, s))) for s in (source, own))
    points = seam_points(ours.texture, None, seed)
    variants = {"ours": ours.texture.texels, "late": _late(ours, without), "apart": _apart(ours, rng)}
    return {
        f"seam_{name}": Reading(measure_seams(ours.holding(texels), points)["seam_sup"].value, 0.0, len(points.q))
        for name, texels in variants.items()
    }


def _late(ours: Filled, without: Filled) -> F32:
    """Virtual probes made before the copies: they know nothing of them."""
    real = np.concatenate(ours.layout.probe) >= 0
    return np.where(real[..., None], ours.texture.texels, without.texture.texels)


def _apart(ours: Filled, rng: np.random.Generator) -> F32:
    """Each tile lends to its invalid texels by itself: some other valid texel of the tile."""
    texels = ours.texture.texels.copy()
    for tile in texels:
        invalid, valid = np.flatnonzero(tile[:, 12] == 0.0), np.flatnonzero(tile[:, 12] == 1.0)
        if len(valid):
            tile[invalid] = tile[rng.choice(valid, len(invalid))]
    return texels
