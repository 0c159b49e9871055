"""One camera's pictures as the page carries them: fallback PNGs, and the light itself for the exposure slider.

The light is packed as half floats relative to the truth's bright end, high bytes apart from low ones (they compress):
truth | ours | albedo (sRGB bytes) | hit (0 or 1), zlib, base64. `page.js` is the reader: change both together.
"""

from __future__ import annotations

import base64
import zlib

import numpy as np

from ...reference.datatypes import F32
from ..record_models import JsonObject
from .pictures import (
    ERROR_CLIP,
    ERROR_STOPS,
    NO_SURFACE,
    WHITE_AT,
    CameraPictures,
    error_colours,
    error_floor,
    exposure,
    png_bytes,
    relative_error,
    srgb_bytes,
    tonemap,
)

HALF_MAX = 65504.0


def base64_text(data: bytes) -> str:
    """ASCII of base64."""
    return base64.b64encode(data).decode("ascii")


def data_uri(data: bytes) -> str:
    """A PNG as an address for `<img src>`."""
    return f"data:image/png;base64,{base64_text(data)}"


def halves(picture: F32, factor: float) -> bytes:
    """(H, W, 3) times factor as half floats: all high bytes, then all low bytes. Not finite becomes NaN."""
    scaled = np.where(np.isfinite(picture), np.clip(picture * np.float32(factor), -HALF_MAX, HALF_MAX), np.nan)
    pairs = scaled.astype("<f2").reshape(-1, 1).view(np.uint8)
    return pairs[:, 1].tobytes() + pairs[:, 0].tobytes()


def pixels(pictures: CameraPictures) -> JsonObject:
    """What `page.js` needs to draw the three canvases. unit: W·m⁻² of a stored 1. white: exposure per view."""
    hit = pictures.hit
    unit = WHITE_AT / exposure(pictures.truth, pictures.ours, hit)
    reflected = exposure(pictures.truth * pictures.albedo, pictures.ours * pictures.albedo, hit)
    blank = np.where(hit[..., None], pictures.albedo, np.float32(0.0))
    packed = b"".join(
        (
            halves(np.where(hit[..., None], pictures.truth, np.float32(0.0)), 1.0 / unit),
            halves(np.where(hit[..., None], pictures.ours, np.float32(0.0)), 1.0 / unit),
            srgb_bytes(blank).tobytes(),
            hit.astype(np.uint8).tobytes(),
        )
    )
    return {
        "width": hit.shape[1],
        "height": hit.shape[0],
        "unit": unit,
        "white": {"irradiance": WHITE_AT, "reflected": reflected * unit},
        "floor": error_floor(pictures.truth, hit) / unit,
        "clip": ERROR_CLIP,
        "stops": [[place, *colour] for place, colour in ERROR_STOPS],
        "gray": list(NO_SURFACE),
        "data": base64_text(zlib.compress(packed, 9)),
    }


def fallback(pictures: CameraPictures) -> dict[str, str]:
    """PNG addresses of truth, ours and error, for a browser without scripts."""
    factor = exposure(pictures.truth, pictures.ours, pictures.hit)
    error = relative_error(pictures.truth, pictures.ours, pictures.hit)
    return {
        "truth": data_uri(png_bytes(tonemap(pictures.truth, pictures.hit, factor), 128)),
        "ours": data_uri(png_bytes(tonemap(pictures.ours, pictures.hit, factor), 128)),
        "error": data_uri(png_bytes(error_colours(error, pictures.hit), 64)),
    }


def broken_pixels(pictures: CameraPictures) -> int:
    """How many pixels on a surface are not finite."""
    finite = np.isfinite(pictures.truth).all(axis=-1) & np.isfinite(pictures.ours).all(axis=-1)
    return int((pictures.hit & ~finite).sum())
