"""The eight probes that a sample reads: where they stand, what they are, how much they count and what each gives.

    E = Σ_i g_i,   g_i = s_i (E-weights · premultiplied light_i) / Σ_j s_j w_j

s trilinear, w the texel's weight, both as the run samples them: of the level that the pixel's camera gets, from texels as they are
stored. For a reconstruction that is not linear this is its linear part; what it adds is said apart.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ...reference.datatypes import F64
from ...reference.lattice import OCTANTS
from ...reference.reconstruction import irradiance
from ...reference.sh import irradiance_weights
from ...reference.texture_types import WEIGHT, Viewer
from ...reference.volume.layout import TEXEL_OFFSETS
from ...reference.volume.levels import ring_lod
from ...reference.volume.sampler import lattice_position, locate, resolve, tile_cell
from ..leaks.attribution import crossings
from ..leaks.weights import VOXEL_TEXELS, probe_weights
from ..waterfall.world import World

MOST_BEHIND = 16  # real probes that are listed


@dataclass(frozen=True, eq=False)
class Corners:
    """level that answers; asked: the finest level there that may serve. position (8, 3) m; real (8,) i64: number of the probe, -1 for a
    virtual one; share (8,) trilinear; weight (8,) of the texel: its validity; gives (8, 3) W·m⁻²; rest (3,): what the reconstruction
    adds to their sum. voxel, m."""

    level: int
    asked: int
    voxel: float
    position: F64
    real: list[int]
    share: F64
    weight: F64
    gives: F64
    rest: F64


def viewer_lod(w: World, where: F64, viewer: Viewer | None) -> int:
    """The finest level that may serve at `where` (3,) m for a viewer without a blend band; the finest of all without a viewer."""
    if viewer is None:
        return w.kept.level
    lod, _ = ring_lod((where - w.kept.origin).astype(np.float32)[None], viewer, w.kept.origin, w.kept.level)
    return int(lod[0])


def corners(w: World, where: F64, normal: F64, lod: int) -> Corners | None:
    """The corners of the voxel that answers at `where` (3,) m for unit `normal` (3,), of level `lod` or coarser; None where no valid
    probe is near."""
    texture = w.kept
    q = lattice_position(texture, where[None])
    _, _, level = resolve(texture, q, q, lod)
    answers = int(level[0])
    _, finest = locate(texture, q, np.array([lod]))
    if answers == 0:
        return None
    slot, found = locate(texture, q, np.array([answers]))
    half = 2.0 ** (texture.level - int(found[0]))
    cell = tile_cell(texture, q, found)[0]
    voxel = np.clip(np.floor((q[0] - 2.0 * half * cell) / half), 0, 1)
    f = np.clip(q[0] / half - 2.0 * cell - voxel, 0.0, 1.0)
    share = np.where(OCTANTS == 1, f, 1.0 - f).prod(axis=1)
    texel = int(voxel @ np.array([9.0, 3.0, 1.0])) + VOXEL_TEXELS
    values = texture.texels[int(slot[0]), texel].astype(np.float64)
    depth = int(found[0]) - 1
    real = w.probes.layout.probe[depth][int(slot[0]) - int(w.probes.layout.first_slot[depth]), texel]
    total = float(share @ values[:, WEIGHT])
    light = _coefficients(values)
    each = (
        np.einsum("k,nkc->nc", irradiance_weights(normal, w.order)[: light.shape[1]], light) * (share / total)[:, None]
    )
    whole = irradiance(w.scene.settings.sampling.reconstruction, np.einsum("n,nkc->kc", share, light) / total, normal)
    at = texture.origin + texture.finest * half * (2.0 * cell + TEXEL_OFFSETS[texel])
    return Corners(
        int(found[0]), int(finest[0]), texture.finest * half, at, [int(n) for n in real], share, values[:, WEIGHT], each,
        whole - each.sum(axis=0),
    )  # fmt: skip


def _coefficients(values: F64) -> F64:
    """Premultiplied SH (N, K, 3) of texels (N, 13 or 28)."""
    first = values[:, :WEIGHT].reshape(len(values), 3, 4)
    more = values[:, WEIGHT + 1 :].reshape(len(values), 3, -1)
    return np.concatenate([first, more], axis=2).transpose(0, 2, 1)


def corner_rows(w: World, where: F64, found: Corners) -> list[dict[str, object]]:
    """The eight as rows of the record: position, level, kind, whose light, shares, what each gives, and what stands between."""
    blocked, triangle, crossing = crossings(w.surfaces.geometry, np.tile(where, (8, 1)), found.position)
    rows: list[dict[str, object]] = []
    total = float(found.share @ found.weight)
    for i, number in enumerate(found.real):
        row: dict[str, object] = {
            "position": found.position[i].tolist(),
            "level": found.level,
            "kind": _kind(w, number),
            "trilinear": float(found.share[i]),
            "validity": float(found.weight[i]),
            "weight": float(found.share[i] * found.weight[i]) / total,
            "gives": found.gives[i].tolist(),
            "mean": float(found.gives[i].mean()),
        }
        if number >= 0:
            row |= {
                "probe": number,
                "light_from": int(w.probes.light_from[number]),
                "back_share": float(w.probes.rows.back_share[number]),
            }
        if blocked[i]:
            row["blocked"] = _crossing(w, int(triangle[i]), crossing[i])
        rows.append(row)
    return rows


def _kind(w: World, number: int) -> str:
    if number < 0:
        return "virtual"
    return "real" if w.probes.valid[number] else "copied" if w.probes.light_from[number] >= 0 else "invalid"


def _crossing(w: World, triangle: int, at: F64) -> dict[str, object]:
    """Mesh and place where a straight way first meets a surface."""
    return {"mesh": w.scene.meshes[int(w.surfaces.geometry.mesh[triangle])].name, "position": at.tolist()}


def behind_rows(w: World, where: F64, normal: F64, lod: int) -> list[dict[str, object]]:
    """The real probes behind all eight, virtual ones followed to what they are interpolated from; most light first. What they give is
    of their light before it is rounded: a virtual probe's rounding is no one probe's."""
    found = probe_weights(w.kept, w.probes.layout, w.probes.light_from, where[None], lod)
    if not len(found.probe):
        return []
    weight = found.weight / found.weight.sum()
    row = irradiance_weights(normal, w.order)
    light = w.coefficients[found.probe].astype(np.float64)
    gives = np.einsum("k,nkc->nc", row[: light.shape[1]], light) * weight[:, None]
    order = np.argsort(-np.abs(gives).sum(axis=1), kind="stable")[:MOST_BEHIND]
    at = w.probes.octree.positions[found.probe[order]]
    blocked, triangle, crossing = crossings(w.surfaces.geometry, np.tile(where, (len(at), 1)), at)
    rows: list[dict[str, object]] = []
    for i, n in enumerate(order):
        one: dict[str, object] = {
            "probe": int(found.probe[n]),
            "position": at[i].tolist(),
            "level": int(w.probes.octree.corner_level[found.probe[n]]),
            "weight": float(weight[n]),
            "gives": gives[n].tolist(),
            "mean": float(gives[n].mean()),
        }
        if blocked[i]:
            one["blocked"] = _crossing(w, int(triangle[i]), crossing[i])
        rows.append(one)
    return rows
