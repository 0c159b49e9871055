"""Maps of a placement: the tables against brute force, the pictures drawn from them, the page that shows them."""

from __future__ import annotations

import base64
import re
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from lightgauge.reference.lattice import Grid, Octree, keys
from lightgauge.reference.placement.voxel_bitmap import VoxelBitmap
from lightgauge.validation.record_models import JsonObject
from lightgauge.validation.report.bitmap_pictures import borders, draw_map, levels_of, map_colours, map_context
from lightgauge.validation.report.page import write_report
from lightgauge.validation.report.voxel_maps import finest_levels, outline, packed, section, voxel_maps
from small_scenes import box, grid_quad, random_tree, scene

COLOURS = {n: (10 * n + 5, 200 - 10 * n, 60) for n in range(12)}


def maps_of(octree: Octree) -> list[JsonObject]:
    bitmap = VoxelBitmap(tuple(keys(v) for v in octree.voxels))
    return voxel_maps(scene([box((1, 1, 1), (6, 5, 4))]), octree, bitmap)


@pytest.fixture(scope="module")
def octree() -> Octree:
    """Levels 0 … 5 on a grid that is not the whole root, as those of scenes are."""
    tree = random_tree(5, 0.35, 4)
    grid = Grid(tree.grid.origin, 1.0, 5, np.array([29, 17, 23]))
    voxels = tuple(v[(v <= grid.last(n)).all(axis=1)] for n, v in enumerate(tree.voxels))
    return Octree(grid, voxels, tree.corners, tree.corner_level, 0)


@pytest.mark.parametrize("coarse", [0, 1, 2])
@pytest.mark.parametrize("axes", [(2, 0), (1, 0)])
def test_the_finest_voxel_of_each_column(octree: Octree, axes: tuple[int, int], coarse: int) -> None:
    grid = octree.grid
    got = finest_levels(grid, octree.voxels, axes, coarse)
    expected = np.zeros_like(got)
    for level, voxels in enumerate(octree.voxels):
        side = 1 << (grid.level - level)
        for v in voxels:
            rows, columns = (slice(v[a] * side >> coarse, -(-(v[a] + 1) * side >> coarse)) for a in axes)
            expected[rows, columns] = np.maximum(expected[rows, columns], level + 1)
    np.testing.assert_array_equal(got, expected)
    assert got.shape == tuple(-(-int(grid.extent[a]) >> coarse) for a in axes) and len(np.unique(got)) >= 3


def test_maps_say_what_is_where(octree: Octree) -> None:
    above, side, section_ = maps_of(octree)
    assert (above["view"], above["width"], above["height"], above["scale"]) == ("above", 29, 23, 35)
    assert (side["view"], side["width"], side["height"]) == ("side", 29, 17)
    assert above["voxel_m"] == [32, 16, 8, 4, 2, 1] == above["cells_by_level"]
    found = levels_of(side, "octree")
    assert found is not None
    np.testing.assert_array_equal(found[::-1], finest_levels(octree.grid, octree.voxels, (1, 0), 0))  # up is up
    cut = levels_of(section_, "octree")
    assert cut is not None and section_["at_m"] == 11.5 and above["at_m"] is None
    for row, column in np.ndindex(17, 29):
        cell = np.array([column, row, 11])
        deepest = max(n for n in range(6) if (octree.voxels[n] == cell >> (5 - n)).all(axis=1).any())
        assert cut[::-1][row, column] == deepest + 1


