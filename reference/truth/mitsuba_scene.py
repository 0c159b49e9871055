"""A validated `Scene` as a Mitsuba scene: only plugins named here, only numbers and arrays that the loaders checked.

Plain diffuse meshes are merged into one (albedo as a face attribute): fewer shapes, fewer virtual calls. The scene is
centred and scaled to `HALF_EXTENT`, which keeps Mitsuba's ray offset (≈ 9e-5 of the coordinates) small beside it.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from ..config import DirectionalLight, PointLight, Punctual, SpotLight
from ..datatypes import F32, F64, Bool, Material, Mesh, Scene, Sky
from ..variant import ensure_variant
from ..visibility import merge, mitsuba_mesh

HALF_EXTENT = 16.0


@dataclass(frozen=True, eq=False)
class TruthScene:
    """scene: mi.Scene. engine_shapes: mi.Bool by shape id, its emission is a light tagged `engine`; engine_sky.
    world = centre + scale · scene coordinates."""

    scene: Any
    engine_shapes: Any
    engine_sky: bool
    centre: F64
    scale: float


def build_truth_scene(scene: Scene) -> TruthScene:
    """Everything that light meets: all meshes, glass and moving ones included, and all lights."""
    ensure_variant()
    import mitsuba as mi

    vertices = np.concatenate([m.vertices for m in scene.meshes])
    lower, upper = vertices.min(axis=0), vertices.max(axis=0)
    centre, scale = 0.5 * (lower + upper), float(0.5 * np.max(upper - lower)) / HALF_EXTENT
    items: dict[str, Any] = {"type": "scene", "embree_use_robust_intersections": True}
    plain = [m for m in scene.meshes if _is_plain(scene.materials[m.material], m)]
    for two_sided in (False, True):
        group = [m for m in plain if scene.materials[m.material].two_sided == two_sided]
        if group:
            items[f"plain{int(two_sided)}"] = _merged(scene, group, two_sided, centre, scale)
    engine_names = set()
    for i, mesh in enumerate(scene.meshes):
        if not _is_plain(scene.materials[mesh.material], mesh):
            items[f"mesh{i}"] = _single(scene, mesh, centre, scale)
            if mesh.engine_lit:
                engine_names.add(f"mesh{i}")
    for i, light in enumerate(scene.settings.lights.values()):
        if isinstance(light, PointLight | SpotLight | DirectionalLight):
            items[f"light{i}"] = _punctual(light, centre, scale)
    if scene.sky is not None:
        items["sky"] = _sky(scene.sky)
    built = mi.load_dict(items)
    engine_sky = scene.sky is not None and scene.sky.engine_lit
    return TruthScene(built, _engine_flags(built, engine_names), engine_sky, centre, scale)


def _engine_flags(built: Any, names: set[str]) -> Any:
    import drjit as dr
    import mitsuba as mi

    shapes = built.shapes()
    ids = [int(dr.reinterpret_array(mi.UInt32, mi.ShapePtr(s))[0]) for s in shapes]
    flags: Bool = np.zeros(max(ids) + 1, dtype=np.bool_)
    for number, shape in zip(ids, shapes, strict=True):
        flags[number] = shape.id() in names
    return mi.Bool(flags)


def _is_plain(material: Material, mesh: Mesh) -> bool:
    special = material.truth_bsdf is not None or material.opacity is not None
    textured = material.texture is not None and mesh.uvs is not None
    return not (special or textured or mesh.emission.any())


def _merged(scene: Scene, meshes: list[Mesh], two_sided: bool, centre: F64, scale: float) -> Any:
    import mitsuba as mi

    vertices, faces, owner = merge(meshes, list(range(len(meshes))))
    albedo = np.stack([scene.materials[m.material].albedo for m in meshes])[owner]
    bsdf: dict[str, Any] = {"type": "diffuse", "reflectance": {"type": "mesh_attribute", "name": "face_albedo"}}
    if two_sided:
        bsdf = {"type": "twosided", "bsdf": bsdf}
    mesh = mitsuba_mesh("plain", (vertices - centre) / scale, faces, {"bsdf": mi.load_dict(bsdf)})
    mesh.add_attribute("face_albedo", 3, albedo.astype(np.float32).ravel())
    return mesh


def _single(scene: Scene, mesh: Mesh, centre: F64, scale: float) -> Any:
    import mitsuba as mi

    material = scene.materials[mesh.material]
    properties: dict[str, Any] = {"bsdf": mi.load_dict(_bsdf(material, mesh.uvs is not None))}
    if mesh.emission.any():
        picture = material.emission_texture if mesh.uvs is not None else None
        radiance = _rgb(mesh.emission) if picture is None else _bitmap(picture * mesh.emission.astype(np.float32))
        properties["emitter"] = mi.load_dict({"type": "area", "radiance": radiance})
    return mitsuba_mesh(mesh.name, (mesh.vertices - centre) / scale, mesh.faces, properties, mesh.uvs)


def _bsdf(material: Material, has_uvs: bool) -> dict[str, Any]:
    texture = _bitmap(material.texture) if material.texture is not None and has_uvs else _rgb(material.albedo)
    if material.truth_bsdf is not None:
        opacity = _bitmap(material.opacity) if material.opacity is not None and has_uvs else 1.0
        return _filled(material.truth_bsdf, {"@texture": texture, "@opacity": opacity})
    bsdf: dict[str, Any] = {"type": "diffuse", "reflectance": texture}
    if material.two_sided:
        bsdf = {"type": "twosided", "bsdf": bsdf}
    if material.opacity is not None and has_uvs:
        bsdf = {"type": "mask", "opacity": _bitmap(material.opacity), "bsdf": bsdf}
    return bsdf


def _filled(item: Mapping[str, Any], places: Mapping[str, Any]) -> dict[str, Any]:
    """`item` with the placeholder strings replaced, nested dictionaries included."""
    filled: dict[str, Any] = {}
    for key, value in item.items():
        if isinstance(value, Mapping):
            filled[key] = _filled(value, places)
        elif isinstance(value, str) and value in places:
            filled[key] = places[value]
        else:
            filled[key] = value
    return filled


def _rgb(colour: F64) -> dict[str, Any]:
    return {"type": "rgb", "value": [float(x) for x in colour]}


def _bitmap(image: F32) -> dict[str, Any]:
    """Texture plugin from a linear image whose row 0 is v = 1 (Mitsuba's row 0 is v = 0 for our uncut coordinates)."""
    import mitsuba as mi

    pixels = image if image.ndim == 3 else image[..., None]
    flipped = np.ascontiguousarray(pixels[::-1, :, :3], dtype=np.float32)
    return {"type": "bitmap", "bitmap": mi.Bitmap(flipped), "raw": True, "filter_type": "bilinear"}


def _punctual(light: Punctual, centre: F64, scale: float) -> dict[str, Any]:
    import mitsuba as mi

    if isinstance(light, DirectionalLight):
        return {
            "type": "directional",
            "direction": list(light.direction),
            "irradiance": _rgb(np.array(light.irradiance)),
        }
    position = (np.asarray(light.position) - centre) / scale
    # Lengths shrink by `scale`; 1/d² grows, so the intensity shrinks by its square.
    intensity = _rgb(np.array(light.intensity) / scale**2)
    if isinstance(light, PointLight):
        return {"type": "point", "position": position.tolist(), "intensity": intensity}
    axis = np.asarray(light.direction) / np.linalg.norm(light.direction)
    up = np.eye(3)[int(np.argmin(np.abs(axis)))]
    to_world = mi.ScalarTransform4f().look_at(
        origin=position.tolist(), target=(position + axis).tolist(), up=up.tolist()
    )
    angles = {"cutoff_angle": light.cutoff_deg, "beam_width": light.beam_deg}
    return {"type": "spot", "to_world": to_world, "intensity": intensity, **angles}


def _sky(sky: Sky) -> dict[str, Any]:
    import mitsuba as mi

    if sky.image.shape[:2] == (1, 1):
        return {"type": "constant", "radiance": _rgb(sky.image[0, 0].astype(np.float64))}
    turn = mi.ScalarTransform4f().rotate([0, 1, 0], sky.rotation_deg)
    bitmap = mi.Bitmap(np.ascontiguousarray(sky.image, dtype=np.float32))
    return {"type": "envmap", "bitmap": bitmap, "to_world": turn}
