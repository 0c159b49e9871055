"""An explained pixel on the page: the part of the picture around it with the probes it reads, and the tables beside it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from PIL import Image, ImageDraw

from ...reference.datatypes import F64, U8
from ..record_models import JsonObject
from .embed import data_uri
from .overlay import draw_dot, ground, project
from .pictures import INVALID, REAL, VIRTUAL, SceneView, png_bytes
from .words import number, percent

SIZE, LEAST_WINDOW, ROOM = 720, 48.0, 0.15
KINDS = {"real": REAL, "copied": INVALID, "invalid": INVALID, "virtual": VIRTUAL}
SEEN, BLOCKED, HERE = (105, 225, 105), (245, 80, 85), (255, 224, 70)


def pixel_context(found: Mapping[str, Any] | None, views: Sequence[SceneView]) -> JsonObject | None:
    """What the template shows of a record's `pixel`; None where none was explained."""
    if not found:
        return None
    view = next((v for v in views if v.pictures.camera == found["camera"]), None)
    drawn = "" if view is None or not found["probes"] else data_uri(png_bytes(draw_pixel(view, found), 128))
    ours, truth, se = (sum(found[k]) / 3.0 for k in ("ours", "truth", "truth_se"))
    return {
        "camera": found["camera"],
        "x": found["x"],
        "y": found["y"],
        "mesh": found["mesh"],
        "probe_lit": found["probe_lit"],
        "position": place(found["position"]),
        "sample": place(found["sample"]),
        "ours": number(ours),
        "truth": number(truth),
        "se": number(se, 2),
        "relative": f"{100.0 * (ours - truth) / truth:+.1f} %" if truth > 0.0 else "",
        "paths": f"{found['paths']:,}",
        "picture": drawn,
        "voxel": f"{number(found['voxel_m'])} m" if found["voxel_m"] else "",
        "level": found["level"],
        "fallback": found["level"] < found["finest_level"],
        "links": [_link(row, truth) for row in found["links"]],
        "probes": [_probe(i, row) for i, row in enumerate(found["probes"])],
        "behind": [_probe(i, row) for i, row in enumerate(found["behind"])],
        "adds": number(sum(found["reconstruction_adds"]) / 3.0)
        if max(map(abs, found["reconstruction_adds"])) > 1e-6 * truth
        else "",
    }


def _link(row: Mapping[str, Any], truth: float) -> tuple[str, str, str, str]:
    """Label, W·m⁻² with standard error, share of the truth, light after it."""
    share = f"{100.0 * row['mean'] / truth:+.2f} %" if truth > 0.0 else ""
    return row["label"], f"{row['mean']:+.4g}", number(row["se"], 2), share


def _probe(i: int, row: Mapping[str, Any]) -> JsonObject:
    light = row.get("light_from")
    return {
        "number": i + 1,
        "probe": row.get("probe", ""),
        "kind": row.get("kind", "real"),
        "copies": light if light not in (None, -1, row.get("probe")) else "",
        "level": row["level"],
        "position": place(row["position"]),
        "trilinear": f"{row['trilinear']:.3f}" if "trilinear" in row else "",
        "validity": f"{row['validity']:.3f}" if "validity" in row else "",
        "back": percent(row["back_share"], 2) if "back_share" in row else "",
        "weight": percent(row["weight"], 3),
        "gives": number(row["mean"]),
        "colours": "  ".join(number(v) for v in row["gives"]),
        "blocked": f"{row['blocked']['mesh']} at {place(row['blocked']['position'])}" if row.get("blocked") else "",
    }


def place(position: Sequence[float]) -> str:
    """A position in m, to the millimetre."""
    return ", ".join(f"{v:.3f}" for v in position)


def draw_pixel(view: SceneView, found: Mapping[str, Any]) -> U8:
    """The picture around the pixel, enlarged: the sample (yellow), its eight probes by kind, and the ways to them, red where a surface
    stands between. (H', W', 3) sRGB bytes."""
    xy, _ = project(view.pose, np.array([found["sample"], *(row["position"] for row in found["probes"])]))
    shown = xy[np.isfinite(xy).all(axis=1)]
    low, high = _window(shown, np.array([found["x"] + 0.5, found["y"] + 0.5]), view.pictures.hit.shape)
    scale = SIZE / float((high - low).max())
    base = ground(view.pictures, 1.0).crop((int(low[0]), int(low[1]), int(high[0]), int(high[1])))
    image = base.resize((round(base.width * scale), round(base.height * scale)), Image.Resampling.NEAREST)
    pen = ImageDraw.Draw(image)
    at = [(float(p[0]), float(p[1])) for p in (xy - low) * scale]
    for row, end in zip(found["probes"], at[1:], strict=True):
        if np.isfinite(end).all():
            pen.line([at[0], end], fill=BLOCKED if row.get("blocked") else SEEN, width=1)
    for i, (row, end) in enumerate(zip(found["probes"], at[1:], strict=True)):
        if np.isfinite(end).all():
            radius = 5.0 + 11.0 * float(np.sqrt(max(row["weight"], 0.0)))
            draw_dot(pen, end, radius, BLOCKED if row.get("blocked") else SEEN, KINDS[row["kind"]])
            pen.text((end[0] + radius + 2.0, end[1] - 6.0), str(i + 1), fill=(255, 255, 255))
    edge = scale * 0.5
    corner = (np.array([found["x"], found["y"]]) - low) * scale
    pen.rectangle([corner[0], corner[1], corner[0] + 2 * edge, corner[1] + 2 * edge], outline=HERE, width=2)
    return np.asarray(image, np.uint8)


def _window(points: F64, pixel: F64, shape: tuple[int, ...]) -> tuple[F64, F64]:
    """Lower and upper corner of the part of the picture that holds all points, or what of them lies in it."""
    size = np.array([shape[1], shape[0]], dtype=np.float64)
    inside = np.clip(np.vstack([points, pixel]), 0.0, size)
    low, high = inside.min(axis=0), inside.max(axis=0)
    half = max(0.5 * float((high - low).max()) * (1.0 + 2.0 * ROOM), 0.5 * LEAST_WINDOW)
    half = min(half, 0.5 * float(size.min()))
    middle = np.clip(0.5 * (low + high), half, size - half)
    return np.floor(middle - half), np.ceil(middle + half)
