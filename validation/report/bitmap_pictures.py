"""The maps of a placement as pictures: colour says the level, thin lines the voxels, white lines the scene's outline."""

from __future__ import annotations

import base64
import zlib
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from ...reference.datatypes import I64, U8, Bool
from ..record_models import JsonObject
from .embed import data_uri
from .overlay import Colour, level_colours
from .pictures import png_bytes
from .words import number

NOTHING: Colour = (24, 27, 32)
BORDER, OUTLINE = 0.72, 0.8  # brightness of borders between voxels; share of white in the outline
THICK, LEAST_VOXEL = 2, 8  # pixels: of borders, and of the smallest voxel whose borders would not cover it
MAX_SIDE = 2048
PALETTE = 64
WHAT = {"bitmap": "Voxel bitmap", "octree": "Octree"}
VIEWS = {"above": "from above", "side": "from the side", "section": "in section"}
AXES = {"above": "x to the right, z down", "side": "x to the right, y up", "section": "x to the right, y up"}


def map_colours(scene: Mapping[str, Any], drawn: Sequence[int]) -> dict[int, Colour]:
    """Colour of each level in a scene's maps: that of its dots, whose levels are `drawn`, unless the maps show levels without
    dots (a bitmap may be finer than its octree); then the scale is spread anew."""
    tables = [levels_of(m, what) for m in scene.get("maps", []) for what in ("bitmap", "octree")]
    shown = {int(v) - 1 for t in tables if t is not None for v in np.unique(t) if v}
    return level_colours(list(drawn) if shown <= set(drawn) else [*shown, *drawn])


def map_context(scene: Mapping[str, Any], colours: Mapping[int, Colour]) -> JsonObject:
    """A scene's maps for the template: pictures with captions, and the legend, coarse to fine. Broken maps are left out."""
    pictures, sizes = [], dict[int, float]()
    for m in scene.get("maps", []):
        for what in ("bitmap", "octree"):
            levels = levels_of(m, what)
            if levels is None:
                continue
            words = f"{WHAT[what]} {VIEWS[m['view']]}"
            where = f", at z = {m['at_m']:.3g} m" if m.get("at_m") is not None else ""
            present = {int(v) - 1: float(m["voxel_m"][int(v) - 1]) for v in np.unique(levels) if v}
            sizes |= present
            said = f"voxels of {', '.join(f'{number(v)} m' for v in present.values())}" if present else "nothing"
            pictures.append(
                {
                    "src": data_uri(png_bytes(draw_map(m, levels, colours), PALETTE)),
                    "words": words,
                    "axes": AXES[m["view"]] + where,
                    "alt": f"{words}{where}, the finest voxel in each column: {said}",
                }
            )
    legend = [{"colour": _hex(colours[n]), "size": f"{number(sizes[n])} m"} for n in sorted(sizes)]
    return {"pictures": pictures, "legend": legend}


def _hex(colour: Colour) -> str:
    return "#{:02x}{:02x}{:02x}".format(*colour)


def levels_of(m: Mapping[str, Any], what: str) -> U8 | None:
    """(H, W) u8: 1 + level, 0 for none. None where the record's map is broken."""
    height, width = m["height"], m["width"]
    if not (0 < height * m["scale"] <= MAX_SIDE and 0 < width * m["scale"] <= MAX_SIDE):
        return None
    table = unpacked(m[what], height * width)
    good = table is not None and table.max() <= min(len(m["voxel_m"]), len(m["cells_by_level"]))
    return table.reshape(height, width) if table is not None and good else None


def unpacked(text: str, count: int) -> U8 | None:
    """The `count` bytes that `voxel_maps.packed` made text of; None if it is something else."""
    try:
        data = zlib.decompressobj().decompress(base64.b64decode(text, validate=True), count + 1)
    except (zlib.error, ValueError):
        return None
    return np.frombuffer(data, np.uint8) if len(data) == count else None


def draw_map(m: Mapping[str, Any], levels: U8, colours: Mapping[int, Colour]) -> U8:
    """(H, W, 3) sRGB bytes of a map, `scale` × `scale` pixels a cell."""
    table = np.array([NOTHING, *(colours.get(n, NOTHING) for n in range(int(levels.max())))], np.float64)
    scale = int(m["scale"])
    large = levels.repeat(scale, axis=0).repeat(scale, axis=1)
    picture = table[large]
    sizes = np.array([LEAST_VOXEL, *m["cells_by_level"]], np.int64) * scale
    picture[borders(large, sizes, from_below=m["view"] != "above")] *= BORDER
    bits = unpacked(m["outline"], -(-large.size // 8))
    if bits is not None:
        drawn = np.unpackbits(bits, count=large.size).reshape(large.shape).astype(np.bool_)
        picture[drawn] = (1.0 - OUTLINE) * picture[drawn] + OUTLINE * 255.0
    return np.round(picture).astype(np.uint8)


def borders(levels: U8, sizes: I64, from_below: bool) -> Bool:
    """(H, W) bool, pixels: the first THICK rows and columns of each voxel large enough to show them. sizes: pixels, by 1 + level."""
    width = sizes[levels]
    rows, columns = np.arange(levels.shape[0])[:, None], np.arange(levels.shape[1])[None]
    if from_below:
        rows = levels.shape[0] - 1 - rows
    first = (rows % width < THICK) | (columns % width < THICK)
    return np.asarray(first & (width >= LEAST_VOXEL) & (levels > 0))
