"""Mitsuba XML, old dialect and new: what may stand in a file, and how its values read.

A whitelist of elements and plugin types is checked before anything is interpreted, because a plugin type is a file name
to Mitsuba (failure-catalogue G1). Nothing of the file reaches Mitsuba but numbers and words from lists.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import defusedxml.ElementTree as SafeTree
import numpy as np
from defusedxml import DefusedXmlException

from ..errors import InputError
from .images import srgb_to_linear
from .names import clean
from .paths import MAX_DOCUMENT_BYTES, read_bytes

if TYPE_CHECKING:
    from xml.etree.ElementTree import Element

PLUGINS: Mapping[str, frozenset[str]] = {
    "sensor": frozenset({"perspective", "thinlens"}),
    "film": frozenset({"hdrfilm", "ldrfilm", "specfilm"}),
    "bsdf": frozenset({
        "diffuse", "roughdiffuse", "twosided", "plastic", "roughplastic", "conductor", "roughconductor", "dielectric",
        "thindielectric", "roughdielectric", "mask", "bumpmap", "bump", "normalmap", "phong", "ward", "blendbsdf",
        "coating", "roughcoating", "principled", "null",
    }),
    "texture": frozenset({"bitmap", "checkerboard"}),
    "shape": frozenset({"obj", "ply", "rectangle", "disk", "cube", "sphere", "cylinder"}),
    "emitter": frozenset({"area", "envmap", "constant", "point", "spot", "directional"}),
}  # fmt: skip
VALUE_TAGS = frozenset({"float", "integer", "string", "boolean", "rgb", "srgb", "spectrum", "point", "vector"})
STEP_TAGS = frozenset({"matrix", "translate", "rotate", "scale", "lookat"})
# These say how to render, or fill space with fog; a bake has no use for them.
IGNORED_TAGS = frozenset({"integrator", "sampler", "rfilter", "medium", "phase", "volume"})
TAGS = VALUE_TAGS | STEP_TAGS | IGNORED_TAGS | frozenset(PLUGINS) | {"scene", "default", "transform", "ref"}
TYPE_PATTERN = re.compile(r"[a-z0-9_]+")
MAX_DEPTH, MAX_ELEMENTS, MAX_ATTRIBUTE = 24, 500_000, 4096
WORLD_LIMIT = 1e12


def snake(name: str) -> str:
    """`toWorld` of the old dialect → `to_world` of the new; `intIOR` → `int_ior`."""
    return re.sub(r"([a-z])([A-Z]+)", r"\1_\2", name).lower()


@dataclass
class Context:
    """One file being read. ids: elements by id. subject: the material or shape in hand. notes: what was converted."""

    source: Path
    ids: dict[str, Element] = field(default_factory=dict)
    notes: list[str] = field(default_factory=list)
    subject: str = ""

    @property
    def folder(self) -> Path:
        return self.source.parent

    def where(self, element: Element) -> str:
        """File, subject and element, as messages name them."""
        return ": ".join([str(self.source), *([self.subject] if self.subject else []), label(element)])

    def fail(self, element: Element, text: str) -> InputError:
        """The error to raise about `element`."""
        return InputError(f"{self.where(element)}: {text}")

    def note(self, element: Element, text: str) -> None:
        self.notes.append(f"{self.where(element)}: {text}")


def label(element: Element) -> str:
    """What a message calls an element: tag, type, id or name."""
    parts = [clean(element.tag)]
    parts += [f'{key}="{clean(element.get(key))}"' for key in ("type", "id", "name") if element.get(key)]
    return f"<{' '.join(parts)}>"


def _judge(element: Element, ctx: Context) -> None:
    if element.tag not in TAGS:
        way = "write its content into this file" if element.tag == "include" else "remove it or convert it"
        raise ctx.fail(element, f"element is not in the list of what may stand in a scene; {way}")
    kind = element.get("type")
    allowed = PLUGINS.get(element.tag)
    if allowed is None and (kind is None or TYPE_PATTERN.fullmatch(kind) or element.tag in VALUE_TAGS):
        return
    if allowed is None or kind is None or not TYPE_PATTERN.fullmatch(kind) or kind not in allowed:
        known = "[a-z0-9_]+" if allowed is None else ", ".join(sorted(allowed))
        raise ctx.fail(element, f"unknown plugin type {clean(kind)!r}; possible: {known}")


def _substitute(element: Element, defaults: Mapping[str, str], ctx: Context) -> None:
    for key, value in list(element.attrib.items()):
        if "$" in value:
            for name in sorted(defaults, key=len, reverse=True):
                value = value.replace(f"${name}", defaults[name])
                if len(value) > MAX_ATTRIBUTE:
                    raise ctx.fail(element, f"{key} grows over {MAX_ATTRIBUTE} characters by substitution")
            element.set(key, value)
        if key == "name":
            element.set(key, snake(value))


def _walk(root: Element) -> Iterator[tuple[Element, int]]:
    """Elements in the order of the file, with their depth."""
    stack = [(root, 0)]
    while stack:
        element, depth = stack.pop()
        yield element, depth
        stack += [(child, depth + 1) for child in reversed(element)]


def parse(path: Path) -> tuple[Element, Context]:
    """The checked tree: variables filled in, names in snake_case. Raises InputError for what is not listed."""
    ctx = Context(path)
    try:
        root: Element = SafeTree.fromstring(read_bytes(path, str(path), MAX_DOCUMENT_BYTES), forbid_dtd=True)
    except DefusedXmlException as error:
        raise InputError(f"{path}: a DOCTYPE or entity is not allowed in a scene; remove it") from error
    except (SafeTree.ParseError, ValueError, LookupError, RecursionError) as error:
        raise InputError(f"{path}: not well-formed XML: {error}") from error
    if root.tag != "scene":
        raise ctx.fail(root, "expected <scene> as the outermost element")
    defaults: dict[str, str] = {}
    for count, (element, depth) in enumerate(_walk(root)):
        if depth > MAX_DEPTH or count > MAX_ELEMENTS:
            raise ctx.fail(element, f"nested over {MAX_DEPTH} deep or over {MAX_ELEMENTS} elements; simplify the file")
        if element.tag == "lookAt":
            element.tag = "lookat"
        _substitute(element, defaults, ctx)
        _judge(element, ctx)
        if element.tag == "default":
            defaults.setdefault(element.get("name", ""), element.get("value", ""))
        if (identity := element.get("id")) and element.tag != "ref":
            if identity in ctx.ids:
                raise ctx.fail(element, "this id is taken already; rename one of them")
            ctx.ids[identity] = element
    defaults.pop("", None)
    return root, ctx


def numbers(text: str | None, ctx: Context, element: Element) -> list[float]:
    """Finite numbers separated by commas or blanks. Raises InputError."""
    try:
        values = [float(w) for w in (text or "").replace(",", " ").split()]
    except ValueError:
        values = []
    if not values or not all(math.isfinite(v) and abs(v) < WORLD_LIMIT for v in values):
        raise ctx.fail(element, f"expected finite numbers, got {clean(text)!r}")
    return values


def triple(element: Element, ctx: Context, default: float = 0.0) -> list[float]:
    """x, y, z attributes, or `value` with three numbers (or one, for all)."""
    text = element.get("value")
    if text is None:
        return [numbers(element.get(axis, str(default)), ctx, element)[0] for axis in "xyz"]
    values = numbers(text, ctx, element)
    if len(values) not in (1, 3):
        raise ctx.fail(element, f"expected 1 or 3 numbers, got {len(values)}")
    return values * 3 if len(values) == 1 else values


def _colour(element: Element, ctx: Context) -> list[float]:
    text = (element.get("value") or "").strip()
    if re.fullmatch(r"#[0-9a-fA-F]{6}", text):
        bytes_ = np.array([int(text[i : i + 2], 16) for i in (1, 3, 5)], np.float64)
        return [float(x) for x in srgb_to_linear(bytes_ / 255.0)]
    if element.get("filename") or ":" in text:
        raise ctx.fail(element, "spectra over wavelength are not supported; give one number or an <rgb>")
    return triple(element, ctx)


def _integer(element: Element, ctx: Context) -> int:
    return int(numbers(element.get("value"), ctx, element)[0])


def _boolean(element: Element, ctx: Context) -> bool:
    word = (element.get("value") or "").strip().lower()
    if word not in ("true", "false"):
        raise ctx.fail(element, f"expected true or false, got {clean(word)!r}")
    return word == "true"


_READERS: Mapping[str, Callable[[Any, Context], Any]] = {
    "float": lambda e, ctx: numbers(e.get("value"), ctx, e)[0],
    "integer": _integer,
    "boolean": _boolean,
    "string": lambda e, ctx: str(e.get("value") or ""),
    "rgb": _colour,
    "srgb": _colour,
    "spectrum": _colour,
    "point": triple,
    "vector": triple,
}


def properties(element: Element, ctx: Context) -> dict[str, Any]:
    """Values directly inside a plugin, by name: float, int, bool, str, or a list of three floats for rgb and points."""
    return {child.get("name", ""): _READERS[child.tag](child, ctx) for child in element if child.tag in VALUE_TAGS}


def children(element: Element, tag: str, ctx: Context) -> list[tuple[str, Element]]:
    """Plugins of kind `tag` inside `element`, direct or by <ref>, with their names. Raises InputError for lost ids."""
    found = []
    for child in element:
        target: Element | None = child
        if child.tag == "ref":
            target = ctx.ids.get(child.get("id", ""))
            if target is None:
                raise ctx.fail(child, f"no element has the id {clean(child.get('id'))!r}; correct it")
        if target is not None and target.tag == tag:
            found.append((child.get("name", ""), target))
    return found
