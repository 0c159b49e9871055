"""Cases A9 and A10: thin and one-sided surfaces, and meshes that are not what they should be."""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np

from ...reference.datatypes import F64, I64, Mesh, Scene
from ...reference.errors import InputError
from ...reference.progress import silent
from ...reference.scene.document import MeshArrays
from ...reference.scene.mesh_repair import repair
from ...reference.sky import SKY_BINS
from ...reference.transport.form_factors import patch_form_factors, point_form_factors
from ...reference.transport.gather import upload
from ...reference.transport.patches import build_patches
from ...reference.transport.radiosity import solve
from ...reference.visibility import build_geometry
from .case import Reading
from .measure_factors import opposite_squares
from .scenes import ball, grey, mesh, owners, plate, quads_mesh, scene_of

# A9 ------------------------------------------------------------------------------------------------------------------

SHEET, SHEET_ALBEDO = 0.7, 0.5  # height, m, off the middle of the scene, where single precision is finest
SHEET_RAYS, BELOW = 1 << 16, 256


def thin_sheet(gap: float, seed: int) -> Mapping[str, Reading]:
    """A sheet of two one-sided quads `gap` m apart, back to back, between a lamp above and a black floor: rays from below that
    meet the upper quad, of all that meet the sheet; what the dark side sends, of what the lit side does. And what a single sheet
    does not reflect of light on its back, tagged two-sided and not."""
    unit = (0.0, 1.0)
    doubled = _lit([plate(unit, unit, SHEET + gap, up=True), plate(unit, unit, SHEET, up=False)], False)
    lit, dark = _sent(doubled, seed)[2:4]
    behind = plate(unit, unit, SHEET, up=False)  # its front looks away from the lamp
    expected = SHEET_ALBEDO * opposite_squares(1.0 - SHEET)
    missing = [1.0 - _sent(_lit([behind], tag), seed)[2:].max() / expected for tag in (True, False)]
    return {
        "flips": Reading(_flips(doubled, seed), 0.0, BELOW * 1024),
        "dark side": Reading(float(dark / lit), 0.0, SHEET_RAYS),
        "lost at the back, tagged": Reading(float(abs(missing[0])), 0.0, SHEET_RAYS),
        "lost at the back, not tagged": Reading(float(missing[1]), 0.0, SHEET_RAYS),
    }


def _lit(sheets: list[F64], two_sided: bool) -> Scene:
    """Black floor, lamp of exitance 1 W·m⁻² at 1 m, and sheets between."""
    unit = (0.0, 1.0)
    floor = quads_mesh([plate(unit, unit, 0.0, up=True)])
    lamp = quads_mesh([plate(unit, unit, 1.0, up=False)], exitance=1.0)
    between = [quads_mesh([q], material=1 + i) for i, q in enumerate(sheets)]
    return scene_of([floor, lamp, *between], [grey(0.0), *[grey(SHEET_ALBEDO, two_sided) for _ in sheets]])


def _sent(s: Scene, seed: int) -> F64:
    """Radiosity, W·m⁻², of each mesh's front, then of the backs of those that reflect at both."""
    g = build_geometry(s)
    p = build_patches(s, g, 10.0)
    rows = upload(patch_form_factors(g, p, SHEET_RAYS, seed, silent))
    b = solve(s, p, rows, np.zeros((p.count, 3)), 1e-6).radiosity[:, 0]
    order = np.argsort(owners(g, p)[: p.front])
    return np.concatenate([b[: p.front][order], b[p.front :]])


def _flips(s: Scene, seed: int) -> float:
    """Share of the rays from the floor to the sheet that meet the black back of the upper quad."""
    g = build_geometry(s)
    p = build_patches(s, g, 10.0)
    at = np.random.default_rng([seed, 6]).random((BELOW, 3)) * (1.0, 0.0, 1.0)
    rows = point_form_factors(g, p, at, np.tile([0.0, 1.0, 0.0], (BELOW, 1)), 1024, seed, silent)
    sums = np.asarray(rows.matrix().sum(axis=0)).ravel()
    wrong = sums[p.count + SKY_BINS] + sums[: p.count][owners(g, p) == 2].sum()
    return float(wrong / (wrong + sums[: p.count][owners(g, p) == 3].sum()))


# A10 -----------------------------------------------------------------------------------------------------------------

SUBDIVISIONS, PATCH, MESH_RAYS = 3, 0.25, 1024
Fault = Callable[[F64, I64, I64], tuple[F64, I64]]


