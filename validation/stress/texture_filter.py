"""What case E1 measures: texture units that interpolate with few bits, against single precision."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping

import numpy as np

from ...fastpath.layout import Layout
from ...fastpath.sampler import Sampler
from ...reference.datatypes import F32, F64, Bool
from ...reference.lattice import OCTANTS
from ...reference.reconstruction import irradiance
from ...reference.texture_types import VirtualTexture
from ...reference.volume.sampler import MIN_WEIGHT, resolve, sample
from .case import Reading
from .texture_worlds import device, flat_light, inside, uniform_tree, units, world

FRACTION_BITS = 8  # of a texture unit's 24.8 fixed-point coordinates
LEVEL, COUNT = 4, 60_000
PARTS = 20
INVALID, BOUNDED = 0.1, 4000  # share of invalid probes; samples held against the bound


def _percentile(error: F64, share: float) -> Reading:
    """A percentile with its standard error from PARTS parts of the samples."""
    parts = [np.percentile(part, share) for part in np.array_split(error, PARTS)]
    se = float(np.std(parts, ddof=1)) / math.sqrt(PARTS)
    return Reading(float(np.percentile(error, share)), se, len(error), PARTS - 1)


def _relative(ours: F32, exact: F64 | F32) -> F64:
    """Largest error over the colours, (N,), relative to the mean of the exact (N, 3)."""
    scale = np.maximum(np.abs(exact.astype(np.float64)).mean(axis=1), 1e-30)
    return np.asarray(np.abs(ours.astype(np.float64) - exact).max(axis=1) / scale)


def _fixed_point(texture: VirtualTexture, positions: F64, normals: F32) -> tuple[F64, Bool]:
    """Irradiance (N, 3) by a filter whose fractions have FRACTION_BITS, and where there is any (N,). All voxels are of the finest
    level and of 1 m from the origin on."""
    q = positions - texture.origin
    steps = 2.0**FRACTION_BITS
    light, weight, _ = resolve(texture, np.round(q * steps) / steps, q, texture.level)
    lit = weight >= MIN_WEIGHT
    coefficients = (light / np.where(lit, weight, 1.0)[:, None]).reshape(-1, 3, 4).transpose(0, 2, 1)
    return irradiance("linear", coefficients, normals).astype(np.float64), lit


def filter_fractions(contrast: float, seed: int) -> Mapping[str, Reading]:
    """E1: errors of interpolation between probes of one level whose light differs by `contrast` (deviation of its logarithm): all of
    them valid, and (`…, invalid`) a share INVALID of weight 0. bound: largest error of the 24.8 filter over what it can be."""
    tree = uniform_tree(LEVEL)
    rng = np.random.default_rng([seed, 11])
    light = flat_light(rng.lognormal(0.0, contrast, len(tree.corners)))
    found: dict[str, Reading] = {}
    loads = []
    for suffix, share in (("", 0.0), (", invalid", INVALID)):
        w = world(tree, light, rng.random(len(light)) >= share)
        p, n = inside(w, COUNT, seed), units(COUNT, seed)
        plain = dataclasses.replace(w.texture, texels=w.texels("half"))
        exact = sample(plain, p, n)
        ways: tuple[tuple[str, Layout], ...] = (("explicit loads", "packed"), (f"images{suffix}", "images"))
        for name, layout in ways:
            got = Sampler(device(), w.texture, "half", layout)(p, n)
            same = (got.level == w.texture.level) & (exact.level == w.texture.level)
            found[name] = _percentile(_relative(got.irradiance[same], exact.irradiance[same]), 99.0)
        loads.append(found["explicit loads"])
        rough, lit = _fixed_point(plain, p, n)
        same = lit & (exact.level == w.texture.level)
        error = _relative(rough[same].astype(np.float32), exact.irradiance[same])
        found[f"24.8 filter{suffix}"] = _percentile(error, 99.0)
        found[f"24.8 filter{suffix}, worst"] = Reading(float(error.max()), 0.0, len(error))
        if not share:
            found["24.8 filter over its bound"] = Reading(_of_bound(plain, p, n, rough), 0.0, BOUNDED)
    return {**found, "explicit loads": max(loads, key=lambda r: r.value)}


def _of_bound(texture: VirtualTexture, positions: F64, normals: F32, rough: F64) -> float:
    """Largest |rough - exact| at the first BOUNDED positions, over half a step of the fraction times the largest difference along one
    of the voxel's four edges, summed over axes; all probes valid, so that samples are linear along each axis."""
    p, n = positions[:BOUNDED], normals[:BOUNDED]
    first = np.floor(p - texture.origin) + texture.origin
    corners = [sample(texture, first + corner, n).irradiance[:, 0] for corner in OCTANTS]
    at = np.stack(corners).astype(np.float64).reshape(2, 2, 2, BOUNDED)
    steepest = [np.abs(np.diff(at, axis=axis)).reshape(4, -1).max(axis=0) for axis in range(3)]
    off = np.abs(rough[:BOUNDED, 0] - sample(texture, p, n).irradiance[:, 0].astype(np.float64))
    return float((off / (np.sum(steepest, axis=0) * 2.0 ** -(FRACTION_BITS + 1) + 1e-6)).max())
