"""Culled probes whose parents are culled (failure-catalogue D7): judged against what is reconstructed there, or against what once
was.

The light makes it as bad as can be: at every level each new probe is brighter by the same small step than what its parents
interpolate (as in Takagi's curve, but without its halving). Judged against its own parents each may go; with all of them gone the
steps add up."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping

import numpy as np
from scipy import sparse

from ...reference.datatypes import F32, F64, Bool
from ...reference.lattice import OCTANTS, Octree
from ...reference.placement.culling import Candidates, damage, replaced
from ...reference.placement.norms import MEAN_SQUARE, NORMS
from ...reference.placement.parents import find_parents
from ...reference.volume.layout import build_layout
from ...reference.volume.linear import texel_matrix
from ...reference.volume.sampler import resolve
from .case import Reading
from .trees import every_cell, filled, tree_of

STEP = 0.01  # by which a probe differs from its parents
ROOM = 1.02  # allowed over that step
AROUND = np.stack(np.meshgrid(*[np.arange(-2, 2)] * 3, indexing="ij"), axis=-1).reshape(-1, 3)


def nested(depth: int) -> Octree:
    """Everything to level 1; below that, 4×4×4 voxels a level around a place off the middle, `depth` levels of probes that may be
    culled."""
    voxels = [every_cell(0), every_cell(1), every_cell(2)]
    place = np.array([2, 2, 2])
    for level in range(3, depth + 2):
        place = 2 * place + OCTANTS[1 if level % 2 else 6]
        found = place + AROUND
        parents = {tuple(v) for v in voxels[-1].tolist()}
        voxels.append(found[[tuple(v) in parents for v in (found >> 1).tolist()]])
    return tree_of(voxels)


def chains(depth: float, seed: int) -> Mapping[str, Reading]:
    """Largest error at a culled probe, as the texture without it reads there, over what was allowed for each: `ours`, and `plain`,
    where all go that pass beside their real parents. twin: largest error of what the product judged by, beside the texture. culled:
    share of those able that ours takes away."""
    del seed
    tree = nested(round(depth))
    c, light = _candidates(tree)
    threshold = float(np.pi / 4.0 * (ROOM * STEP) ** 2)
    able = np.flatnonzero(c.able)
    wanted = np.zeros(len(c.able), dtype=np.bool_)
    wanted[able[damage(c, c.parents[able], able) <= threshold]] = True
    mix, culled = replaced(c, wanted, threshold)
    plain_mix, plain = replaced(c, wanted)
    ours, all_of_them = (_errors(tree, light, gone) for gone in (culled, plain))
    judged = [np.abs(m @ light - light)[gone] for m, gone in ((mix, culled), (plain_mix, plain))]
    twin = max(float(np.abs(j - e).max()) for j, e in zip(judged, (ours, all_of_them), strict=True))
    allowed = ROOM * STEP
    return {
        "ours": Reading(float(ours.max()) / allowed, 0.0, len(ours)),
        "plain": Reading(float(all_of_them.max()) / allowed, 0.0, len(all_of_them)),
        "twin": Reading(twin / allowed, 0.0, len(all_of_them)),
        "culled": Reading(float(culled.sum() / len(able)), 0.0, len(able)),
    }


def _candidates(tree: Octree) -> tuple[Candidates, F64]:
    """All probes valid and read equally; one column of form factors, which is their light (R,) too."""
    layout, count = build_layout(tree), len(tree.corners)
    valid = np.ones(count, dtype=np.bool_)
    parents = find_parents(tree, layout.parents, texel_matrix(layout, np.arange(count, dtype=np.int32)), valid)
    light = np.ones(count)
    for level in range(2, tree.grid.level + 1):
        mine = np.flatnonzero(parents.able & (tree.corner_level == level))
        light[mine] = parents.weights[mine] @ light + STEP
    rows = sparse.csr_array(
        (light.astype(np.float32), (np.arange(count), np.zeros(count, np.int64))), shape=(count, len(MEAN_SQUARE))
    )
    one = np.ones(1)
    return Candidates(
        tree.corner_level, parents.able, parents.weights, NORMS["l2"], rows, None, one, np.ones(count)
    ), light


def _errors(tree: Octree, light: F64, culled: Bool) -> F64:
    """|light - what the texture without the culled probes reads| at those probes, (n,)."""
    stay = ~culled
    fewer = dataclasses.replace(tree, corners=tree.corners[stay], corner_level=tree.corner_level[stay])
    probes: F32 = np.ones((int(stay.sum()), 13), dtype=np.float32)
    probes[:, :12] = light[stay, None]
    texture = filled(fewer, probes).texture
    at = tree.corners[culled].astype(np.float64)
    read, weight, _ = resolve(texture, at, at, texture.level)
    return np.abs(read[:, 0] / weight - light[culled]).astype(np.float64)
