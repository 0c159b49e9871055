"""What four or nine coefficients make of light (failure-catalogue C1, C2, C3)."""

from __future__ import annotations

import functools
import math
from collections.abc import Mapping

import numpy as np

from ...reference import pipeline
from ...reference.datatypes import F64
from ...reference.directions import fibonacci_sphere, sphere
from ...reference.progress import silent
from ...reference.reconstruction import RECONSTRUCTIONS, Reconstruction, irradiance, order_for
from ...reference.sh import COSINE_A0, Y0, basis, coefficient_count
from ...reference.transport.form_factors import FormFactors, point_form_factors, probe_form_factors
from ...reference.variant import ensure_variant
from .caps import HEIGHTS, cap_irradiance, cap_light, coefficient, normals_at, reconstructed, relative_error
from .case import Reading
from .kernel_reads import kernel_samples
from .scenes import grey, quad, scene_of
from .texture_worlds import inside, uniform_tree, world

CAPS, SCENES, NORMALS = 4, 1000, 200
ROUNDING = 1e-6  # of single precision, over the mean
SMALLEST_CAP = 5  # degrees
EVEN = 0.5  # even light beside the caps, over the mean irradiance of the caps
TUNNEL_NORMALS, TUNNEL_RAYS, PROBE_RAYS, PROBES, EXACT_RAYS = 128, 1 << 15, 1 << 16, 8, 1 << 18


def lowest(degrees: float, seed: int) -> Mapping[str, Reading]:
    """C1: lowest irradiance over all normals, over the mean, of a cap of half angle `degrees`, and the share below 0: the worst of the
    plain formulas and of the kernel, which reads the cap from probes that all hold it."""
    c = math.cos(math.radians(degrees))
    z = np.linspace(-1.0, 1.0, 8001)
    mean = 0.5 * math.pi * (1.0 - c)
    found: dict[str, Reading] = {}
    for name in RECONSTRUCTIONS:
        plain = irradiance(name, np.tile(cap_light(c), (len(z), 1, 1)), normals_at(z))[:, 1] / mean
        ways = [plain, *_by_kernel(name, c, normals_at(z), mean, seed)]
        found[name] = Reading(min(float(got.min()) for got in ways), 0.0, len(z))
        if name == "linear":
            share = max(float((got < -ROUNDING).mean()) for got in ways)
            found["linear_share"] = Reading(share, 0.0, len(z))
    return found


def _by_kernel(name: Reconstruction, c: float, normals: F64, mean: float, seed: int) -> list[F64]:
    """What the kernel makes of a cap at normals (N, 3), over `mean`: one (N,), or none without a device."""
    tree = uniform_tree(1)
    order = order_for(name)
    light = np.tile(cap_light(c)[: coefficient_count(order)], (len(tree.corners), 1, 1)).astype(np.float32)
    w = world(tree, light, np.ones(len(light), dtype=np.bool_))
    got = kernel_samples(w.texture, inside(w, len(normals), seed), normals.astype(np.float32), "float32", name)
    return [] if got is None else [got.irradiance[:, 1].astype(np.float64) / mean]


def choice(degrees: float, seed: int) -> Mapping[str, Reading]:
    """C2: relRMSE over all normals of each reconstruction, of a cap of half angle `degrees` alone, and (`mix_`) in the mean over
    SCENES of CAPS caps of 5° … `degrees` at random, of log-normal strengths, beside even light."""
    truth, got = reconstructed(math.cos(math.radians(degrees)))
    found = {name: Reading(relative_error(e, truth), 0.0, len(HEIGHTS)) for name, e in got.items()}
    rng = np.random.default_rng([seed, 101])
    normals = sphere(rng.random((NORMALS, 2)))
    drawn = [_mixture(degrees, normals, rng) for _ in range(SCENES)]
    light = np.stack([d[0] for d in drawn])[:, None].repeat(NORMALS, axis=1)
    exact = np.stack([d[1] for d in drawn])
    for name in RECONSTRUCTIONS:
        ours = irradiance(name, light, normals)[..., 1]
        error = np.sqrt(((ours - exact) ** 2).mean(axis=1)) / exact.mean(axis=1)
        found[f"mix_{name}"] = Reading(
            float(error.mean()), float(error.std(ddof=1)) / math.sqrt(SCENES), SCENES, SCENES - 1
        )
    return found


