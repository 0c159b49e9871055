"""Mitsuba BSDFs to diffuse materials, with the original kept for the ground truth.

Plastics bake their diffuse part, conductors their reflectance at normal incidence,
R = ((η − 1)² + k²) / ((η + 1)² + k²), as if it were diffuse: a model error that the notes name. Dielectrics let light
pass.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from ..datatypes import F32, F64
from .surfaces import clamp_albedo, masked
from .xml_textures import Colour, colour, fill_transparent, opacity_of
from .xml_values import Context, children, properties

if TYPE_CHECKING:
    from xml.etree.ElementTree import Element

MAX_NESTING = 8
# Reflectance at normal incidence, linear RGB, of the metals Mitsuba 3.9.1 knows by name (its `conductor`, rgb variant).
METALS: Mapping[str, tuple[float, float, float]] = {
    "none": (1.0, 1.0, 1.0),
    "Ag": (0.9748, 0.9575, 0.9063),
    "Al": (0.928, 0.9178, 0.9189),
    "Au": (0.9667, 0.802, 0.3241),
    "Be": (0.5975, 0.5206, 0.5062),
    "Cr": (0.6876, 0.6491, 0.687),
    "Cu": (0.952, 0.6198, 0.5106),
    "Cu2O": (0.3147, 0.2455, 0.2379),
    "CuO": (0.2907, 0.1982, 0.1834),
    "Hg": (0.814, 0.7702, 0.7631),
    "Ir": (0.7426, 0.6802, 0.6308),
    "K": (0.9539, 0.9363, 0.9201),
    "Li": (0.9248, 0.8844, 0.7933),
    "Mo": (0.6182, 0.5618, 0.5409),
    "Na_palik": (0.9785, 0.9597, 0.9315),
    "Rh": (0.8243, 0.7544, 0.7216),
    "Se": (0.3793, 0.2507, 0.2413),
    "Ta": (0.4565, 0.3419, 0.3799),
    "TiC": (0.5482, 0.4397, 0.4116),
    "TiN": (0.6409, 0.4523, 0.1976),
    "VC": (0.5297, 0.4179, 0.3798),
    "VN": (0.5251, 0.3926, 0.3106),
    "W": (0.5746, 0.4778, 0.4331),
    "a-C": (0.2794, 0.194, 0.1691),
    "d-C": (0.2123, 0.1579, 0.1449),
}
LIQUIDS = frozenset({
    "vacuum", "helium", "hydrogen", "air", "carbon dioxide", "water", "acetone", "ethanol", "carbon tetrachloride",
    "glycerol", "benzene", "silicone oil", "bromine", "water ice", "fused silica", "pyrex", "acrylic glass",
    "polypropylene", "bk7", "sodium chloride", "amber", "pet", "diamond",
})  # fmt: skip


@dataclass(frozen=True, eq=False)
class Surface:
    """A material on its way: diffuse colour, the plugin dictionary for the truth (None: diffuse), and flags."""

    colour: Colour
    truth: dict[str, Any] | None = None
    two_sided: bool = False
    passes_light: bool = False
    opacity: F32 | None = None
    textures: Mapping[str, F32] = field(default_factory=dict)


def _clamped(element: Element, c: Colour, ctx: Context) -> Colour:
    rgb, notes = clamp_albedo(c.rgb, ctx.where(element))
    ctx.notes += notes
    return replace(c, rgb=rgb)


def _value(c: Colour) -> Any:
    return "@texture" if c.texture else {"type": "rgb", "value": list(c.rgb)}


def _ior(element: Element, ctx: Context) -> dict[str, Any]:
    out: dict[str, Any] = {}
    for key in ("int_ior", "ext_ior"):
        value = properties(element, ctx).get(key)
        if value is None:
            continue
        if isinstance(value, str) and value.lower() in LIQUIDS:
            value = value.lower()
        elif not isinstance(value, float) or not 0.1 < value < 20.0:
            raise ctx.fail(element, f"{key} must be a number or the name of a material, got {value!r}")
        out[key] = value
    return out


def _rough(element: Element, ctx: Context) -> dict[str, Any]:
    """alpha and distribution; a textured roughness becomes 0.1, Mitsuba's default."""
    values, out = properties(element, ctx), dict[str, Any]()
    for key in ("alpha", "alpha_u", "alpha_v"):
        if isinstance(values.get(key), float):
            out[key] = min(max(values[key], 1e-4), 1.0)
    if any(name.startswith("alpha") for name, _ in children(element, "texture", ctx)):
        ctx.note(element, "textured roughness replaced by 0.1")
        out["alpha"] = 0.1
    word = values.get("distribution", "beckmann")
    if word not in ("beckmann", "ggx"):
        ctx.note(element, "distribution other than beckmann and ggx replaced by ggx")
        word = "ggx"
    return {**out, "distribution": word}


