"""What cases E2 … E5 measure: the sampling kernels against arithmetic that does without their short cuts."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping
from functools import cache

import numpy as np
from scipy.ndimage import map_coordinates

from ...fastpath.layout import Layout, cache_textures, exposure
from ...fastpath.sampler import Sampler
from ...fastpath.streamed import StreamedTexture
from ...reference.datatypes import F32, F64
from ...reference.texture_types import Samples, Storage
from .case import Reading
from .texture_worlds import (
    World,
    device,
    flat_light,
    inside,
    random_world,
    uniform_tree,
    units,
    world,
)
from .trees import random_tree

FIELD = math.sqrt(math.pi) / 2.0  # irradiance of light that comes from everywhere with L00 = 1
CLEAN_LEVEL, GRAIN = 4, 9
VOXEL = 0.25  # m, of E5
FAR_LIGHT = 1e6  # the brightest L00 beside which E3 stores dim light


@cache
def _tile(seed: int) -> tuple[World, int, F64, F32, int]:
    """A world without invalid probes, one of its tiles, and positions and normals in it: on a grid that holds its faces; its level."""
    w = random_world(random_tree(CLEAN_LEVEL, 0.6, [seed, 1]), 0.0, seed)
    slot, first = w.layout.tiles // 2, w.layout.first_slot
    level = int(np.searchsorted(first, slot, side="right"))
    cell = w.layout.parents[level - 1][slot - first[level - 1]]
    edge = 2.0 ** (CLEAN_LEVEL - level + 1)
    axis = np.linspace(0.0, 1.0, GRAIN)
    at = np.stack(np.meshgrid(axis, axis, axis, indexing="ij"), -1).reshape(-1, 3)
    p = (cell + np.minimum(at, 1.0 - 1e-6)) * edge
    return w, slot, p, units(len(p), seed), level


def poison(share: float, seed: int) -> Mapping[str, Reading]:
    """E2: a share of all other tiles holds NaN or infinity; light and positions that are no numbers."""
    w, slot, p, n, level = _tile(seed)
    rng = np.random.default_rng([seed, 6])
    others = np.setdiff1d(np.arange(w.layout.tiles), [slot])
    bad = rng.permutation(others)[: max(1, round(share * len(others)))]
    found = {}
    for name, value, storage, layout in _POISONED:
        clean = Sampler(device(), w.texture, storage, layout)(p, n, level)
        texels = w.texture.texels.copy()
        texels[bad] = value
        with np.errstate(invalid="ignore"):
            got = Sampler(device(), dataclasses.replace(w.texture, texels=texels), storage, layout)(p, n, level)
        mine = clean.level == level
        wrong = ~np.isfinite(got.irradiance).all(axis=1)
        if layout != "images":  # whose fractions next to a face may differ
            wrong |= (got.irradiance != clean.irradiance).any(axis=1)
        found[name] = Reading(float(wrong[mine].mean()), 0.0, int(mine.sum()))
    return {
        **found,
        "filter over tile borders": _naive(w, slot, bad),
        "light that is no number": _dark_light(w, share, seed),
        "positions that are no numbers": _no_place(w, share, seed),
    }


_POISONED: tuple[tuple[str, float, Storage, Layout], ...] = (
    ("NaN next door", math.nan, "float32", "packed"),
    ("infinity next door", math.inf, "float32", "split"),
    ("NaN next door, images", math.nan, "half", "images"),
)


def _naive(w: World, slot: int, bad: F64) -> Reading:
    """Share of a tile's grid points that turn into NaN where a filter reads the next texel with weight 0: plain trilinear reading
    of the cache, tiles beside one another."""
    texels = w.texture.texels.copy()
    texels[bad] = np.nan
    with np.errstate(invalid="ignore"):
        held = cache_textures(dataclasses.replace(w.texture, texels=texels), "float32", "split")
    x, y, _ = (int(c) for c in w.texture.indirection.cache)
    corner = 3.0 * np.array([slot // (x * y), slot // x % y, slot % x])
    axis = np.linspace(0.0, 2.0, GRAIN)
    at = corner[:, None] + np.stack(np.meshgrid(axis, axis, axis, indexing="ij"), -1).reshape(-1, 3).T
    read = map_coordinates(held.light[0, ..., 0].astype(np.float64), at, order=1, mode="nearest")
    return Reading(float(np.isnan(read).mean()), 0.0, at.shape[1])


def _dark_light(w: World, share: float, seed: int) -> Reading:
    """Share of samples that are not finite where a share of the probes' light is NaN, streamed."""
    light = w.light.copy()
    light[np.random.default_rng([seed, 7]).random(len(light)) < share] = np.nan
    made = StreamedTexture(device(), w.table, w.table.tiles, 100.0, storage="half")
    made.relight(light)
    made.move(np.full(3, 8.0))
    p = inside(w, 5000, seed)
    got = made(p, units(len(p), seed))
    assert isinstance(got, Samples)
    return Reading(float((~np.isfinite(got.irradiance)).any(axis=1).mean()), 0.0, len(p))


