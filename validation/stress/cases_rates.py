"""Rates of convergence: R1 … R4. Each stage of the product is refined, and the exponent of its error is held against the theory's.

A rate that is broken is a failure even where the error is small: it says that something is of lower order than it should be, or is
not being refined at all.
"""

from __future__ import annotations

from .case import Case, Curve, at_most, within
from .late import late

R1 = Case(
    id="R1",
    title="Patch size",
    scene="inside of an icosphere under radiosity that rises with height; a floor with a slanting edge of shadow",
    parameter="coarsest patch",
    unit="m",
    values=(0.55, 1.1),
    metric="exponent of the error in patch size",
    curves=(
        Curve("sphere of facets", within(1.8, 2.7), "flat facets lie h²/8 under the sphere: h², from above (catalogue B2)"),
        Curve("single facets", within(0.9, 1.25),
              "a facet's normal at its centroid misses the sphere's by h where it is not equilateral: h, and h² beside it [A]"),
        Curve("single facets, over theory", within(0.9, 1.1),
              "of half the light's rise times the tilt's height, which is what that costs to first order; not an exponent [A]"),
        Curve("edge of a shadow", within(0.8, 1.2), "patches cut by the edge are a share h of all, each wrong in part: h [A]"),
    ),
    measure=late("rates_measured", "patch_size"),
    log=True,
    notes=(
        "Sphere of facets: what is left of the rise with height. Tilts do not add up to any: they turn one way as often as the other.",
        "From facet to facet the order is 1 (1.16, 1.01), because an icosphere's triangles never become equilateral, however small.",
    ),
)  # fmt: skip

R2 = Case(
    id="R2",
    title="Rays per row",
    scene="a closed room with a block; rows of points and of patches",
    parameter="rays",
    unit="",
    values=(128.0, 512.0, 2048.0),
    metric="exponent of the RMS error of an entry in the number of rays, from here to four times as many",
    curves=(
        Curve("points", within(-0.85, -0.6), "scrambled nets in two dimensions over sets with an edge: -3/4 (He and Wang 2015)"),
        Curve("patches", within(-0.75, -0.53), "the same in four dimensions: -1/2 - 1/8 (He and Wang 2015)"),
        Curve("independent rays", None, "independent rays give -1/2, whatever they meet", stated=within(-0.54, -0.46)),
    ),
    measure=late("rates_measured", "rays"),
    log=True,
    whole=True,
    notes=(
        "He and Wang, On the convergence rate of randomized quasi-Monte Carlo for discontinuous functions, 2015: N^(-1/2 - 1/(2d)).",
        "With eight randomisations of N / 8 points each, the exponent is approached from above: small nets are nearly independent.",
    ),
)  # fmt: skip

R3 = Case(
    id="R3",
    title="Bounces",
    scene="a closed room of one albedo whose floor emits",
    parameter="albedo",
    unit="",
    values=(0.3, 0.5, 0.7, 0.9),
    metric="factor by which a sweep shrinks the error, over the albedo",
    curves=(
        Curve("jacobi", within(0.99, 1.01), "rows sum to one, so the error falls as ρ^k (catalogue B1)"),
        Curve("one-bounce", within(0.99, 1.01), "one bounce an update is Jacobi from frame to frame (catalogue B7)"),
        Curve("gauss-seidel", at_most(0.97), "Gauss-Seidel is faster for non-negative matrices (Stein and Rosenberg 1948)"),
    ),
    measure=late("rates_measured", "bounces"),
)  # fmt: skip

R4 = Case(
    id="R4",
    title="Voxel size",
    scene="uniform probes in a cube of 1 m, light of two waves of 1 m, or a step",
    parameter="coarsest voxel",
    unit="m",
    values=(0.0625, 0.125),
    metric="exponent of the RMS error of sampled irradiance in voxel size, from here to half of it",
    curves=(
        Curve("smooth light", within(1.85, 2.1), "trilinear interpolation of smooth light: h² [A]"),
        Curve("step of light", within(0.35, 0.65), "a share h of the samples is wrong by a part of the step: √h in the RMS [A]"),
        Curve("half a texel off", None, "read half a voxel to the side, the gradient shows: h", stated=within(0.75, 1.25)),
    ),
    measure=late("rates_measured", "voxel_size"),
    log=True,
)  # fmt: skip

CASES: tuple[Case, ...] = (R1, R2, R3, R4)