def _diffuse(element: Element, ctx: Context, depth: int) -> Surface:
    c = _clamped(element, colour(element, ("reflectance", "diffuse_reflectance"), 0.5, ctx), ctx)
    if element.get("type") != "diffuse":
        ctx.note(element, "treated as diffuse with its diffuse reflectance, in the truth too")
    return Surface(c, textures=c.images)


def _plastic(element: Element, ctx: Context, depth: int) -> Surface:
    kind = str(element.get("type"))
    c = _clamped(element, colour(element, ("diffuse_reflectance",), 0.5, ctx), ctx)
    truth: dict[str, Any] = {"type": kind, "diffuse_reflectance": _value(c), **_ior(element, ctx)}
    truth["nonlinear"] = bool(properties(element, ctx).get("nonlinear", False))
    if kind == "roughplastic":
        truth |= _rough(element, ctx)
    ctx.note(element, "baked as its diffuse reflectance alone; the truth keeps the gloss")
    return Surface(c, truth, textures=c.images)


def _metal(element: Element, ctx: Context) -> tuple[F64, dict[str, Any]]:
    values = properties(element, ctx)
    if "eta" in values or "k" in values:
        eta, k = (np.broadcast_to(np.array(values.get(n, 0.0), np.float64), 3) for n in ("eta", "k"))
        if min(eta.min(), k.min()) < 0.0:
            raise ctx.fail(element, "eta and k must not be negative")
        spectra = {n: {"type": "rgb", "value": a.tolist()} for n, a in (("eta", eta), ("k", k))}
        return ((eta - 1) ** 2 + k**2) / ((eta + 1) ** 2 + k**2), spectra
    name = values.get("material", "Cu")
    if name not in METALS:
        raise ctx.fail(element, f"unknown metal {str(name)[:40]!r}; possible: {', '.join(METALS)}, or give eta and k")
    return np.array(METALS[name]), {"material": name}


def _conductor(element: Element, ctx: Context, depth: int) -> Surface:
    kind = str(element.get("type"))
    normal, metal = _metal(element, ctx)
    tint = colour(element, ("specular_reflectance",), 1.0, ctx)
    if tint.texture:
        ctx.note(element, "texture of specular_reflectance ignored")
        tint = Colour([1.0, 1.0, 1.0])
    tint_rgb = [min(max(x, 0.0), 1.0) for x in tint.rgb]
    truth: dict[str, Any] = {"type": kind, **metal, "specular_reflectance": {"type": "rgb", "value": tint_rgb}}
    if kind == "roughconductor":
        truth |= _rough(element, ctx)
    ctx.note(element, "metal baked as diffuse with its reflectance at normal incidence; the truth keeps the gloss")
    return Surface(_clamped(element, Colour((normal * np.array(tint_rgb)).tolist()), ctx), truth)


def _dielectric(element: Element, ctx: Context, depth: int) -> Surface:
    truth: dict[str, Any] = {"type": str(element.get("type")), **_ior(element, ctx)}
    if element.get("type") == "roughdielectric":
        truth |= _rough(element, ctx)
    ctx.note(element, "lets light pass: absent from the bake, present in the truth")
    return Surface(Colour([0.0, 0.0, 0.0]), truth, passes_light=True)


def _inner(element: Element, ctx: Context, depth: int) -> Surface:
    nested = children(element, "bsdf", ctx)
    if not nested:
        raise ctx.fail(element, "needs a bsdf inside")
    if element.get("type") not in ("twosided", "mask"):
        ctx.note(element, "only the bsdf inside counts, in the truth too")
    elif len(nested) > 1:
        ctx.note(element, "only the first bsdf inside counts")
    return convert(nested[0][1], ctx, depth + 1)


