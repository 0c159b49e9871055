"""Lumels and cubemap texels against the closed form of a sphere lit from within.

Between any two pieces of a sphere F_ij = A_j / A, so light that leaves a cap arrives everywhere alike: E = B A_cap / A, at every
lumel. A texel at the centre sees one place of the sphere: its radiance is B / π or 0, and half the sphere gives E = B at the centre
on a plane that faces it.
"""

from __future__ import annotations

import math

import numpy as np
from lightgauge.reference.progress import silent
from lightgauge.reference.transport.form_factors import FormFactors, form_factors
from lightgauge.reference.transport.lumels import build_lumels, lumel_receivers
from lightgauge.reference.transport.receivers import texel_receivers
from small_scenes import scene, sphere_mesh, surfaces, with_lumels

RAYS, SIZE = 1024, 8


def gathered(rows: FormFactors, radiosity: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """What each receiver gathers from patches of `radiosity` (P,), and the standard error were entries independent."""
    inside = rows.columns < rows.patches
    assert inside.all(), "nothing leaves a closed sphere"
    row, light = np.repeat(np.arange(rows.rows), np.diff(rows.indptr)), radiosity[rows.columns]
    value = np.bincount(row, rows.values[:, 0] * light, rows.rows)
    return value, np.sqrt(np.bincount(row, (rows.se[:, 0] * light) ** 2, rows.rows))


def test_lumels_and_texels_in_a_sphere_lit_from_one_half() -> None:
    s = with_lumels(scene([sphere_mesh(1.0, 3, name="ball")]), {"ball": 0.2})
    g, p = surfaces(s, 0.2)
    lit = (p.centroid[:, 1] > 0.3).astype(np.float64)
    share = float(p.area[lit > 0.0].sum() / p.area.sum())
    assert 0.2 < share < 0.5
    lumels = build_lumels(s, g)
    found, se = gathered(form_factors(g, p, lumel_receivers(g, lumels), RAYS, 1, silent, "lumels"), lit)
    assert lumels.count > 1000 and np.abs(found.mean() - share) < 2e-3, "1,280 flat faces in place of a sphere"
    assert np.abs(found - share).max() < 0.03 and np.median(se) < 0.02
    assert 0.5 * np.median(se) > np.abs(found - share).mean(), "low-discrepancy rays do better than independent entries"

    half = (p.centroid[:, 1] > 0.0).astype(np.float64)
    rows = form_factors(g, p, texel_receivers(g, np.zeros((1, 3)), SIZE), RAYS, 1, silent, "texels")
    seen = math.pi * gathered(rows, half)[0].reshape(6, SIZE, SIZE)
    np.testing.assert_allclose(seen[2], 1.0, rtol=1e-5, err_msg="+y looks at the lit half only")
    assert not seen[3].any(), "-y at the dark one"
    for face in (0, 1, 4, 5):  # t runs down on the sides: upper rows are lit
        np.testing.assert_allclose(seen[face, : SIZE // 2 - 1], 1.0, rtol=1e-5)
        assert not seen[face, SIZE // 2 + 1 :].any()
    s_, t_ = np.meshgrid(*[(2.0 * np.arange(SIZE) + 1.0) / SIZE - 1.0] * 2)
    solid = (2.0 / SIZE) ** 2 / (1.0 + s_**2 + t_**2) ** 1.5
    up = np.stack([-t_, -t_, np.ones_like(t_), -np.ones_like(t_), -t_, -t_]) / np.sqrt(1.0 + s_**2 + t_**2)
    irradiance = float((seen / math.pi * solid * np.maximum(up, 0.0)).sum())
    assert abs(irradiance - 1.0) < 0.01, (
        "E = B on a plane that faces the lit half; the rest is the quadrature over texels"
    )
