"""Error against time on cubes in cubes: rays alone, and the hybrid with closed forms.

204 quads have a published matrix, so the error is the root mean square over all pairs of F - F_true. 1,920 have none: there it is
the root mean square of the standard errors, which tests/truth calibrates. Seconds run from the mesh to the finished rows:
ray caster, patches, rays, closed forms, reconciling. A hybrid's `noise` is the standard error over a row; over a pair it is about
noise / √patches. Rays alone are as they were cast; `boxinbox_indirect_*` says what indirect light comes of them once reconciled, and of
the hybrid with as many rays: rms error of B - E over its mean, from a dense solution, at three albedos.
"""

from __future__ import annotations

import time
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from ...reference.datatypes import F64, Scene
from ...reference.progress import Progress, silent
from ...reference.transport.form_factors import FormFactors, patch_form_factors
from ...reference.transport.hybrid import hybrid_form_factors
from ...reference.transport.reconcile import reconcile
from ...reference.variant import ensure_variant
from .places import cube_in_cube, quad_patches, scene_of_quads, truth_file
from .rows import Group, Row, Wanted, row_of

TRUTH = "boxinbox_204_truth.npz"
RAYS = (256, 1024, 4096, 16384, 65536)
NOISES = ("1e-2", "1e-3", "1e-4")
HYBRID_NOISE = 2.5e-4  # 1e-5 rms per pair
LARGE, LARGE_NOISE = (16, 8), 2.5e-4  # cuts of outer and inner faces; 5.3e-6 per pair
LARGE_SE, LARGE_S = 5.5e-6, 9.8  # View3D 4.0's error on 204 and seconds on 1,920 (truth/README.md)
OUTSIDE_RAYS = 64  # rays of the hybrid: in a closed scene they only say that nothing leaves it
REPEATS = 3
ALBEDOS = ("0.5", "0.9", "0.99")
BUDGET, BUDGET_NOISE = 4096, 5.2e-4  # rays per patch of all kinds, and the noise at which the hybrid stays under them
INDIRECT_TARGET = 1e-3
INDIRECT = tuple(f"{method}_rho_{a}" for method in ("rays", "hybrid") for a in ALBEDOS)


@dataclass(frozen=True, eq=False)
class Box:
    """A cube in a cube with its true form factors (N, N)."""

    scene: Scene
    quads: F64
    truth: F64


@dataclass(frozen=True, eq=False)
class Built:
    """Form factors (N, N) in the order of the quads, seconds and processor seconds they took, and the root mean square
    of their standard errors over all pairs."""

    rows: FormFactors
    matrix: F64
    seconds: float
    cpu_seconds: float
    se: float


def published_box() -> Box:
    """The 204 quads. Raises CannotMeasure without the file."""
    with np.load(truth_file(TRUTH), allow_pickle=False) as z:
        return Box(scene_of_quads(z["quads"]), np.array(z["quads"]), np.array(z["F"]))


def build(scene: Scene, rays: int, noise: float | None, seed: int) -> Built:
    """Form factors of quads by `rays` per patch, or, given `noise`, by closed forms and as many shadow rays as it takes."""
    begin, cpu = time.perf_counter(), time.process_time()
    g, p, patch = quad_patches(scene)
    rows = patch_form_factors(g, p, rays, seed, silent)
    if noise is not None:
        rows = hybrid_form_factors(g, p, rows, noise, seed, silent).laws.rows
    seconds, cpu_seconds = time.perf_counter() - begin, time.process_time() - cpu
    n = len(scene.meshes)
    se = float(np.sqrt((rows.se.astype(np.float64) ** 2).sum())) / n
    matrix = rows.matrix()[:, :n].toarray()[np.ix_(patch, patch)].astype(np.float64)
    return Built(rows, matrix, seconds, cpu_seconds, se)


def rms(found: F64, truth: F64) -> float:
    """Root mean square over pairs."""
    return float(np.sqrt(((found - truth) ** 2).mean()))


@dataclass(frozen=True)
class Setting:
    """A point of the curve. name: as in `boxinbox_NAME_rms`; target: of its rms."""

    name: str
    rays: int
    noise: float | None
    target: float | None = None

    @property
    def names(self) -> tuple[str, str]:
        """Names of its two rows."""
        return f"boxinbox_{self.name}_rms", f"boxinbox_{self.name}_s"


SETTINGS = (
    Setting("hybrid", OUTSIDE_RAYS, HYBRID_NOISE, 1e-5),
    *(Setting(f"rays_{n}", n, None) for n in RAYS),
    *(Setting(f"hybrid_{noise}", OUTSIDE_RAYS, float(noise)) for noise in NOISES),
)


