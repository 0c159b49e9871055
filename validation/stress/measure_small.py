"""Case A8: the noise of small form factors."""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np
from scipy.optimize import brentq

from ...reference.datatypes import F64
from ...reference.progress import silent
from ...reference.transport.form_factors import point_form_factors
from ...reference.transport.patches import build_patches
from ...reference.visibility import build_geometry
from .case import Reading
from .cases_form_factors import SMALL
from .scenes import plate, quads_mesh, scene_of
from .until_decided import until_decided

RAYS, RECEIVERS, LOOKS = 4096, 512, 6  # receivers a look
UP = np.array([0.0, 1.0, 0.0])


def small_form_factor(wanted: float, seed: int) -> Mapping[str, Reading]:
    """Relative root mean square error of the form factor from a point to a coaxial square, over receivers with rays of their own;
    the standard errors that they report, over their real error; and what independent rays would err."""
    rng, errors, reported, alone = np.random.default_rng([seed, 5]), np.zeros(0), np.zeros(0), np.zeros(0)
    theory = math.sqrt((1.0 - wanted) * wanted / RAYS)

    def look(k: int) -> Mapping[str, Reading]:
        nonlocal errors, reported, alone
        found, square = _receivers(wanted, 100 * seed + k)
        errors, reported = np.append(errors, found - wanted), np.append(reported, square)
        alone = np.append(alone, rng.binomial(RAYS, wanted, RECEIVERS) / RAYS - wanted)
        rms, said = _root_mean_square(errors), math.sqrt(reported.mean())
        share = rms.se / rms.value
        plain = _root_mean_square(alone)
        return {
            "ours, of binomial": Reading(rms.value / theory, rms.se / theory, rms.n),
            "reported standard error, of real": Reading(said / rms.value, share * said / rms.value, rms.n),
            "independent rays": Reading(plain.value / wanted, plain.se / wanted, plain.n),
        }

    return until_decided(SMALL, wanted, look, LOOKS)


def _receivers(wanted: float, seed: int) -> tuple[F64, F64]:
    """Form factors (RECEIVERS,) as found, and the squares of their reported standard errors."""
    half = _half_side(wanted)
    g = build_geometry(s := scene_of([quads_mesh([plate((-half, half), (-half, half), 0.0, up=True)])]))
    p = build_patches(s, g, 1e3)
    rows = point_form_factors(g, p, np.tile(UP, (RECEIVERS, 1)), np.tile(-UP, (RECEIVERS, 1)), RAYS, seed, silent)
    mine, square = rows.columns < p.count, np.zeros(RECEIVERS)
    np.add.at(square, np.repeat(np.arange(rows.rows), np.diff(rows.indptr))[mine], rows.se[mine, 0].astype(float) ** 2)
    return np.asarray(rows.matrix()[:, : p.count].sum(axis=1)), square


def _root_mean_square(errors: F64) -> Reading:
    """With its standard error, 1 / √(2 n) of it for normal errors, more where tails are heavier."""
    rms = float(np.sqrt((errors**2).mean()))
    tails = math.sqrt(max(1.0, float(((errors / rms) ** 4).mean()) / 2.0))
    return Reading(rms, tails * rms / math.sqrt(2.0 * len(errors)), len(errors))


def _half_side(wanted: float) -> float:
    """Half the side, m, of the square 1 m away whose form factor is `wanted`."""

    def form_factor(log_a: float) -> float:
        a = math.exp(log_a)
        p = math.sqrt(1.0 + a * a)
        return 4.0 * (a / p * math.atan(a / p) / math.pi) - wanted

    return math.exp(brentq(form_factor, -20.0, 20.0, xtol=1e-14))
