"""Faults in the kernels and in what feeds them."""

from __future__ import annotations

from .fault import ALL, ENERGY, Fault
from .faults_light import PERCENT

WALLS = ("two-rooms", "corridor")
FLOWN = ("corridor",)

DEVICE: tuple[Fault, ...] = (
    Fault(
        "half-a-texel-off", "samples are read half a finest voxel off",
        "fastpath/grid.py", 'words["anchor_fraction"] = [*fraction, 1.0 / lattice.finest]', 'words["anchor_fraction"] = [*(fraction + np.float32(0.5)), 1.0 / lattice.finest]',
    ),
    Fault(
        "floor-becomes-truncation", "positions below the anchor are rounded towards it, not down",
        "fastpath/common.clh", "whole = x < TO_F(whole) ? whole - 1 : whole;", "whole = whole;", FLOWN, fly=True,
    ),
    Fault(
        "weight-not-divided", "light is not divided by its weight, eight samples at a time",
        "fastpath/groups.clh", "const float8 inverse = 1.0f / m.weight;", "const float8 inverse = (float8)(1.0f);", WALLS,
    ),
    Fault(
        "weight-not-divided-alone", "light is not divided by its weight, single samples",
        "fastpath/sampler.cl", "1.0f / found.light.sc, n.x, n.y, n.z) * scale", "1.0f, n.x, n.y, n.z) * scale", WALLS,
    ),
    Fault(
        "axes-swapped", "x and y of red light's direction are swapped, eight samples at a time",
        "fastpath/lanes.clh", "(n.x * sum[3] + n.y * sum[1] + n.z * sum[2])", "(n.x * sum[1] + n.y * sum[3] + n.z * sum[2])",
    ),
    Fault(
        "axes-swapped-alone", "z and y of the light's direction are swapped, single samples",
        "fastpath/reconstruct.clh", "e += IRRADIANCE_1 * (nx * x + ny * y + nz * z);", "e += IRRADIANCE_1 * (nx * x + ny * z + nz * y);",
    ),
    Fault(
        "kernel-constant", "the kernel's constant of the linear band is that of radiance",
        "fastpath/reconstruct.clh", "#define IRRADIANCE_1 1.023326708f", "#define IRRADIANCE_1 1.5349900f",
    ),
    Fault(
        "weights-unasked", "places where no probe is valid are answered, not passed to the parent",
        "fastpath/groups.clh", "const int8 mine = mask_of(turn.lanes) && m.weight >= MIN_WEIGHT;", "const int8 mine = mask_of(turn.lanes);",
        ("corridor", "sphere", "valley"),
    ),
    Fault(
        "neighbour-voxel", "samples read the neighbouring voxel of their tile",
        "fastpath/voxels.clh", "v.voxel = (int3)((at.cell.x >> s) & 1,", "v.voxel = (int3)(1 - ((at.cell.x >> s) & 1),",
    ),
    Fault(
        "together-too-far", "samples of neighbouring voxels count as samples of the same",
        "fastpath/groups.clh", "const int s = grid->anchor_cell.w - level;", "const int s = grid->anchor_cell.w - level + 1;",
    ),
    Fault(
        "blue-for-green", "green and blue change places, eight samples at a time",
        "fastpath/groups.clh", "m.red * inverse * scale, m.green * inverse * scale, m.blue * inverse * scale",
        "m.red * inverse * scale, m.blue * inverse * scale, m.green * inverse * scale", ("corridor", "sphere"),
    ),
    Fault(
        "corner-order", "two corners of a voxel change places, eight samples at a time",
        "fastpath/lanes.clh", "const long step[8] = {0, dz, dy, dy + dz,", "const long step[8] = {0, dy, dz, dy + dz,",
    ),
    Fault(
        "tile-row-off-by-one", "tile offsets of the cache count from one along y",
        "fastpath/common.clh", "((long)((offset).x + (cache).x * ((offset).y + (cache).y * (offset).z)) * TEXELS",
        "((long)((offset).x + (cache).x * ((offset).y + (cache).z * (offset).z)) * TEXELS", ("corridor", "cornell", "house"),
    ),
    Fault(
        "lookup-row", "rows of the indirection texture are as long as its depth",
        "fastpath/voxels.clh", "indirection[l.x + (tile.x * l.z + tile.y) * l.w + tile.z]", "indirection[l.x + (tile.x * l.w + tile.y) * l.z + tile.z]", ("corridor", "two-rooms", "house"),
    ),
    Fault(
        "octant-bits", "virtual probes are interpolated from the parent's voxel with x and z swapped",
        "fastpath/tile_cache.cl", "(int3)(octant >> 2, (octant >> 1) & 1, octant & 1)", "(int3)(octant & 1, (octant >> 1) & 1, octant >> 2)",
    ),
    Fault(
        "not-premultiplied", "virtual probes carry light divided by their weight",
        "fastpath/tile_cache.cl", "    const float exact = t.first.sc, stored = kept(exact)",
        "    if (source == VIRTUAL && t.first.sc > 0.0f) { const float w = t.first.sc; t.first /= w; t.second /= w; t.first.sc = w; }\n"
        "    const float exact = t.first.sc, stored = kept(exact)", ("house", *WALLS),
    ),
    Fault(
        "exposure-twice", "light is divided by the exposure and not multiplied with it again",
        "fastpath/grid.py", 'words["scale"] = [exposure, 0.0, 0.0, 0.0]', 'words["scale"] = [1.0, 0.0, 0.0, 0.0]', ("cornell",
        "corridor", "two-rooms"),
    ),
    Fault(
        "wrap-around-lost", "clipmap windows are addressed without wrapping around when tiles are entered",
        "fastpath/clipmap.py", "at = tiles.cell.astype(np.int64) & (self.side - 1)", "at = np.minimum(tiles.cell.astype(np.int64), self.side - 1)", FLOWN, fly=True,
    ),
    Fault(
        "pointers-left-behind", "indirection texels still point to tiles that were evicted",
        "fastpath/streamed.py", "            self._clipmap.leave(self._in_slot.take(plan.out_slots))\n", "", FLOWN, fly=True,
    ),
    Fault(
        "parent-slot", "streamed tiles are interpolated from the slot after their parent's",
        "fastpath/streamed.py", "self._residency.slot_of[np.maximum(parent, 0)], -1)",
        "(self._residency.slot_of[np.maximum(parent, 0)] + 1) % self._cache.capacity, -1)", FLOWN, fly=True,
    ),
    Fault(
        "ring-off-by-one", "levels of detail begin one ring too early",
        "fastpath/windows.py", "return np.exp2(np.arange(level, 0, -1))", "return np.exp2(np.arange(level, 0, -1) - 1)", FLOWN,
        fly=True,
    ),
    Fault(
        "kernel-scaled", "the kernel returns too much light by a share",
        "fastpath/sampler.cl", "1.0f / found.light.sc, n.x, n.y, n.z) * scale;", "1.0f / found.light.sc, n.x, n.y, n.z) * scale * (1.0f + SIZEf);", ALL, sizes=PERCENT,
    ),
    Fault(
        "texels-scaled", "tiles are filled with too much light by a share",
        "reference/volume/tiles.py", "    mask = valid[:, None]\n", "    light, mask = (1.0 + SIZE) * light, valid[:, None]\n", ALL,
        sizes=PERCENT,
    ),
    Fault(
        "everything-scaled", "twin and kernel agree on too much light by a share",
        "reference/pipeline/probes.py", "coefficients = gather(probes.device_rows, light.radiosity.light)",
        "coefficients = np.float32(1.0 + SIZE) * gather(probes.device_rows, light.radiosity.light)", ENERGY, sizes=PERCENT,
    ),
)  # fmt: skip
