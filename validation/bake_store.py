"""A bake as one file, and back: everything that new light needs, and nothing that light changes.

Arrays by name: `mesh.N.*` geometry, `patches.*`, `rows.NAME.*` form factors of patches, probes, lumels and each cubemap,
`probes.*`, `lumels.*`, `sky.image`. The metadata hold settings, materials, seed, notes and what the bake found out about itself.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
from pydantic import ValidationError

from ..reference.bake_file import WAY_OUT, read_bake, write_bake
from ..reference.config import SceneSettings
from ..reference.datatypes import F64, I32, Bool, Material, Mesh, Scene, Sky
from ..reference.errors import InputError
from ..reference.sky import SKY_BINS
from ..reference.transport.form_factors import FormFactors
from ..reference.transport.lumels import Lumels
from ..reference.transport.patches import Patches

Arrays = dict[str, npt.NDArray[Any]]
KIND = "surfaces, probes, lumels and cubemaps"
PATCHES, PROBES, LUMELS = "patches", "probes", "lumels"
CUBEMAP = "cubemap "  # a cubemap's rows are named by this and its own name
ROW_ARRAYS = ("indptr", "columns", "values", "back_share", "rays", "se")


@dataclass(frozen=True, eq=False)
class Bake:
    """What a bake file holds. scene: without textures and uvs, whose means the patches hold. rows: by receiver.

    probe_positions (R, 3) m; probe_valid (R,); light_from (R,) i32: whose light each probe uses, -1 for none. facts: what the bake
    found out about itself, for people and reports.
    """

    scene: Scene
    seed: int
    patches: Patches
    rows: Mapping[str, FormFactors]
    probe_positions: F64
    probe_valid: Bool
    light_from: I32
    lumels: Lumels
    facts: Mapping[str, Any]


def save(path: Path, bake: Bake) -> None:
    """Write the file whole or not at all. Raises InputError where it cannot be written."""
    scene = bake.scene
    arrays: Arrays = {
        "probes.positions": bake.probe_positions,
        "probes.valid": bake.probe_valid,
        "probes.light_from": bake.light_from,
        **{f"lumels.{f.name}": getattr(bake.lumels, f.name) for f in dataclasses.fields(Lumels)},
    }
    for number, mesh in enumerate(scene.meshes):
        arrays |= {f"mesh.{number}.vertices": mesh.vertices, f"mesh.{number}.faces": mesh.faces}
    if scene.sky is not None:
        arrays["sky.image"] = scene.sky.image
    for f in dataclasses.fields(Patches):
        value = getattr(bake.patches, f.name)
        arrays[f"patches.{f.name}"] = np.asarray(value)
    for name, rows in bake.rows.items():
        arrays |= {f"rows.{name}.{field}": getattr(rows, field) for field in ROW_ARRAYS}
    metadata = {
        "settings": scene.settings.model_dump(mode="json"),
        "seed": bake.seed,
        "materials": [_material(m) for m in scene.materials],
        "meshes": [_mesh(m) for m in scene.meshes],
        "sky": None if scene.sky is None else {"rotation_deg": scene.sky.rotation_deg, "engine": scene.sky.engine_lit},
        "notes": list(scene.notes),
        "receivers": list(bake.rows),
        "facts": dict(bake.facts),
    }
    header = {"kind": KIND, "scene": scene.name, "scene_hash": scene.content_hash, "metadata": metadata}
    write_bake(path, header, arrays)


def load(path: Path) -> Bake:
    """Read and check a bake. Raises InputError naming the file, what is wrong with it, and the way out."""
    header, arrays = read_bake(path)
    try:
        if header["kind"] != KIND:
            raise ValueError(f"holds {header['kind']!r:.60}, not {KIND}")
        return _checked(_bake(header, arrays))
    except (KeyError, TypeError, ValueError, IndexError, ValidationError) as error:
        what = f"lacks {error}" if isinstance(error, KeyError) else str(error).splitlines()[0]
        raise InputError(f"{path}: {what}; {WAY_OUT}") from error


def _material(m: Material) -> dict[str, Any]:
    return {"name": m.name, "albedo": m.albedo.tolist(), "two_sided": m.two_sided, "passes_light": m.passes_light}


def _mesh(m: Mesh) -> dict[str, Any]:
    plain = ("name", "material", "static", "lit_by_probes", "probe_size", "engine_lit", "closed")
    return {name: getattr(m, name) for name in plain} | {"emission": m.emission.tolist()}


def _bake(header: Mapping[str, Any], arrays: Arrays) -> Bake:
    meta = header["metadata"]
    settings = SceneSettings.model_validate(meta["settings"])
    materials = tuple(Material(**{**m, "albedo": np.asarray(m["albedo"], np.float64)}) for m in meta["materials"])
    meshes = tuple(
        Mesh(
            vertices=arrays[f"mesh.{n}.vertices"],
            faces=arrays[f"mesh.{n}.faces"],
            uvs=None,
            **{**m, "emission": np.asarray(m["emission"], np.float64)},
        )
        for n, m in enumerate(meta["meshes"])
    )
    sky = None if meta["sky"] is None else Sky(arrays["sky.image"], meta["sky"]["rotation_deg"], meta["sky"]["engine"])
    patches = Patches(**{f.name: _plain(arrays[f"patches.{f.name}"]) for f in dataclasses.fields(Patches)})
    rows = {
        name: FormFactors(patches=patches.count, **{field: arrays[f"rows.{name}.{field}"] for field in ROW_ARRAYS})
        for name in meta["receivers"]
    }
    scene = Scene(header["scene"], settings, meshes, materials, sky, tuple(meta["notes"]), header["scene_hash"])
    lumels = Lumels(**{f.name: arrays[f"lumels.{f.name}"] for f in dataclasses.fields(Lumels)})
    return Bake(
        scene, meta["seed"], patches, rows, arrays["probes.positions"], arrays["probes.valid"], arrays["probes.light_from"],
        lumels, meta["facts"],
    )  # fmt: skip


def _plain(array: npt.NDArray[Any]) -> Any:
    """An array, or the number of an array without axes."""
    return array if array.ndim else array.item()


def _checked(bake: Bake) -> Bake:
    """What would make a kernel read past its arrays is refused, though the checksum is right. Raises ValueError."""
    p = bake.patches
    for number, mesh in enumerate(bake.scene.meshes):
        _within(f"mesh.{number}.faces", mesh.faces, len(mesh.vertices))
        if not np.isfinite(mesh.vertices).all():
            raise ValueError(f"array mesh.{number}.vertices is not finite")
        _within("a mesh's material", np.array([mesh.material]), len(bake.scene.materials))
    elements = len(p.element_triangle)
    _within("patches.order", p.order, elements)
    _within("patches.start", p.start, elements + 1)
    _within("patches.twin", p.twin, p.front)
    _within("patches.emitter", p.emitter + 1, len(bake.scene.meshes) + 1)
    _within("probes.light_from", bake.light_from + 1, len(bake.probe_positions) + 1)
    for side in (p.element_patch, p.element_back):
        _within("an element's patch", side + 1, p.count + 1)
    counts = {PATCHES: p.count, PROBES: len(bake.probe_positions), LUMELS: bake.lumels.count}
    for name, rows in bake.rows.items():
        ends_right = rows.indptr[0] == 0 and rows.indptr[-1] == len(rows.columns) == len(rows.values)
        if not ends_right or (np.diff(rows.indptr) < 0).any() or counts.get(name, rows.rows) != rows.rows:
            raise ValueError(f"rows.{name} do not fit together")
        _within(f"rows.{name}.columns", rows.columns, p.count + SKY_BINS + 1)
    return bake


def _within(name: str, numbers: npt.NDArray[Any], end: int) -> None:
    if len(numbers) and not (int(numbers.min()) >= 0 and int(numbers.max()) < end):
        raise ValueError(f"array {name} points outside its table")
