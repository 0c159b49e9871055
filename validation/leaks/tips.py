"""The edges of rooms, where two walls meet: the tips that voxels may reach into without a corner there.

A room is where n_i·x ≥ d_i for all its walls, n_i into the room. A voxel that reaches past one wall always has a corner past it: the
one furthest along n_i, whose sides are the signs of n_i. Past two walls at once it has one for certain only if one corner is the
furthest for both,

    n_ik n_jk ≥ 0 for each axis k,

as at edges of rooms that stand square on the lattice. Where the signs differ on some axis the edge is *askew*: it can poke into a voxel
between the corners, and these are all within the walls, however small the voxel is. For walls that meet at a right angle, turned by
φ about the edge, the tip that is ε deep is ε (tan φ + cot φ) wide where it enters; it has a corner of a voxel of edge h in it for
certain only from ε = h / (tan φ + cot φ) on, at most h / 2. Less than that, and none of the voxel's probes need be valid. Unless one is
given a neighbour's light the voxel is silent then, and the next larger one that has a valid corner answers, 2h, 4h, …, which lets light
in unless t ≥ 2h (|nx| + |ny| + |nz|), and so on. As an edge may poke into all levels' voxels at once by next to nothing, no wall
thinner than the largest voxel reaches is safe at askew edges on *every* lattice:

    leak-free on every lattice  ⟺  t ≥ h (|nx| + |ny| + |nz|) for all walls, and no edge is askew.

On a given lattice it is known for each place (`served_by`).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from ...reference.datatypes import F64, I64, Bool
from ...reference.lattice import OCTANTS
from ...reference.visibility import Geometry
from ...reference.volume.sampler import MIN_WEIGHT

IN_WALL, IN_ROOM, BEYOND = 0, 1, 2
HAIR = 1e-6  # of a product of normals: what rounding may leave of a right angle
SHALLOW = 7  # places at edges are 2^-7 to 1/2 of a voxel deep in the room
PER_VOXEL = 24  # places along an edge
MOST = 50_000

Classify = Callable[
    [I64, int], I64
]  # cells' corners (N, 3) of a level -> IN_WALL, IN_ROOM or BEYOND (N,), by the light they hold


def askew(a: F64, b: F64) -> Bool:
    """Whether edges between walls of normals a, b (N, 3) have voxels of any size that reach into them with no corner: (N,)."""
    return np.asarray((a * b < -HAIR).any(axis=-1))


@dataclass(frozen=True, eq=False)
class ServedBy:
    """level (N,) that answers each place, -1 where none does; beyond (N,): share of its light from beyond the walls."""

    level: I64
    beyond: F64


def served_by(q: F64, levels: int, kind: Classify) -> ServedBy:
    """Which voxel answers at `q` (N, 3), in finest voxels from the lattice's corner, and how much of its light comes from beyond: by
    arithmetic alone, for a place around which all voxels of all levels 0 … `levels` exist.

    A voxel answers if its corners that hold light have MIN_WEIGHT or more of the trilinear weights.
    """
    level, beyond = np.full(len(q), -1, dtype=np.int64), np.zeros(len(q))
    left = np.arange(len(q))
    for deep in range(levels, -1, -1):
        at = q[left] / 2.0 ** (levels - deep)
        cell = np.floor(at).astype(np.int64)
        f = (at - cell)[:, None, :]
        weight = np.where(OCTANTS[None] == 1, f, 1.0 - f).prod(axis=2)
        found = kind((cell[:, None, :] + OCTANTS).reshape(-1, 3), deep).reshape(-1, len(OCTANTS))
        total = (weight * (found != IN_WALL)).sum(axis=1)
        answers = total >= MIN_WEIGHT
        done = left[answers]
        level[done] = deep
        beyond[done] = (weight * (found == BEYOND)).sum(axis=1)[answers] / total[answers]
        left = left[~answers]
    return ServedBy(level, beyond)


def askew_edges(g: Geometry) -> tuple[F64, F64]:
    """Ends (N, 2, 3) m of the askew edges where two faces of one mesh meet in a hollow, and normals (N, 2, 3) of these faces."""
    corner, welded = np.unique(
        np.round(g.vertices[g.faces].reshape(-1, 3) / (1e-6 * g.scale)), axis=0, return_inverse=True
    )
    face = welded.reshape(-1, 3)
    sides = np.concatenate([face[:, [i, (i + 1) % 3]] for i in range(3)])
    owner, opposite = np.tile(np.arange(len(face)), 3), np.concatenate([face[:, (i + 2) % 3] for i in range(3)])
    pair = np.sort(sides, axis=1)
    order = np.lexsort((owner, pair[:, 1], pair[:, 0]))
    same = np.flatnonzero((pair[order[1:]] == pair[order[:-1]]).all(axis=1))
    first, second = order[same], order[same + 1]
    one_mesh = g.mesh[owner[first]] == g.mesh[owner[second]]
    first, second = first[one_mesh], second[one_mesh]
    points = corner * (1e-6 * g.scale)
    a, b = g.normals[owner[first]], g.normals[owner[second]]
    hollow = np.einsum("ni,ni->n", points[opposite[second]] - points[pair[first, 0]], a) > 1e-4 * g.scale
    chosen = np.flatnonzero(hollow & askew(a, b))
    return points[pair[first[chosen]]], np.stack([a[chosen], b[chosen]], axis=1)


def edge_places(g: Geometry, voxel: float, seed: int) -> npt.NDArray[np.float64]:
    """Places (N, 3) m in the tips of all askew edges: PER_VOXEL to a `voxel`, m, of length, at random depths and between both walls.
    Others for every seed."""
    random = np.random.default_rng([seed, 31])
    ends, normals = askew_edges(g)
    length = np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1)
    count = np.maximum(1, np.ceil(PER_VOXEL * length / voxel))
    count = np.maximum(1, count * min(1.0, MOST / max(1.0, float(count.sum())))).astype(np.int64)
    edge = np.repeat(np.arange(len(ends)), count)
    number = np.arange(len(edge)) - np.repeat(np.cumsum(count) - count, count)
    along, between, depth = random.random((3, len(edge), 1))
    share = (number[:, None] + along) / count[edge][:, None]
    on = ends[edge, 0] * (1.0 - share) + ends[edge, 1] * share
    into = normals[edge, 0] * (1.0 - between) + normals[edge, 1] * between
    into /= np.maximum(np.linalg.norm(into, axis=1, keepdims=True), 1e-9)
    return np.asarray(on + voxel * 0.5 ** (1.0 + (SHALLOW - 1.0) * depth) * into)
