"""B1 to B8 of the failure catalogue: radiosity. What is measured is in measure_radiosity, measure_rooms and measure_opening."""

from __future__ import annotations

import math

from .case import Band, Case, Curve, at_least, at_most, within
from .late import late

MAX_RADIUS = 0.999  # from which on the solver refuses; see reference/transport/spectral.py
STEP_TOLERANCE, LAG = 1e-3, 0.01


def _steps(tolerance: float, albedo: float) -> float:
    """Bounces until `tolerance` of the light is left."""
    return math.log(tolerance) / math.log(albedo)


def _taken(loss: float) -> bool:
    """Whether the solver takes a scene of this albedo."""
    return 1.0 - loss < MAX_RADIUS - 1e-9


def _jacobi(loss: float) -> Band:
    steps = _steps(STEP_TOLERANCE, 1.0 - loss)
    return Band(steps - 1.0, 1.01 * steps + 1.0)


def _faster(loss: float) -> Band:
    return Band(0.0, 0.75 * _steps(STEP_TOLERANCE, 1.0 - loss) + 2.0)


def _lag(albedo: float) -> Band:
    steps = _steps(LAG, albedo)
    return Band(math.floor(steps), math.ceil(steps) + 1.0)


SLOW = Case(
    id="B1",
    title="slow convergence as the albedo goes to 1",
    scene="a closed cube whose walls all shine: B = M / (1 - ρ)",
    parameter="1 - albedo",
    unit="",
    values=(5e-4, 1e-3, 2e-3, 1e-2, 0.1, 0.5),
    metric="row operations per patch until 0.001 of the source is left; error of the radiosity over that; refused: 1",
    curves=(
        Curve(
            "jacobi",
            _jacobi,
            "one bounce a sweep: ln 0.001 / ln ρ = 66, 688 at ρ = 0.9, 0.99 (catalogue B1)",
            where=_taken,
        ),
        Curve(
            "gauss-seidel", _faster, "uses what earlier rows have just got: about half of Jacobi's sweeps", where=_taken
        ),
        Curve("southwell", _faster, "shoots the largest residual first", where=_taken),
        Curve("error left, of the tolerance", at_most(1.001), "what is unshot is all that is missing", where=_taken),
        Curve(
            "off a dense solve, of the tolerance",
            at_most(1.05),
            "the cube lit by one wall against a dense solve: a solver that stops early leaves out more than it was asked to",
            where=_taken,
        ),
        Curve(
            "refused",
            lambda loss: Band(0.0, 0.0) if _taken(loss) else Band(1.0, 1.0),
            "from a spectral radius of 0.999 on (6,905 sweeps) the scene is refused, with the albedo that causes it",
        ),
    ),
    measure=late("measure_radiosity", "slow_convergence"),
    log=True,
    breaks="refused",
    limit=0.5,
    notes=("milliseconds per row operation: `lightgauge bench transport`",),
)

SPHERE = Case(
    id="B2",
    title="solver error apart from discretisation error",
    scene="inside of a ball that sends 1 + y: B = M + ρ M̄ / (1 - ρ); icospheres of 20, 80 and 320 facets, a patch each",
    parameter="subdivisions",
    unit="",
    values=(0.0, 1.0, 2.0),
    metric="relative error of the irradiance; order: logarithm to base 2 of the error's ratio to the coarser ball",
    curves=(
        Curve("solvers", at_most(1e-6), "F_ij = A_j / A: the closed form is the solution, whatever the exitance (Walsh 1920)"),
        Curve("whole", lambda level: at_most(0.03 * 4.0**-level)(level), "facets are h² off the ball"),
        Curve("order of the whole", within(1.8, 2.2), "h²: an order off this is a broken rate, however small the error",
              where=lambda level: level > 0.0),
        Curve("single facets", lambda level: at_most(0.02 * 2.0**-level)(level), "its normal is the ball's beside its centre"),
    ),
    measure=late("measure_radiosity", "sphere"),
    whole=True,
    notes=(
        "the catalogue's h² holds for the field as a whole (order 2.00, 1.97); from facet to facet the irradiance deviates with h "
        "(order 1.48, 1.38, on its way to 1), because the facets of an icosphere are not equilateral: case R1 takes that apart",
    ),
)  # fmt: skip

