"""What paths cut at D segments lose, without tracing any path (case F4), and what Mitsuba's own Cornell box loses.

With b_k = (ρF)^k M what k reflections leave of the lamps' own light, and G the form factors of the receivers,

    late(D) = Σ_(k≥D) G b_k = G (1 - ρF)⁻¹ b_D,   lost(D) = late(D) / late(1)

of the indirect light: a path of D segments from the receiver has met D - 1 surfaces. One dense solve; its patches and form factors are
the bake's, and share nothing with the path tracer.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np

from ...reference.datatypes import F64, Scene
from ...reference.progress import silent
from ...reference.transport.form_factors import patch_form_factors, point_form_factors
from ...reference.transport.patches import build_patches
from ...reference.transport.reconcile import reconcile
from ...reference.truth.points import Points
from ...reference.variant import ensure_variant
from ...reference.visibility import build_geometry
from .case import Reading
from .until_decided import mean_of

PATCH, PATCH_RAYS, POINT_RAYS = 0.05, 1024, 512  # m; rays of a row
DIRECT, WHOLE = 2, 128  # segments from a camera: those of direct light, and as good as all
PICTURE, PIXEL_PATHS, RANDOMISATIONS = 32, 16, 8  # pixels an edge; paths a pixel of each


@dataclass(frozen=True, eq=False)
class Transport:
    """Form factors between P patches, rows (P, P), and from N receivers to them, reaching (N, P); albedo, exitance (P, 3) of every
    lamp, whoever lights with it."""

    rows: F64
    reaching: F64
    albedo: F64
    exitance: F64

    def late(self, depth: int) -> F64:
        """Irradiance (N,) W·m⁻², mean over colours, of paths of more than `depth` ≥ 1 segments from the receiver."""
        total = np.zeros(len(self.reaching))
        for c in range(3):
            bounce = self.albedo[:, c, None] * self.rows
            light = self.exitance[:, c]
            for _ in range(depth):
                light = bounce @ light
            total += self.reaching @ np.linalg.solve(np.eye(len(bounce)) - bounce, light) / 3.0
        return total

    def lost(self, depth: int) -> float:
        """Share of all receivers' indirect light that these paths bring."""
        return float(self.late(depth).sum() / self.late(1).sum())


def transport(s: Scene, points: Points, seed: int) -> Transport:
    """Of a scene lit by surfaces alone."""
    ensure_variant()
    g = build_geometry(s)
    p = build_patches(s, g, PATCH)
    rows = reconcile(patch_form_factors(g, p, PATCH_RAYS, seed, silent), p.area).rows.matrix()
    at = point_form_factors(g, p, points.positions, points.normals, POINT_RAYS, seed + 1, silent).matrix()
    dense, reaching = (np.asarray(m[:, : p.count].toarray(), dtype=np.float64) for m in (rows, at))
    return Transport(dense, reaching, p.albedo, p.exitance + p.engine_exitance)


def lost_by_mitsuba(depth: int, seed: int) -> Reading:
    """Share of the indirect light that a picture of `mitsuba.cornell_box()` loses with paths of at most `depth` segments, the one from
    the camera included: all depths follow the same paths."""
    shares = []
    for k in range(RANDOMISATIONS):
        direct, cut, whole = (_mean_of_picture(d, 1000 * seed + k) for d in (DIRECT, depth, WHOLE))
        shares.append((whole - cut) / (whole - direct))
    return mean_of(shares)


@cache
def _mean_of_picture(depth: int, seed: int) -> float:
    ensure_variant()
    import mitsuba as mi

    # No roulette: it would end paths of other lengths at other places.
    integrator = mi.load_dict({"type": "path", "max_depth": depth, "rr_depth": WHOLE + 1})
    return float(np.array(mi.render(_mitsuba_box(), integrator=integrator, spp=PIXEL_PATHS, seed=seed)).mean())


@cache
def _mitsuba_box() -> Any:
    import mitsuba as mi

    description = mi.cornell_box()
    film = {"type": "hdrfilm", "width": PICTURE, "height": PICTURE, "rfilter": {"type": "box"}, "pixel_format": "rgb"}
    description["sensor"]["film"] = film
    return mi.load_dict(description)
