"""More than the virtual texture can address is refused before any ray is traced, with the size that fits."""

from __future__ import annotations

import re

import numpy as np
import pytest
from lightgauge.reference.config_placement import PlacementSettings
from lightgauge.reference.datatypes import I64, Bool
from lightgauge.reference.errors import InputError
from lightgauge.reference.lattice import Grid, distinct, keys, parent_keys
from lightgauge.reference.placement import addressable, octree
from lightgauge.reference.placement.addressable import refuse_unaddressable, tiles_by_level
from lightgauge.reference.placement.octree import build_octree
from lightgauge.reference.placement.voxel_bitmap import VoxelBitmap
from lightgauge.reference.volume.layout import build_layout

GRID = Grid(np.zeros(3), 0.25, 6, np.array([64, 40, 17]))


def bitmap(count: int) -> VoxelBitmap:
    """`count` random voxels of the finest level, and their ancestors."""
    rng = np.random.default_rng(1)
    levels: list[I64] = [distinct(keys(rng.integers(0, GRID.extent, (count, 3))))]
    for _ in range(GRID.level):
        levels.append(distinct(parent_keys(levels[-1])))
    return VoxelBitmap(tuple(reversed(levels)))


def place(monkeypatch: pytest.MonkeyPatch, marks: VoxelBitmap, share: float, subdivision: str) -> octree.Octree:
    """An octree of which a share of all corners is near."""

    def near(g: object, p: object, key: I64, limit: float, rays: int, seed: int) -> Bool:
        return np.random.default_rng(3).random(len(key)) < share

    monkeypatch.setattr(octree, "nearer_than", near)
    settings = PlacementSettings.model_validate({"subdivision": subdivision})
    return build_octree(None, GRID, marks, settings, 1)  # type: ignore[arg-type]


@pytest.mark.parametrize("subdivision", ["child-only", "plain"])
def test_the_bitmap_bounds_the_tiles(monkeypatch: pytest.MonkeyPatch, subdivision: str) -> None:
    """Level by level, and they are what there is where all of the bitmap is close to surfaces."""
    marks = bitmap(60)
    bound = tiles_by_level(GRID, marks.occupied, subdivision == "plain")
    for share in (0.05, 1.0):
        layout = build_layout(place(monkeypatch, marks, share, subdivision))
        counts = [len(p) for p in layout.parents]
        assert all(n <= most for n, most in zip(counts, bound, strict=True)), (counts, bound)
    assert counts == bound


@pytest.mark.parametrize("subdivision", ["child-only", "plain"])
def test_too_many_tiles(monkeypatch: pytest.MonkeyPatch, subdivision: str) -> None:
    """Said before any ray is traced; the bitmap of the size that is named has as many tiles as the message says."""
    marks = bitmap(60)
    bound = tiles_by_level(GRID, marks.occupied, subdivision == "plain")
    monkeypatch.setattr(addressable, "MAX_TILES", sum(bound) - 1)
    with pytest.raises(InputError, match=rf"may need {sum(bound)} tiles, the virtual texture addresses") as caught:
        place(monkeypatch, marks, float("nan"), subdivision)
    size, fitting = re.findall(r"min_voxel = (\S+), .* about (\d+)$", str(caught.value))[0]
    assert (float(size), int(fitting)) == (0.5, sum(bound[:-1]))
    monkeypatch.setattr(addressable, "MAX_TILES", sum(bound))
    refuse_unaddressable(GRID, marks.occupied, subdivision == "plain")


def test_no_ray_is_traced_for_what_cannot_be_addressed(monkeypatch: pytest.MonkeyPatch) -> None:
    """Bounds of 60,000 × 3,000 × 60,000 finest voxels: the indirection texture alone would take gigabytes."""

    def never(*arguments: object) -> Bool:
        raise AssertionError("traced")

    monkeypatch.setattr(octree, "nearer_than", never)
    large = Grid(np.zeros(3), 0.125, 16, np.array([60_000, 3_000, 60_000]))
    corner = np.zeros((1, 3), np.int64)
    marks = VoxelBitmap(tuple(keys(corner) for _ in range(17)))
    with pytest.raises(InputError, match=r"texels of indirection.*placement\.min_voxel = 4, and"):
        build_octree(None, large, marks, PlacementSettings(), 1)  # type: ignore[arg-type]
    refuse_unaddressable(Grid(np.zeros(3), 4.0, 11, large.extent // 32), marks.occupied[:12], False)
    with pytest.raises(InputError, match="texels of indirection"):
        refuse_unaddressable(Grid(np.zeros(3), 2.0, 12, large.extent // 16), marks.occupied[:13], False)
