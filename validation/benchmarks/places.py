"""What benches measure on: bundled scenes, the folder of published answers, cubes in cubes."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from ...reference.config import SceneSettings
from ...reference.datatypes import F64, I64, Material, Mesh, Scene
from ...reference.scene.load import load_scene
from ...reference.transport.patches import Patches, build_patches
from ...reference.visibility import Geometry, build_geometry
from ..sources import REPOSITORY, VARIABLE, resolve_scene
from .rows import CannotMeasure

WHOLE = 100.0  # m: larger than any quad here, so that each stays one patch


def bundled(name: str) -> Scene:
    """A scene by name."""
    return load_scene(resolve_scene(name))


def truth_file(name: str) -> Path:
    """A file of published answers. Raises CannotMeasure where it is not there."""
    listed = [Path(part) / ".." / "truth" for part in os.environ.get(VARIABLE, "").split(os.pathsep) if part]
    folders = [*listed, REPOSITORY / ".." / "shared" / "truth"]
    for folder in folders:
        if (folder / name).is_file():
            return (folder / name).resolve()
    raise CannotMeasure(
        f"the published answers {name} are not in {folders[-1].resolve()}. To mend it: "
        f"export {VARIABLE}=FOLDER, where FOLDER/../truth/{name} is"
    )


def split(corners: F64, n: int) -> F64:
    """A parallelogram (4, 3) cut into n × n, (n², 4, 3), corners in the same order."""
    a, along, across = corners[0], (corners[1] - corners[0]) / n, (corners[3] - corners[0]) / n
    ring = np.array([[0, 0], [1, 0], [1, 1], [0, 1]])
    i, j = (m.ravel() for m in np.meshgrid(np.arange(n), np.arange(n), indexing="ij"))
    at = np.stack([i, j], axis=1)[:, None, :] + ring
    return np.asarray(a + at[..., :1] * along + at[..., 1:] * across)


def cube_faces(half: float, inward: bool) -> list[F64]:
    """Corners (4, 3) of the faces of the cube [-half, half]³, counter-clockwise from where they look."""
    faces = []
    for axis in range(3):
        for side in (-1.0, 1.0):
            ring = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]], dtype=np.float64)
            ring = ring[::-1] if (side > 0.0) == inward else ring
            corners = np.full((4, 3), side)
            corners[:, (axis + 1) % 3], corners[:, (axis + 2) % 3] = ring.T
            faces.append(half * corners)
    return faces


def cube_in_cube(outer: int, inner: int) -> F64:
    """Quads (N, 4, 3) m of the cube [-1.5, 1.5]³ seen from inside, each face cut outer × outer, around [-0.5, 0.5]³ seen
    from outside, cut inner × inner: N = 6 (outer² + inner²)."""
    large = [split(face, outer) for face in cube_faces(1.5, inward=True)]
    small = [split(face, inner) for face in cube_faces(0.5, inward=False)]
    return np.concatenate(large + small)


def scene_of_quads(quads: Sequence[F64] | F64) -> Scene:
    """Each quad (4, 3) m is a mesh with a material of its own, so that patches never reach over two."""
    faces, none = np.array([[0, 1, 2], [0, 2, 3]], dtype=np.int32), np.zeros(3)
    meshes = [
        Mesh(f"quad{i}", np.asarray(q, np.float64), faces, None, i, True, True, None, none, False, False)
        for i, q in enumerate(quads)
    ]
    materials = [Material(f"grey{i}", np.full(3, 0.5)) for i in range(len(meshes))]
    settings = SceneSettings.model_validate({"materials": {}, "meshes": {}})
    return Scene("quads", settings, tuple(meshes), tuple(materials), None, (), "0")


def quad_patches(scene: Scene) -> tuple[Geometry, Patches, I64]:
    """Geometry and patches of `scene_of_quads`, and the patch (N,) of each quad."""
    g = build_geometry(scene)
    p = build_patches(scene, g, WHOLE)
    patch = np.zeros(len(scene.meshes), dtype=np.int64)
    patch[g.mesh[p.element_triangle]] = p.element_patch
    return g, p, patch