ENERGY = Case(
    id="B3",
    title="energy made or lost",
    scene="a closed room of several colours with a lamp, a pillar and a table",
    parameter="rays per patch",
    unit="",
    values=(64.0, 256.0, 1024.0, 4096.0),
    metric="|Σ A (B (1 - ρ) - M)| / Σ A M, worst colour",
    curves=(
        Curve("reconciled (ours)", at_most(1e-4), "reciprocal and closed rows keep energy at any number of rays (catalogue B3)"),
        Curve("rays as they are", None, "rows that are not reciprocal make light from nothing", stated=at_least(2e-4)),
        Curve("off a dense solve, of the tolerance", at_most(2.0),
              "what is unshot is missing, 1e-6 of the source, beside the rounding of single precision; stopping early shows"),
    ),
    measure=late("measure_radiosity", "energy"),
    log=True,
    whole=True,
)  # fmt: skip

WALL = Case(
    id="B4",
    title="patches that run under a wall",
    scene="two rooms, a wall of 0.1 m between, a lamp in one; the worst of four places of the wall in the grid of patches",
    parameter="patch size over wall thickness",
    unit="",
    values=(0.6, 0.8, 1.5, 3.0, 6.0),
    metric="radiosity of the dark room, of the lit one's; light missing beside the wall, of what there should be",
    curves=(
        Curve(
            "leak",
            at_most(1e-3),
            "a patch larger than the wall is thick lies on both sides of it (catalogue B4)",
            stated=lambda size: Band(0.0, 0.02 * size) if size > 1.0 else Band(0.0, 1e-3),
        ),
        Curve(
            "leak, patches cut, one place",
            at_most(1e-3),
            "three cuts of a patch (radiosity.patch_error) bring it under the wall's thickness only where the pilot sees a difference",
            stated=lambda size: Band(0.0, 0.01 * size),
            where=lambda size: size > 1.0,
        ),
        Curve(
            "overdark",
            at_most(0.1),
            "a patch is one value: what is brighter within it than its mean is missed, however small beside a wall's shadow line",
            stated=within(0.0, 0.5),
        ),
    ),
    measure=late("measure_rooms", "wall_over_patches"),
    log=True,
    breaks="leak",
    limit=1e-3,
)  # fmt: skip

GLOSS = Case(
    id="B5",
    title="gloss treated as diffuse",
    scene="a room whose floor is a blend of paint and rough metal (α = 0.1), both of reflectance 0.6, a lamp on a wall",
    parameter="share of metal",
    unit="",
    values=(0.0, 0.05, 0.2, 0.5, 1.0),
    metric="irradiance on a wall and the ceiling against paths: relative RMS error, signed mean",
    curves=(
        Curve(
            "relRMSE",
            at_most(0.03),
            "a model error: the bake spreads gloss over all directions; under 3 % it is not worth modelling (catalogue B5)",
            stated=lambda metal: Band(0.0, 0.03 + 0.35 * metal),
        ),
        Curve(
            "signed mean",
            within(-0.03, 0.03),
            "light that gloss sends elsewhere is missing where it goes: named a model error, not corrected",
            stated=lambda metal: Band(-0.03 - 0.25 * metal, 0.03),
        ),
    ),
    measure=late("measure_rooms", "gloss"),
    breaks="relRMSE",
    limit=0.03,
)

