"""glTF metallic-roughness materials to diffuse ones, with `principled` kept for the ground truth.

The base colour is the albedo, metal or not: what a metal reflects is its base colour. Emission is emissiveFactor ×
emissiveStrength × emissiveTexture.
"""

from __future__ import annotations

import io
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from ..datatypes import F32
from .gltf_buffers import Gltf, from_uri, view_bytes
from .gltf_values import extension, number, table, vector
from .images import Picture, decode_pillow, shrunk
from .names import unique
from .surfaces import clamp_albedo, masked

GREY = "grey"
ROUGH = 0.9  # rougher than this and no metal: as good as diffuse


@dataclass
class GltfMaterials:
    """Materials as they are needed. names: by index in the file (None: primitives without a material)."""

    gltf: Gltf
    settings: dict[str, Any] = field(default_factory=dict)
    textures: dict[str, F32] = field(default_factory=dict)
    opacity: dict[str, F32] = field(default_factory=dict)
    truth: dict[str, Any] = field(default_factory=dict)
    passes_light: set[str] = field(default_factory=set)
    names: dict[int | None, str] = field(default_factory=dict)
    pictures: dict[tuple[int, bool], Picture] = field(default_factory=dict)
    notes: list[str] = field(default_factory=list)

    def name(self, index: int | None) -> str:
        """Name of the material with this index, converted at its first use. Raises InputError."""
        if index not in self.names:
            entry = {} if index is None else self.gltf.item("materials", index)
            self.names[index] = unique(entry.get("name", GREY if index is None else "material"), self.settings)
            self._add(self.names[index], entry, index)
        return self.names[index]

    def _note(self, name: str, text: str) -> None:
        self.notes.append(f"{self.gltf.source}: material {name}: {text}")

    def _add(self, name: str, entry: dict[str, Any], index: int | None) -> None:
        if index is None:
            self.settings[name] = {"albedo": [0.5, 0.5, 0.5], "two_sided": True}
            self._note(name, "for primitives without a material: albedo 0.5 on both sides")
            return
        path = f"materials[{index}]"
        pbr = table(self.gltf, entry, "pbrMetallicRoughness", path)
        self.settings[name] = {"two_sided": entry.get("doubleSided") is True, **self._emission(name, entry, path)}
        picture, factor = self._base(name, pbr, path)
        self._gloss(name, pbr, path)
        self._alpha(name, entry, picture, factor[3], path)

    def picture(self, reference: dict[str, Any], path: str, raw: bool = False) -> Picture:
        """The picture that a textureInfo names. Raises InputError."""
        texture = self.gltf.item("textures", reference.get("index"))
        source = texture.get("source")
        entry = self.gltf.item("images", source)
        key = (int(str(source)), raw)
        if key not in self.pictures:
            where = f"images[{source}]"
            data = (
                view_bytes(self.gltf, entry["bufferView"])
                if "bufferView" in entry
                else from_uri(self.gltf, entry.get("uri"), where)
            )
            self.pictures[key] = shrunk(decode_pillow(io.BytesIO(data), f"{self.gltf.source}: {where}", raw))
        if reference.get("texCoord", 0) != 0 or extension(self.gltf, reference, "KHR_texture_transform", path):
            self.notes.append(f"{self.gltf.source}: {path}: second set or transform of texture coordinates ignored")
        return self.pictures[key]

    def _emission(self, name: str, entry: dict[str, Any], path: str) -> dict[str, Any]:
        """emission = emissiveFactor × emissiveStrength, and the picture that it multiplies."""
        factor = vector(self.gltf, entry, "emissiveFactor", [0.0, 0.0, 0.0], path)
        extra = extension(self.gltf, entry, "KHR_materials_emissive_strength", path)
        strength = number(self.gltf, extra, "emissiveStrength", 1.0, path)
        out: dict[str, Any] = {"emission": np.maximum(np.array(factor) * strength, 0.0).tolist()}
        if "emissiveTexture" in entry and any(out["emission"]):
            glow = self.picture(table(self.gltf, entry, "emissiveTexture", path), path)
            if not glow.rgb.any():  # exporters write black pictures for "none"
                return {"emission": [0.0, 0.0, 0.0]}
            out["emission_texture"] = f"glow of {name}"
            self.textures[out["emission_texture"]] = glow.rgb
        return out

    def _base(self, name: str, pbr: dict[str, Any], path: str) -> tuple[Picture | None, list[float]]:
        factor = vector(self.gltf, pbr, "baseColorFactor", [1.0, 1.0, 1.0, 1.0], path)
        albedo, notes = clamp_albedo(factor[:3], f"{self.gltf.source}: material {name}")
        if "baseColorTexture" not in pbr:
            self.settings[name]["albedo"] = albedo
            self.notes += notes
            return None, factor
        picture = self.picture(table(self.gltf, pbr, "baseColorTexture", path), path)
        key = f"picture of {name}"
        self.textures[key] = (picture.rgb * np.array(factor[:3])).astype(np.float32)
        self.settings[name]["texture"] = key
        return picture, factor

    def _gloss(self, name: str, pbr: dict[str, Any], path: str) -> None:
        default = 1.0 if pbr else 0.0  # an empty material would be a white metal by the letter of the standard
        metallic = number(self.gltf, pbr, "metallicFactor", default, path)
        roughness = number(self.gltf, pbr, "roughnessFactor", 1.0, path)
        if "metallicRoughnessTexture" in pbr:
            reference = table(self.gltf, pbr, "metallicRoughnessTexture", path)
            mean = self.picture(reference, path, raw=True).rgb.mean(axis=(0, 1))
            metallic, roughness = metallic * float(mean[2]), roughness * float(mean[1])
            self._note(name, "its metallic-roughness texture is replaced by its mean")
        metallic, roughness = (min(max(x, 0.0), 1.0) for x in (metallic, roughness))
        if metallic > 0.0 or roughness < ROUGH:
            self._note(
                name, f"baked as its base colour; the truth sees metallic {metallic:.2f}, roughness {roughness:.2f}"
            )
            self.truth[name] = {
                "type": "principled",
                "base_color": self._colour(name),
                "metallic": metallic,
                "roughness": max(roughness, 0.01),
            }

    def _colour(self, name: str) -> Any:
        settings = self.settings[name]
        return "@texture" if "texture" in settings else {"type": "rgb", "value": settings["albedo"]}

    def _alpha(self, name: str, entry: dict[str, Any], picture: Picture | None, factor: float, path: str) -> None:
        """Masks and blends become opacity; what is mostly transparent, or transmits, is left out of the bake."""
        transmission = extension(self.gltf, entry, "KHR_materials_transmission", path)
        if number(self.gltf, transmission, "transmissionFactor", 0.0, path) >= 0.5:
            self.truth[name] = {"type": "thindielectric"}
            self.passes_light.add(name)
            self._note(name, "transmits light: the bake leaves it out, the truth sees thin glass")
            return
        mode = entry.get("alphaMode", "OPAQUE")
        if mode not in ("MASK", "BLEND"):
            return
        alpha = np.full((1, 1), 1.0, np.float32) if picture is None or picture.alpha is None else picture.alpha
        opacity = np.clip(alpha * np.float32(factor), 0.0, 1.0).astype(np.float32)
        if mode == "MASK":
            opacity = (opacity >= number(self.gltf, entry, "alphaCutoff", 0.5, path)).astype(np.float32)
        if opacity.min() >= 1.0:
            return
        body = self.truth.get(name) or {"type": "diffuse", "reflectance": self._colour(name)}
        if self.settings[name]["two_sided"] and body["type"] == "diffuse":
            body = {"type": "twosided", "bsdf": body}
        self.opacity[name] = opacity
        self.truth[name] = masked(body, opacity)
        self._note(name, f"alphaMode {mode}: the truth keeps the opacity picture")
        if mode == "BLEND" and float(opacity.mean()) < 0.5:
            self.passes_light.add(name)
            self._note(name, "mostly transparent, so the bake leaves it out")