def curve(wanted: Wanted, progress: Progress) -> Iterator[Row]:
    """Error and time of every setting that is wanted, repeats in turn, each with a seed of its own."""
    ensure_variant()
    box, chosen = published_box(), [s for s in SETTINGS if wanted & set(s.names)]
    build(box.scene, OUTSIDE_RAYS, 1e-2, 0)  # compiles
    found: dict[str, list[tuple[float, float]]] = {s.name: [] for s in chosen}
    for repeat in range(REPEATS):
        for done, s in enumerate(chosen):
            progress("cube in a cube", repeat * len(chosen) + done, REPEATS * len(chosen))
            built = build(box.scene, s.rays, s.noise, 1 + repeat)
            found[s.name].append((rms(built.matrix, box.truth), built.seconds))
    for s in chosen:
        errors, seconds = zip(*found[s.name], strict=True)
        note = f"{len(box.quads)} quads, " + (f"{s.rays} rays per patch" if s.noise is None else f"noise {s.noise:g}")
        yield row_of(s.names[0], errors, "per pair", "lower", s.target, note)
        yield row_of(s.names[1], seconds, "s", "lower", note=note)


def indirect_error(f: F64, emitted: F64, radiosity: F64, albedo: float) -> float:
    """Rms error over patches of the indirect radiosity that form factors f (N, N) give, over its mean. radiosity (N,): the truth."""
    exact = radiosity - emitted
    found = np.linalg.solve(np.eye(len(f)) - albedo * f, emitted) - emitted
    return float(np.sqrt(((found - exact) ** 2).mean()) / exact.mean())


def indirect(progress: Progress, repeats: int = REPEATS) -> Iterator[Row]:
    """Indirect light from BUDGET rays per patch, reconciled, and from a hybrid that spends no more."""
    ensure_variant()
    with np.load(truth_file(TRUTH), allow_pickle=False) as z:
        truth = {name: np.array(z[name]) for name in ("quads", "E", *(f"B_rho{a}" for a in ALBEDOS))}
    g, p, patch = quad_patches(scene_of_quads(truth["quads"]))
    errors: dict[str, list[float]] = {name: [] for name in INDIRECT}
    for repeat in range(repeats):
        progress("indirect light in a cube in a cube", repeat, repeats)
        few = patch_form_factors(g, p, OUTSIDE_RAYS, 1 + repeat, silent)
        for method, laws in (
            ("rays", reconcile(patch_form_factors(g, p, BUDGET, 1 + repeat, silent), p.area)),
            ("hybrid", hybrid_form_factors(g, p, few, BUDGET_NOISE, 1 + repeat, silent).laws),
        ):
            f = laws.rows.matrix().toarray()[np.ix_(patch, patch)].astype(np.float64)
            for a in ALBEDOS:
                errors[f"{method}_rho_{a}"].append(indirect_error(f, truth["E"], truth[f"B_rho{a}"], float(a)))
    for name, values in errors.items():
        note = f"at most {BUDGET} rays per patch in all; rms over {len(patch)} patches, relative to their mean"
        yield row_of(f"boxinbox_indirect_{name}", values, "relative", "lower", INDIRECT_TARGET, note)


def large(
    progress: Progress, cuts: tuple[int, int] = LARGE, noise: float = LARGE_NOISE, repeats: int = REPEATS
) -> Iterator[Row]:
    """1,920 quads at the standard error per pair that View3D reaches on 204."""
    ensure_variant()
    scene = scene_of_quads(cube_in_cube(*cuts))
    build(scene, OUTSIDE_RAYS, 1e-2, 0)  # compiles
    found: list[Built] = []
    for repeat in range(repeats):
        progress("large cube in a cube", repeat, repeats)
        found.append(build(scene, OUTSIDE_RAYS, noise, 1 + repeat))
    note = f"{len(scene.meshes)} quads, noise {noise:g}; standard error, root mean square over pairs"
    yield row_of("boxinbox_1920_rms", [b.se for b in found], "per pair", "lower", LARGE_SE, note)
    note = "on all cores; View3D 4.0 on one core of the machine of truth/README.md: 9.8 s"
    yield row_of("boxinbox_1920_s", [b.seconds for b in found], "s", "lower", LARGE_S, note)
    note = "processor seconds of all threads, for comparison with one core"
    yield row_of("boxinbox_1920_cpu_s", [b.cpu_seconds for b in found], "s", "lower", note=note)


GROUPS = (
    Group(tuple(name for s in SETTINGS for name in s.names), curve),
    Group(tuple(f"boxinbox_indirect_{name}" for name in INDIRECT), lambda wanted, progress: indirect(progress)),
    Group(("boxinbox_1920_rms", "boxinbox_1920_s", "boxinbox_1920_cpu_s"), lambda wanted, progress: large(progress)),
)