TEXTURE = Case(
    id="B6",
    title="textures finer than patches",
    scene="a floor with a checkerboard under a ceiling that shines, patches of 1 m",
    parameter="cycles per patch",
    unit="",
    values=(0.25, 0.5, 1.0, 2.0, 4.0, 8.0),
    metric="albedo of patches against the picture's mean, rms; irradiance on a wall and the ceiling against paths",
    curves=(
        Curve("albedo of patches", at_most(0.01), "each patch reflects the mean of its picture, however fine (catalogue B6)"),
        Curve(
            "albedo of patches, four looks",
            None,
            "few looks at a picture find one colour or the other: √(0.6² / 4) = 30 % where squares are smaller than patches",
            stated=lambda cycles: Band(0.15, 0.45) if cycles >= 1.0 else Band(0.0, 0.45),
        ),
        Curve("signed mean", within(-0.03, 0.03), "average albedo times incident light: the room's light is kept (catalogue B6)"),
        Curve("relRMSE", at_most(0.05), "half a patch off edges, patches of 1 m hold the room's light, textured or not"),
    ),
    measure=late("measure_rooms", "checkerboard"),
    log=True,
    breaks="albedo of patches",
    limit=0.01,
)  # fmt: skip

MOVING_LIGHT = Case(
    id="B7",
    title="one bounce an update under changing light",
    scene="a closed cube whose walls are switched on, and off",
    parameter="albedo",
    unit="",
    values=(0.5, 0.7, 0.9, 0.99),
    metric="updates until within 1 %",
    curves=(
        Curve("on", _lag, "lag = ln 0.01 / ln ρ: 7, 44, 459 updates at 0.5, 0.9, 0.99 (catalogue B7)"),
        Curve("off", _lag, "light dies as it grows"),
        Curve("foretold", _lag, "the product says the lag from the spectral radius, before any light moves"),
    ),
    measure=late("measure_radiosity", "lag"),
)


def _from_a_hundredth(area: float) -> bool:
    """Where closed forms have an answer at a tenth of the area, too."""
    return area >= 0.00999


OPENING = Case(
    id="B8",
    title="a tiny opening between rooms",
    scene="a lit and a black room of 1 m³, a thin wall with a square hole",
    parameter="area of the hole",
    unit="m²",
    values=(1e-6, 1e-5, 1e-4, 1e-3, 1e-2, 0.1, 1.0),
    metric="power that reaches the black room, of what falls on the hole; seeds in which nothing does, number and share; exponents "
    "in the area over the decade below",
    curves=(
        Curve(
            "rays (ours)",
            lambda area: within(0.85, 1.15)(area) if area >= 1e-2 else Band(),
            "energy goes as the area; under 0.01 m² so few of 4,096 rays a patch find the hole that noise is as large: not judged",
        ),
        Curve(
            "closed forms (ours)",
            lambda area: within(0.98, 1.02)(area) if area >= 1e-3 else Band(),
            "energy goes as the area: shadow rays towards the hole's own share; under 0.001 m² they miss it as well, not judged",
        ),
        Curve(
            "exponent, rays",
            within(0.9, 1.1),
            "power over what falls on a square metre of the hole goes as its area (catalogue B8)",
            where=lambda area: area >= 0.0999,
        ),
        Curve("exponent, closed forms", within(0.97, 1.03), "as by rays", where=_from_a_hundredth),
        Curve(
            "exponent of the power, rays", None, "as it is: a large hole also lets more of the lit room's light be lost"
        ),
        Curve(
            "exponent of the power, closed forms",
            lambda area: within(0.96, 1.04)(area) if area <= 1e-2 else Band(),
            "energy goes as the area where the hole is small beside the room (catalogue B8)",
            where=_from_a_hundredth,
        ),
        Curve("least of any seed", at_least(0.0), "light is finite and never negative, whatever the rays have missed"),
        Curve(
            "most of any seed, closed forms",
            at_most(5.0),
            "no more arrives than falls on the hole, but for the few shadow rays that find it: closing rows must not run away",
        ),
        Curve(
            "seeds without an answer, rays",
            at_most(0.0),
            "an opening that no ray finds is dark: under 2e-5 m² fewer than one of all rays is expected through it",
            stated=lambda area: Band(low=0.0) if area <= 1e-4 else Band(0.0, 0.0),
        ),
        Curve("share without an answer, rays", None, "where the answer becomes 0"),
    ),
    measure=late("measure_opening", "tiny_opening"),
    log=True,
    breaks="share without an answer, rays",
    limit=0.5,
)

CASES: tuple[Case, ...] = (SLOW, SPHERE, ENERGY, WALL, GLOSS, TEXTURE, MOVING_LIGHT, OPENING)
