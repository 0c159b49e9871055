"""Tables to `SceneSettings`: overrides, units of foreign files, and one message for everything that is wrong."""

from __future__ import annotations

import copy
import difflib
import json
from collections.abc import Iterator, Mapping
from typing import Any, TypeVar

from pydantic import ValidationError

from .. import config
from ..config import SceneSettings
from ..config_base import Frozen
from ..errors import InputError
from .document import Document
from .names import MAX_NAME, clean

NAMED_TABLES = ("materials", "meshes", "lights", "volumes", "marks", "limits", "cameras", "cubemaps")
LIGHT_TYPES = ("point", "spot", "directional", "area", "sky", "image_sky")
POSITIONS = {"cameras": ("origin", "target"), "lights": ("position",)}
Model = TypeVar("Model", bound=Frozen)
MAX_DEPTH = 12
MAX_MESSAGES = 12
KNOWN_KEYS = sorted(
    {
        key
        for model in vars(config).values()
        if isinstance(model, type) and issubclass(model, Frozen)
        for key in model.model_fields
    }
)


def merge(base: Mapping[str, Any], over: Mapping[str, Any], depth: int = 0) -> dict[str, Any]:
    """Copy of `base`, tables of `over` merged in, everything else replaced. Raises InputError if nested too deep."""
    if depth > MAX_DEPTH:
        raise InputError(f"override: tables nested over {MAX_DEPTH} deep; settings have at most 4 levels")
    out = dict(base)
    for key, value in over.items():
        old = out.get(key)
        if isinstance(value, Mapping):
            out[key] = merge(old if isinstance(old, Mapping) else {}, value, depth + 1)
        else:
            out[key] = value
    return out


def in_metres(raw: Mapping[str, Any], unit_m: float) -> dict[str, Any]:
    """Cameras and punctual lights that a foreign file gives in its own unit, scaled as its vertices will be."""
    out = copy.deepcopy(dict(raw))
    for table, keys in POSITIONS.items():
        for entry in out.get(table, {}).values():
            for key in keys:
                if key in entry:
                    entry[key] = [float(x) * unit_m for x in entry[key]]
    return out


def _path(error: Mapping[str, Any]) -> str:
    loc = list(error["loc"])
    if len(loc) > 2 and loc[0] == "lights" and loc[2] in LIGHT_TYPES:
        del loc[2]  # pydantic names the member of the union, which is no key of the file
    return ".".join(str(part) for part in loc if part != "[key]") or "(top level)"


def _message(error: Mapping[str, Any]) -> str:
    path, kind = _path(error), error["type"]
    if kind == "extra_forbidden":
        key = path.rsplit(".", 1)[-1]
        close = difflib.get_close_matches(key, KNOWN_KEYS, 1)
        return f"{path}: unknown key" + (f"; did you mean {close[0]!r}?" if close else "; remove it")
    if kind == "missing":
        return f"{path}: missing, a value is expected"
    if kind == "union_tag_not_found":
        return f"{path}: no such light, or its 'type' is missing; type must be one of {', '.join(LIGHT_TYPES)}"
    if kind == "union_tag_invalid":
        return f"{path}.type: unknown type; expected one of {', '.join(LIGHT_TYPES)}"
    got = error.get("input")
    shown = "" if isinstance(got, Mapping) else f", got {json.dumps(got, default=str)[:80]}"
    return f"{path}: {error['msg']}{shown}"


def _names(raw: Mapping[str, Any]) -> Iterator[str]:
    for table in NAMED_TABLES:
        entries = raw.get(table)
        for name in entries if isinstance(entries, Mapping) else ():
            if name != clean(name, fallback=""):
                yield f"{table}.{clean(name)}: a name needs 1 to {MAX_NAME} printable characters, no < > or quotes"


def validate(raw: Mapping[str, Any], source: str, model: type[Model]) -> Model:
    """Settings typed by `model`. Raises one InputError that names `source` and the dotted path of each offending key.

    Validation goes through JSON, where pydantic's strict mode takes lists for tuples but no text for numbers: the same
    judgement as the published JSON Schema.
    """
    messages = list(_names(raw))
    try:
        text = json.dumps(raw, default=str)
        settings = model.model_validate_json(text, strict=True)
    except ValidationError as error:
        messages += [_message(e) for e in error.errors(include_url=False)]  # type: ignore[arg-type, unused-ignore]
    except (ValueError, RecursionError) as error:
        messages.append(f"cannot be understood: {error}")
    if messages:
        more = f"; and {len(messages) - MAX_MESSAGES} more" if len(messages) > MAX_MESSAGES else ""
        raise InputError(f"{source}: " + "; ".join(messages[:MAX_MESSAGES]) + more)
    return settings


def settle(document: Document, overrides: Mapping[str, Any]) -> SceneSettings:
    """Settings of a document with overrides, which are in metres whatever the file's unit. Raises InputError."""
    raw: Mapping[str, Any] = document.raw
    unit = overrides.get("unit_m", raw.get("unit_m", 1.0))
    if document.own_units and isinstance(unit, int | float) and unit != 1.0:
        raw = in_metres(raw, float(unit))
    return validate(merge(raw, overrides), str(document.source), SceneSettings)
