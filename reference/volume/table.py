"""The tiles of a world as a table that a tile cache streams from, without the octree and the layout they came from."""

from __future__ import annotations

import numpy as np

from ..datatypes import I32
from ..texture_types import INVALID, VIRTUAL, TileTable
from .layout import TileLayout


def tile_table(layout: TileLayout, light_from: I32) -> TileTable:
    """The table of `layout`, tiles numbered as its slots are; light_from (R,): whose light each probe uses, -1 for none."""
    first, levels = layout.first_slot, len(layout.parents)
    parent = np.full(layout.tiles, -1, dtype=np.int32)
    for i in range(1, levels):
        parent[first[i] : first[i + 1]] = first[i - 1] + layout.parent_tile[i]
    octant = np.concatenate(layout.octant).astype(np.int32)
    children = np.full((layout.tiles, 8), -1, dtype=np.int32)
    held = np.flatnonzero(parent >= 0)
    children[parent[held], octant[held]] = held
    probe = np.concatenate(layout.probe)
    used = np.where(light_from >= 0, light_from, INVALID).astype(np.int32)
    sources = np.where(probe >= 0, used[np.maximum(probe, 0)], VIRTUAL).astype(np.int32)
    return TileTable(
        layout.grid.origin,
        layout.grid.finest,
        layout.grid.level,
        layout.grid.extent,
        np.repeat(np.arange(1, levels + 1, dtype=np.int32), np.diff(first)),
        np.concatenate(layout.parents).astype(np.int32),
        parent,
        octant,
        children,
        sources,
        len(light_from),
    )