def _no_place(w: World, share: float, seed: int) -> Reading:
    """Share of samples that are other than without the NaN positions, or not NaN at one."""
    p, n = inside(w, 5000, seed), units(5000, seed)
    sampler = Sampler(device(), w.texture, "half", "packed")
    expected = sampler(p, n).irradiance
    bad = np.random.default_rng([seed, 8]).random(len(p)) < share
    p[bad, seed % 3] = np.nan
    expected[bad] = np.nan
    wrong = ~((sampler(p, n).irradiance == expected) | np.isnan(expected)).all(axis=1)
    wrong |= bad & ~np.isnan(sampler(p, n).irradiance).all(axis=1)
    return Reading(float(wrong.mean()), 0.0, len(p))


def half_floats(brightness: float, seed: int) -> Mapping[str, Reading]:
    """E3: light of one brightness, stored as half floats: with the exposure that the product chooses, without any, and beside light
    of FAR_LIGHT in the same cache."""
    tree = uniform_tree(3)
    values = np.full(len(tree.corners), brightness)
    alone = world(tree, flat_light(values), np.ones(len(values), dtype=bool))
    values = np.where((tree.corners == 0).all(axis=1), FAR_LIGHT, values)
    beside = world(tree, flat_light(values), np.ones(len(values), dtype=bool))
    p = np.random.default_rng([seed, 9]).uniform(2.0, 8.0, (4000, 3))
    found = {}
    for name, w in (("pre-exposed", alone), (f"beside {FAR_LIGHT:g}", beside)):
        got = Sampler(device(), w.texture, "half", "packed")(p, units(len(p), seed)).irradiance.astype(np.float64)
        error = np.abs(got / (FIELD * brightness) - 1.0)
        found[name] = Reading(float(np.minimum(error, 1.0).max()), 0.0, len(p))
    with np.errstate(over="ignore"):
        bare = float(np.float16(brightness))
    lost = min(abs(bare / brightness - 1.0), 1.0)
    top = brightness / exposure(alone.texture, "half")
    return {**found, "without exposure": Reading(lost), "brightest as stored": Reading(top)}


@cache
def _ramp(scale: float) -> World:
    """L00 = x + 4 y + 16 z in voxels, of 32 voxels per axis at three levels of which the finest is everywhere; half floats hold it."""
    tree = uniform_tree(5)
    w = world(tree, flat_light(tree.corners @ np.array([1.0, 4.0, 16.0])), np.ones(len(tree.corners), dtype=bool))
    origin = np.full(3, -16.0 * scale)
    return dataclasses.replace(w, texture=dataclasses.replace(w.texture, origin=origin, finest=scale))


def addresses(ulps: float, seed: int) -> Mapping[str, Reading]:
    """E4: a linear ramp read at every voxel corner from -16 to 16, `ulps` floats to the side of it."""
    texture = _ramp(1.0).texture
    axis = np.arange(-16.0, 17.0)
    p = np.stack(np.meshgrid(axis, axis, axis, indexing="ij"), -1).reshape(-1, 3).astype(np.float32)
    for _ in range(abs(round(ulps))):
        p = np.nextafter(p, np.float32(math.copysign(99.0, ulps)))
    slope = FIELD * np.array([1.0, 4.0, 16.0])
    exact = np.clip(p.astype(np.float64) + 16.0, 0.0, 32.0) @ slope
    n, top = units(len(p), seed), 32.0 * slope.sum()
    found = {}
    for name, storage, layout in _RAMPED:
        # Told from the middle, so that half the positions are negative to the kernel too.
        got = Sampler(device(), texture, storage, layout)(p, n, anchor=np.zeros(3)).irradiance[:, 0]
        found[name] = Reading(float(np.abs(got - exact).max() / top), 0.0, len(p))
    wide = p.astype(np.float64)
    cut = np.trunc(wide)  # towards 0: the cell beside the right one where numbers are negative
    taken = np.clip(cut + np.clip(wide - cut, 0.0, 1.0) + 16.0, 0.0, 32.0) @ slope
    half = Sampler(device(), texture, "half", "packed")(p + np.float32(0.5), n).irradiance[:, 0]
    return {
        **found,
        "truncated cells": Reading(float(np.abs(taken - exact).max() / top), 0.0, len(p)),
        "half a texel off": Reading(float(np.abs(half - exact).max() / top), 0.0, len(p)),
    }


_RAMPED: tuple[tuple[str, Storage, Layout], ...] = (
    ("packed", "half", "packed"),
    ("split", "half16", "split"),
    ("images", "half8", "images"),
)


def far_away(distance: float, seed: int) -> Mapping[str, Reading]:
    """E5: the ramp `distance` m from the world's origin, voxels of VOXEL: how far in voxels a position seems moved, with an anchor
    beside the viewer and with single-precision positions from the origin."""
    near = _ramp(VOXEL).texture
    there = dataclasses.replace(near, origin=near.origin + distance)
    p = distance + np.random.default_rng([seed, 10]).uniform(-3.9, 3.9, (20_000, 3))
    n = units(len(p), seed)
    slope = FIELD * np.array([1.0, 4.0, 16.0])
    exact = (p - there.origin) / VOXEL @ slope
    sampler = Sampler(device(), there, "float32", "packed")
    anchored = sampler(p, n, anchor=np.full(3, distance)).irradiance[:, 0]
    rough = sampler(p.astype(np.float32), n, anchor=np.full(3, distance)).irradiance[:, 0]
    found = {"anchored": anchored, "single precision": rough}
    return {name: Reading(float(np.abs(got - exact).max() / slope.sum()), 0.0, len(p)) for name, got in found.items()}