def test_pictures_show_colours_borders_and_edges(octree: Octree) -> None:
    above, side, _ = maps_of(octree)
    for m in (above, side):
        levels = levels_of(m, "octree")
        assert levels is not None
        blank = m | {"outline": packed(np.packbits(np.zeros((m["height"], m["width"], m["scale"] ** 2), bool)))}
        plain, scale = draw_map(blank, levels, COLOURS), m["scale"]
        assert plain.shape == (scale * m["height"], scale * m["width"], 3)
        middle = plain[scale // 2 :: scale, scale // 2 :: scale]
        large = np.array([[0] * 3, *(COLOURS[n] for n in range(6))])[levels]
        finest = levels == 6  # the middle of a finest voxel is on no border
        np.testing.assert_array_equal(middle[finest], large[finest])
        drawn = draw_map(m, levels, COLOURS)
        edges = (drawn != plain).any(axis=-1)
        assert 0 < edges.mean() < 0.2
        rows, columns = np.nonzero(edges)
        if m is above:  # the box from 1 to 6 and from 1 to 4 m, and nothing of it elsewhere
            for found, low, high in ((columns, 1, 6), (rows, 1, 4)):
                assert abs(found.min() - low * scale) <= 2 and abs(found.max() - high * scale) <= 2
        else:
            assert abs(drawn.shape[0] - rows.max() - scale) <= 3


def test_borders_stand_where_voxels_begin() -> None:
    levels = np.full((32, 32), 1, np.uint8)
    levels[:16, :16] = 2
    found = borders(levels, np.array([0, 32, 8]), from_below=False)
    rows = np.flatnonzero(found[:, 31])
    assert rows.tolist() == [0, 1] and np.flatnonzero(found[:16, 7]).tolist() == [0, 1, 8, 9]
    from_below = borders(levels, np.array([0, 32, 8]), from_below=True)
    np.testing.assert_array_equal(from_below[::-1], borders(levels[::-1], np.array([0, 32, 8]), from_below=False))
    assert not borders(levels, np.array([0, 4, 4]), from_below=False).any()


def test_outlines_are_creases_and_ends() -> None:
    assert len(outline([box((0, 0, 0), (1, 2, 3))])) == 12  # no diagonal of its sides
    flat = outline([grid_quad([[0, 0, 0], [0, 0, 4], [4, 0, 4], [4, 0, 0]], 4)])
    assert len(flat) == 16 and (np.linalg.norm(flat[:, 1] - flat[:, 0], axis=1) == 1.0).all()
    assert outline([]).shape == (0, 2, 3)


def test_a_section_cuts_what_it_meets() -> None:
    found = section([box((1, 1, 1), (6, 5, 4)), box((0, 0, 9), (1, 1, 10))], 2.5)
    assert len(found) == 8 and (found[:, :, 2] == 2.5).all()
    assert (found.min(axis=(0, 1)) == [1, 1, 2.5]).all() and (found.max(axis=(0, 1)) == [6, 5, 2.5]).all()
    assert np.linalg.norm(found[:, 1] - found[:, 0], axis=1).sum() == pytest.approx(2 * (5 + 4))
    assert section([], 0.0).shape == (0, 2, 3)


def test_colours_are_those_of_the_dots_where_they_can_be(octree: Octree) -> None:
    made = {"maps": maps_of(octree)}
    shown = {int(v) - 1 for m in made["maps"] for v in np.unique(levels_of(m, "octree")) if v}
    assert map_colours(made, list(range(6))) == map_colours({}, list(range(6)))
    assert set(map_colours(made, [0, 1])) == shown | {0, 1}


def test_a_broken_map_is_left_out(octree: Octree, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("lightgauge.validation.report.voxel_maps.PIXELS", 64)  # quick to draw
    good, side, _ = maps_of(octree)
    changed = {
        "width": 30,
        "height": 10**9,
        "octree": "!!",
        "bitmap": packed(np.full((23, 29), 200, np.uint8)),
        "scale": 0,
    }
    for key, value in changed.items():
        context = map_context({"maps": [good | {key: value}, side]}, COLOURS)
        expected = 3 if key in ("octree", "bitmap") else 2
        assert len(context["pictures"]) == expected, key
    bomb = packed(np.zeros(1 << 22, np.uint8))
    assert len(map_context({"maps": [good | {"octree": bomb, "outline": bomb}]}, COLOURS)["pictures"]) == 1


def test_the_page_shows_them(tmp_path: Path, octree: Octree, results: Callable[..., JsonObject]) -> None:
    made = results("cornell", charts=False)
    made["scenes"][0]["maps"] = maps_of(octree)
    write_report(tmp_path, made, [])
    html = (tmp_path / "index.html").read_text(encoding="utf-8")
    assert "Where probes are wanted" in html and "8.00 m" in html
    found = re.findall(
        r'<img src="data:image/png;base64,([^"]+)" alt="((?:Voxel bitmap|Octree) (?:from|in)[^"]+)"', html
    )
    assert len(found) == 6 and all("finest voxel in each column: voxels of" in alt for _, alt in found)
    assert all(base64.b64decode(data).startswith(b"\x89PNG") for data, _ in found)


def test_pictures_stay_small() -> None:
    """The worst there is: as many cells as are drawn, every one another level."""
    rng = np.random.default_rng(0)
    grid = Grid(np.zeros(3), 1.0, 8, np.full(3, 256))
    voxels = [rng.integers(0, 1 << n, (40 * 4**n, 3)) if n > 4 else np.zeros((1, 3), np.int64) for n in range(8)]
    tree = Octree(
        grid, (*voxels, rng.integers(0, 256, (20_000, 3))), np.zeros((0, 3), np.int64), np.zeros(0, np.int32), 0
    )
    bitmap = VoxelBitmap(tuple(keys(v) for v in tree.voxels))
    maps = voxel_maps(scene([]), tree, bitmap)
    pictures = map_context({"maps": [maps[0] | {"bitmap": "!!"}]}, COLOURS)["pictures"]
    assert len(pictures) == 1 and 6 * len(pictures[0]["src"]) < 300_000  # all six are alike
    assert sum(len(m["bitmap"]) + len(m["octree"]) + len(m["outline"]) for m in maps) < 300_000
