"""The hash by which finished work is kept."""

from __future__ import annotations

import hashlib
import json
from typing import Any

import numpy as np

from ..datatypes import Scene


def digest(scene: Scene) -> str:
    """SHA-256 over settings and arrays, each array with its name, type and shape in front."""
    sha = hashlib.sha256(scene.settings.model_dump_json().encode())

    def put(label: str, array: Any) -> None:
        a = np.ascontiguousarray(array)
        sha.update(f"{label} {a.dtype.str} {a.shape}".encode())
        sha.update(a.data)

    for mesh in scene.meshes:
        put(mesh.name, mesh.vertices)
        put("faces", mesh.faces)
        put(f"uvs of material {mesh.material}", np.zeros(0) if mesh.uvs is None else mesh.uvs)
        put("emission", mesh.emission)
    for m in scene.materials:
        flags = {"two": m.two_sided, "passes": m.passes_light, "truth": m.truth_bsdf}
        sha.update(json.dumps([m.name, flags], sort_keys=True).encode())
        put("albedo", m.albedo)
        put("texture", np.zeros(0) if m.texture is None else m.texture)
        put("opacity", np.zeros(0) if m.opacity is None else m.opacity)
        if m.emission_texture is not None:
            put("emission texture", m.emission_texture)
    if scene.sky:
        put(f"sky {scene.sky.rotation_deg} {scene.sky.engine_lit}", scene.sky.image)
    for mark in scene.marks:  # name and probe_size are in the settings
        put(mark.kind, mark.vertices)
        put("faces", mark.faces)
    for layer in scene.bitmap:
        put(f"layer {layer.mode} {layer.size!r}", layer.origin)
        put("cells", layer.cells)
    return sha.hexdigest()