def _twosided(element: Element, ctx: Context, depth: int) -> Surface:
    inner = _inner(element, ctx, depth)
    if inner.passes_light:
        return inner
    if inner.truth is None or inner.truth["type"] == "twosided":
        return replace(inner, two_sided=True)
    if inner.truth["type"] == "mask":  # Mitsuba wants the mask outside
        raise ctx.fail(element, "a twosided around a mask is not possible; put the mask outside")
    return replace(inner, two_sided=True, truth={"type": "twosided", "bsdf": inner.truth})


def _mask(element: Element, ctx: Context, depth: int) -> Surface:
    inner = _inner(element, ctx, depth)
    if inner.truth is not None and inner.truth["type"] == "mask":
        raise ctx.fail(element, "a mask inside a mask; keep one of them")
    opacity, same = opacity_of(element, inner.colour.texture, ctx)
    if same is not None and inner.colour.texture:
        key = f"visible part of {inner.colour.texture}"
        images = {key: fill_transparent(same)}
        inner = replace(inner, colour=replace(inner.colour, texture=key), textures=images)
    body = inner.truth
    if body is None:
        body = {"type": "diffuse", "reflectance": _value(inner.colour)}
        body = {"type": "twosided", "bsdf": body} if inner.two_sided else body
    ctx.note(element, "masked: the truth keeps the opacity picture")
    return replace(inner, opacity=opacity, truth=masked(body, opacity))


def _blend(element: Element, ctx: Context, depth: int) -> Surface:
    nested = [convert(b, ctx, depth + 1) for _, b in children(element, "bsdf", ctx)]
    if len(nested) != 2:
        raise ctx.fail(element, f"expected two bsdfs inside, got {len(nested)}")
    weight = properties(element, ctx).get("weight", 0.5)
    w = min(max(float(weight), 0.0), 1.0) if isinstance(weight, float) else 0.5
    ctx.note(element, f"blended with weight {w} into one diffuse material, in the truth too")
    a, b = nested
    if a.colour.texture or b.colour.texture:
        return replace(b if w >= 0.5 else a, truth=None)
    mixed = [(1 - w) * x + w * y for x, y in zip(a.colour.rgb, b.colour.rgb, strict=True)]
    return Surface(Colour(mixed), two_sided=a.two_sided and b.two_sided)


def _principled(element: Element, ctx: Context, depth: int) -> Surface:
    c = _clamped(element, colour(element, ("base_color",), 0.5, ctx), ctx)
    values = properties(element, ctx)
    truth: dict[str, Any] = {"type": "principled", "base_color": _value(c)}
    truth |= {k: min(max(values[k], 0.0), 1.0) for k in ("roughness", "metallic") if isinstance(values.get(k), float)}
    ctx.note(element, "baked as its base colour; the truth keeps roughness and metallic, nothing else")
    return Surface(c, truth, textures=c.images)


def _null(element: Element, ctx: Context, depth: int) -> Surface:
    ctx.note(element, "lets light pass: absent from the bake, present in the truth")
    return Surface(Colour([0.0, 0.0, 0.0]), {"type": "null"}, passes_light=True)


_CONVERTERS: Mapping[str, Callable[[Any, Context, int], Surface]] = {
    "diffuse": _diffuse, "roughdiffuse": _diffuse, "phong": _diffuse, "ward": _diffuse,
    "plastic": _plastic, "roughplastic": _plastic, "conductor": _conductor, "roughconductor": _conductor,
    "dielectric": _dielectric, "thindielectric": _dielectric, "roughdielectric": _dielectric,
    "twosided": _twosided, "mask": _mask, "blendbsdf": _blend, "principled": _principled, "null": _null,
    "bumpmap": _inner, "bump": _inner, "normalmap": _inner, "coating": _inner, "roughcoating": _inner,
}  # fmt: skip


def convert(element: Element, ctx: Context, depth: int = 0) -> Surface:
    """A <bsdf>, whatever is nested in it. Raises InputError for what cannot be, and for references in a circle."""
    if depth > MAX_NESTING:
        raise ctx.fail(element, f"bsdfs nested over {MAX_NESTING} deep, or in a circle; simplify them")
    return _CONVERTERS[str(element.get("type"))](element, ctx, depth)
