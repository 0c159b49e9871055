"""Clusters of form-factor columns: patches that lie near each other and look the same way, and pieces of the sky.

A single column of a probe's row rests on a few rays: two rows of the *same* probe differ by half of their L1 norm. What a
cluster sends rests on many. Cells are halved at the median of the widest of six axes (place, and normal times NORMAL_SCALE), as
a k-d tree does, so that all hold about equally many patches: no random start, no iteration.
"""

from __future__ import annotations

import numpy as np

from ..datatypes import F64, I64

HALVINGS = 8  # up to 256 clusters of patches
NORMAL_SCALE = 0.5  # of half the scene's extent: opposite normals are as far from each other as its middle and its end
SKY_CELLS = 2  # per edge of a face of the sky's cube


def cluster_patches(centroids: F64, normals: F64, halvings: int = HALVINGS) -> I64:
    """Cluster (P,) 0 … of patches with centroids (P, 3) m and unit normals (P, 3)."""
    lower, upper = centroids.min(axis=0), centroids.max(axis=0)
    half = max(0.5 * float((upper - lower).max()), np.finfo(np.float64).tiny)
    axes = np.concatenate([(centroids - 0.5 * (lower + upper)) / half, NORMAL_SCALE * normals], axis=1)
    cells = [np.arange(len(axes))]
    for _ in range(halvings):
        cells = [part for cell in cells for part in _halved(axes, cell)]
    found = np.zeros(len(axes), dtype=np.int64)
    for number, cell in enumerate(cells):
        found[cell] = number
    return found


def _halved(axes: F64, cell: I64) -> list[I64]:
    """Two halves of a cell, or the cell itself where all of it is at one place."""
    spread = axes[cell].var(axis=0)
    if len(cell) < 2 or spread.max() <= 0.0:
        return [cell]
    order = cell[np.argsort(axes[cell, int(spread.argmax())], kind="stable")]
    middle = len(order) // 2
    return [order[:middle], order[middle:]]


def cluster_sky(bins: int) -> I64:
    """Cluster (bins,) 0 … of the sky's bins: faces of a cube, each cut into SKY_CELLS² parts. bins: 6 · n² of them."""
    edge = round((bins / 6) ** 0.5)
    number = np.arange(bins)
    face, row, column = number // edge**2, number % edge**2 // edge, number % edge
    return (face * SKY_CELLS + row * SKY_CELLS // edge) * SKY_CELLS + column * SKY_CELLS // edge


def cluster_columns(centroids: F64, normals: F64, sky_bins: int) -> I64:
    """Cluster (P + sky_bins + 1,) of all columns of a row; the last, which carries no light, is a cluster of its own."""
    patches = cluster_patches(centroids, normals)
    sky = cluster_sky(sky_bins) + patches.max(initial=-1) + 1
    return np.concatenate([patches, sky, [sky.max(initial=-1) + 1]])