def bad_mesh(faults: float, seed: int) -> Mapping[str, Reading]:
    """Light that leaves a closed ball of 1,280 faces of which `faults` are bad, by kind of fault, after the loader's repair; the
    same for flipped faces without repair; and kinds that lose light of which the loader says nothing."""
    whole = ball(SUBDIVISIONS)
    chosen = _apart(whole.faces.astype(np.int64), int(faults), seed)
    found: dict[str, Reading] = {}
    silently = 0
    for name, fault in KINDS.items():
        vertices, faces = fault(whole.vertices, whole.faces.astype(np.int64), chosen)
        try:
            mended = repair(MeshArrays(vertices, faces.astype(np.int32)), name, has_front=True)
        except InputError:
            continue  # refused, loudly
        m = mended.mesh
        lost = _lost(mesh(m.vertices, m.faces, closed=mended.closed), seed)
        found[name] = lost
        silently += not mended.notes and lost.value > 0.0
        if name == "flipped":
            found["flipped, not repaired"] = _lost(mesh(vertices, faces), seed)
    return {**found, "kinds not said": Reading(float(silently), 0.0, len(KINDS))}


def _lost(piece: Mesh, seed: int) -> Reading:
    """Share of the rays of all patches that end on no front."""
    s = scene_of([piece])
    g = build_geometry(s)
    p = build_patches(s, g, PATCH)
    rows = patch_form_factors(g, p, MESH_RAYS, seed, silent)
    kept = rows.matrix()[:, : p.count].sum(axis=1)
    return Reading(float(p.area @ (1.0 - kept) / p.area.sum()), 0.0, MESH_RAYS * p.count)


def _apart(faces: I64, count: int, seed: int) -> I64:
    """Faces, some random ones of which no two have a corner in common, with their neighbours'."""
    taken = np.zeros(int(faces.max()) + 1, bool)
    chosen: list[int] = []
    for face in np.random.default_rng([seed, 7]).permutation(len(faces)):
        if len(chosen) < count and not taken[faces[face]].any():
            chosen.append(int(face))
            taken[faces[np.isin(faces, faces[face]).any(axis=1)].ravel()] = True
    return np.array(chosen)


def _across(faces: I64, face: int) -> tuple[int, int]:
    """The face on the other side of the first edge of `face`, and its corner that is not on that edge."""
    a, b, _ = faces[face]
    both = np.isin(faces, [a, b]).sum(axis=1) == 2
    both[face] = False
    other = int(np.flatnonzero(both)[0])
    return other, int(next(c for c in faces[other] if c not in (a, b)))


def _duplicate(vertices: F64, faces: I64, chosen: I64) -> tuple[F64, I64]:
    return vertices, np.concatenate([faces, faces[chosen]])


def _flipped(vertices: F64, faces: I64, chosen: I64) -> tuple[F64, I64]:
    turned = faces.copy()
    turned[chosen] = turned[chosen][:, ::-1]
    return vertices, turned


def _sliver(vertices: F64, faces: I64, chosen: I64) -> tuple[F64, I64]:
    """Both faces at an edge are cut at 10^-k of its length, k from 1 to 7 in turn."""
    points, new, gone = list(vertices), [], []
    for number, face in enumerate(chosen):
        a, b, c = faces[face]
        other, d = _across(faces, int(face))
        v = len(points)
        points.append(vertices[a] + 10.0 ** -(1 + number % 7) * (vertices[b] - vertices[a]))
        new += [(a, v, c), (v, b, c), (v, a, d), (b, v, d)]
        gone += [int(face), other]
    return np.array(points), np.concatenate([np.delete(faces, gone, axis=0), np.array(new)])


def _t_junction(vertices: F64, faces: I64, chosen: I64) -> tuple[F64, I64]:
    """One of the faces at an edge is cut in its middle."""
    points, new = list(vertices), []
    for face in chosen:
        a, b, c = faces[face]
        new += [(a, len(points), c), (len(points), b, c)]
        points.append(0.5 * (vertices[a] + vertices[b]))
    return np.array(points), np.concatenate([np.delete(faces, chosen, axis=0), np.array(new)])


def _fin(vertices: F64, faces: I64, chosen: I64) -> tuple[F64, I64]:
    """A third face stands on an edge, into the ball."""
    points, new = list(vertices), []
    for face in chosen:
        a, b, _ = faces[face]
        new.append((a, b, len(points)))
        points.append(0.45 * (vertices[a] + vertices[b]))
    return np.array(points), np.concatenate([faces, np.array(new)])


KINDS: Mapping[str, Fault] = {
    "duplicate": _duplicate,
    "flipped": _flipped,
    "sliver": _sliver,
    "T-junction": _t_junction,
    "fin": _fin,
}