def _mixture(degrees: float, normals: F64, rng: np.random.Generator) -> tuple[F64, F64]:
    """Radiance SH (9, 3) of some caps and even light, and the exact irradiance (N,) at `normals` (N, 3)."""
    light, exact = np.zeros(9), np.zeros(len(normals))
    for half_angle in rng.integers(SMALLEST_CAP, round(degrees) + 1, CAPS).tolist():
        towards, strength = sphere(rng.random((1, 2)))[0], rng.lognormal()
        c, of_height = _whole_degrees(half_angle)
        bands = [coefficient(c, band) * math.sqrt(4.0 * math.pi / (2 * band + 1)) for band in range(3)]
        light += strength * np.repeat(bands, [1, 3, 5]) * basis(towards, 2)
        exact += strength * np.interp(normals @ towards, HEIGHTS, of_height)
    even = EVEN * float(exact.mean())
    light[0] += even / (COSINE_A0 * Y0)
    return np.repeat(light[:, None], 3, axis=1), exact + even


@functools.cache
def _whole_degrees(half_angle: int) -> tuple[float, F64]:
    """Cosine of the half angle and exact irradiance (N,) at normals HEIGHTS of a cap."""
    c = math.cos(math.radians(half_angle))
    return c, cap_irradiance(c, HEIGHTS)


def tunnel(length: float, seed: int) -> Mapping[str, Reading]:
    """C3: in the middle of a tunnel 2 m wide and `length` m long, lit from both ends, walls nearly black: relRMSE over normals of
    exact light as SH (`linear`, `l2`: the floors), and how far from that the product's own probe is (`over_…`)."""
    ensure_variant()
    baked, light = _lit_tunnel(length, seed)
    g, p = baked.geometry, baked.patches
    normals, middle = fibonacci_sphere(TUNNEL_NORMALS), np.zeros((TUNNEL_NORMALS, 3))
    half = [
        (point_form_factors(g, p, middle, normals, TUNNEL_RAYS, seed + s, silent).matrix() @ light)[:, 1]
        for s in (1, 2)
    ]
    exact = _sh(probe_form_factors(g, p, middle[:1], EXACT_RAYS, seed + 3, silent, 2), light)
    probes = _sh(probe_form_factors(g, p, middle[:PROBES], PROBE_RAYS, seed + 4, silent, 2), light)
    mean = float(np.mean(half))
    found = {}
    for name in ("linear", "l2"):
        best = irradiance(name, exact[0], normals)[:, 1]
        square = (best - half[0]) * (best - half[1])
        rms = math.sqrt(max(float(square.mean()), 1e-12))
        noise = math.sqrt(
            float(((half[0] - half[1]) ** 2).mean()) / 4.0 / TUNNEL_NORMALS
        )  # of the mean of (best - truth) / rms
        found[name] = Reading(rms / mean, noise / mean, TUNNEL_NORMALS)
        ours = irradiance(name, probes[:, None], normals)[..., 1]
        over = np.sqrt(((ours - best) ** 2).mean(axis=1)) / mean
        found[f"over_{name}"] = Reading(
            float(over.mean()), float(over.std(ddof=1)) / math.sqrt(PROBES), PROBES, PROBES - 1
        )
    return found


def _lit_tunnel(length: float, seed: int) -> tuple[pipeline.Surfaces, F64]:
    """The tunnel's patches, and the light (columns, 3) that leaves them."""
    a = 0.5 * length
    made = scene_of(
        [
            quad((-1, -1, -a), (2, 0, 0), (0, 2, 0), exitance=np.pi), quad((-1, -1, a), (0, 2, 0), (2, 0, 0), exitance=np.pi),
            quad((-1, -1, -a), (0, 2, 0), (0, 0, length)), quad((1, -1, -a), (0, 0, length), (0, 2, 0)),
            quad((-1, -1, -a), (0, 0, length), (2, 0, 0)), quad((-1, 1, -a), (2, 0, 0), (0, 0, length)),
        ],
        [grey(0.02)], radiosity={"patch_size": 0.5, "rays": 1024, "noise": 0.05},
    )  # fmt: skip
    baked = pipeline.bake_surfaces(made, seed)
    return baked, pipeline.light_patches(made, baked, seed).radiosity.light


def _sh(rows: FormFactors, light: F64) -> F64:
    """Radiance SH (R, 9, 3) of probes."""
    return np.stack([rows.matrix(k) @ light for k in range(rows.values.shape[1])], axis=1)


def equal_cap(length: float) -> float:
    """Cosine of the half angle of the cap as large as one end of the tunnel seen from its middle: Ω = 4 arcsin(1/(1 + a²))."""
    solid_angle = 4.0 * math.asin(1.0 / (1.0 + 0.25 * length**2))
    return 1.0 - solid_angle / (2.0 * math.pi)
