"""Faults in placement, validity, virtual probes, and the virtual texture that the plain sampler and the kernels share."""

from __future__ import annotations

from .fault import ALL, Fault

WALLS = ("two-rooms", "corridor", "cornell")

VOLUME: tuple[Fault, ...] = (
    Fault(
        "validity-ignored", "probes that see back faces count as valid",
        "reference/pipeline/probes.py", "valid = rows.back_share <= s.backface_tolerance", "valid = rows.back_share <= 1.0", WALLS,
    ),
    Fault(
        "validity-inverted", "probes count as valid where they see back faces",
        "reference/pipeline/probes.py", "valid = rows.back_share <= s.backface_tolerance", "valid = rows.back_share > s.backface_tolerance", WALLS,
    ),
    Fault(
        "back-faces-of-the-front", "the share of back faces counts front faces",
        "reference/transport/hits.py", "return column, hit & ~faces & ((cuts & 1) == 1)", "return column, hit & faces & ((cuts & 1) == 1)", WALLS,
    ),
    Fault(
        "probes-half-a-voxel-off", "probes are traced half a finest voxel from where they stand",
        "reference/pipeline/probes.py", "receivers = probe_receivers(surfaces.geometry, octree.positions, order)",
        "receivers = probe_receivers(surfaces.geometry, octree.positions + 0.5 * octree.grid.finest, order)", WALLS,
    ),
    Fault(
        "no-subdivision", "the threshold on the harmonic mean is taken of half the voxel, not of the voxel",
        "reference/placement/octree.py", "limit = s.threshold * grid.size(level)", "limit = 0.1 * s.threshold * grid.size(level)",
        ("house", *ALL),
    ),
    Fault(
        "touched-voxels-forgotten", "voxels that surfaces touch are not subdivided unless rays find them",
        "reference/placement/octree.py", "return index_of(touched[level], voxels) >= 0 if touched else", "return np.zeros(len(voxels), dtype=np.bool_) if touched else", ("corridor", "house", "two-rooms", "sphere", "cornell"),
    ),
    Fault(
        "copies-through-walls", "dead edges take light from probes behind walls",
        "reference/placement/dead_edges.py", "pair = pair[~crossings(g, at[pair[:, 1]], at[pair[:, 0]]).through]",
        "pair = pair", ("two-rooms", "house"),
    ),
    Fault(
        "copies-from-nobody", "invalid probes are given light without a look at who stands beside them: the first probe's",
        "reference/placement/dead_edges.py", "    return source\n\n\ndef _choose(", "    return np.maximum(source, 0)\n\n\ndef _choose(", WALLS,
    ),
    Fault(
        "neighbours-of-faces-only", "virtual voxels surround fine ones on three sides of a parent only, not on all 26",
        "reference/tiling.py", "facing = [above + 2 * (odd & axes) - axes for axes in steps(OCTANTS)]",
        "facing = [above + 2 * (odd & axes) - axes for axes in steps(OCTANTS) if axes in steps(OCTANTS)[[0, 1, 2, 4]]]",
        ("two-rooms", "corridor", "cornell", "house"),
    ),
    Fault(
        "neighbours-none", "no virtual voxels surround fine ones",
        "reference/tiling.py", "facing = [above + 2 * (odd & axes) - axes for axes in steps(OCTANTS)]", "facing = [above]",
        ("two-rooms", "corridor", "cornell", "house"),
    ),
    Fault(
        "octants-turned", "which voxel of its parent a tile covers is read with x and z swapped",
        "reference/volume/layout.py", "(cells(p) & 1) @ np.array([4, 2, 1])", "(cells(p) & 1) @ np.array([1, 2, 4])",
    ),
    Fault(
        "texels-turned", "a tile's texels are filled with z slowest",
        "reference/volume/layout.py", "for x in range(3) for y in range(3) for z in range(3)]", "for z in range(3) for y in range(3) for x in range(3)]",
    ),
    Fault(
        "virtual-half-a-texel-off", "virtual probes are interpolated half a texel off, by the plain filler",
        "reference/volume/tiles.py", "np.where(corner == 1, texel / 2.0, 1.0 - texel / 2.0)", "np.where(corner == 1, 0.25 + texel / 4.0, 0.75 - texel / 4.0)",
    ),
    Fault(
        "colours-interleaved", "texels hold coefficient by coefficient what is read colour by colour",
        "reference/volume/tiles.py", "light = coefficients[:, :4].transpose(0, 2, 1).reshape(n, 12)", "light = coefficients[:, :4].reshape(n, 12)",
    ),
    Fault(
        "invalid-light-kept", "texels of invalid probes keep their light beside weight 0",
        "reference/volume/tiles.py", "np.concatenate([np.where(mask, light, 0.0), mask,", "np.concatenate([light, mask,", WALLS,
    ),
    Fault(
        "virtual-weight-one", "virtual probes have weight 1 whatever they are made of",
        "reference/volume/tiles.py", "    out[..., WEIGHT] = weight\n    return out", "    out[..., WEIGHT] = np.ceil(weight)\n    return out", ("house", *WALLS),
    ),
    Fault(
        "level-off-by-one", "indirection texels name the level below",
        "reference/volume/indirection.py", "pack(slot_offset(slots, cache), i + 1)", "pack(slot_offset(slots, cache), max(i, 1))",
    ),
    Fault(
        "offsets-swapped", "tile offsets are packed with y and z swapped",
        "reference/volume/indirection.py", "(o[:, 1] << 8) | (o[:, 2] << 16)", "(o[:, 2] << 8) | (o[:, 1] << 16)",
    ),
    Fault(
        "last-tile-row-lost", "the last tile row of each level is not entered into the indirection texture",
        "reference/volume/indirection.py", "        below[tuple(parents.T)] = pack(slot_offset(slots, cache), i + 1)\n",
        "        kept = parents[:, 0] < max(int(parents[:, 0].max()), 1)\n"
        "        below[tuple(parents[kept].T)] = pack(slot_offset(slots, cache), i + 1)[kept]\n",
        ("cornell", "corridor", "two-rooms", "house"),
    ),
    Fault(
        "children-at-parents-place", "finer levels of the indirection texture are stretched along one axis only",
        "reference/volume/indirection.py", "below.repeat(2, 0).repeat(2, 1).repeat(2, 2)[", "np.tile(below, (2, 2, 2))[",
        ("corridor", "cornell", "two-rooms", "house"),
    ),
    Fault(
        "samples-under-the-surface", "samples are moved under their surface instead of over it",
        "reference/pipeline/probes.py", "points.positions + np.where(on_surface[:, None], offset, 0.0)", "points.positions - np.where(on_surface[:, None], offset, 0.0)",
    ),
    Fault(
        "sample-offset-lost", "samples are taken on their surface, not the wanted share of a voxel over it",
        "reference/pipeline/probes.py", "points.positions + np.where(on_surface[:, None], offset, 0.0)", "points.positions + np.where(on_surface[:, None], 0.0, 0.0)", ("two-rooms", "cornell", "corridor", "house"),
    ),
    Fault(
        "culling-without-a-judge", "probes are culled though the judge says that they are needed",
        "reference/placement/judge.py", "    return np.asarray(np.sqrt(np.maximum(1.0 + change, 0.0)) - 1.0)", "    return np.asarray(np.zeros_like(change))", ("cornell",),
    ),
    Fault(
        "culled-numbers", "after culling, probes that copy light do so by their old numbers",
        "reference/pipeline/culling.py", "np.where(source >= 0, number[source], -1).astype(np.int32)", "np.minimum(source, stay.sum() - 1).astype(np.int32)", ("cornell", "house"),
    ),
    Fault(
        "culled-rows", "after culling, rows of form factors are those of their neighbours",
        "reference/pipeline/culling.py", "rows = _kept_rows(probes.rows, np.flatnonzero(stay))", "rows = _kept_rows(probes.rows, np.maximum(np.flatnonzero(stay) - 1, 0))", ("cornell", "house"),
    ),
    Fault(
        "cosine-lobe-of-radiance", "the linear band is convolved with π instead of 2π/3",
        "reference/sh.py", "COSINE_A1 = 2.0 * math.pi / 3.0", "COSINE_A1 = math.pi",
    ),
)  # fmt: skip
