"""Pictures to linear-light arrays: PNG, JPEG, BMP and TGA through Pillow, EXR through OpenEXR.

The sRGB transfer function is that of IEC 61966-2-1.
"""

from __future__ import annotations

import warnings
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import OpenEXR  # type: ignore[import-not-found, unused-ignore]
from PIL import Image, UnidentifiedImageError
from scipy import sparse

from ..datatypes import F32, F64
from ..errors import InputError
from .paths import check_file

MAX_PIXELS = 1 << 25
MAX_TEXTURE_SIDE = 2048
MAX_SKY = (512, 1024)
STRIP = 256  # columns
PILLOW_FORMATS = ("PNG", "JPEG", "BMP", "TGA")


class Picture(NamedTuple):
    """rgb: (H, W, 3) f32. alpha: (H, W) f32 in 0..1, or None."""

    rgb: F32
    alpha: F32 | None


def srgb_to_linear(x: F64) -> F64:
    """Linear light of sRGB values in 0..1."""
    return np.where(x <= 0.04045, x / 12.92, ((np.maximum(x, 0.04045) + 0.055) / 1.055) ** 2.4)


EIGHT_BIT = (np.arange(256) / 255.0).astype(np.float32)
EIGHT_BIT_SRGB = srgb_to_linear(np.arange(256) / 255.0).astype(np.float32)


def _area_weights(length: int, size: int) -> sparse.csr_array:
    """(size, length) share of each old pixel in each new one; rows sum to 1."""
    edges = np.linspace(0.0, length, size + 1)
    first, last = edges[:-1].astype(np.int64), np.minimum(np.ceil(edges[1:]).astype(np.int64), length)
    counts = last - first
    rows = np.repeat(np.arange(size), counts)
    columns = np.arange(len(rows)) - np.repeat(np.cumsum(counts) - counts, counts) + first[rows]
    overlap = np.minimum(columns + 1.0, edges[rows + 1]) - np.maximum(columns, edges[rows])
    return sparse.csr_array((overlap * (size / length), (rows, columns)), (size, length))


def _fewer_rows(image: F32, size: int) -> F32:
    """Rows averaged by area to `size`, a strip of columns at a time: in float64 a whole picture would take gigabytes."""
    weights = _area_weights(len(image), size)
    out = np.empty((size, *image.shape[1:]), np.float32)
    for start in range(0, image.shape[1], STRIP):
        strip = image[:, start : start + STRIP]
        out[:, start : start + STRIP] = (weights @ strip.reshape(len(strip), -1)).reshape(size, *strip.shape[1:])
    return out


def shrink(image: F32, height: int, width: int) -> F32:
    """Area average to at most height × width; exact for any ratio, so the mean is kept."""
    if image.shape[0] <= height and image.shape[1] <= width:
        return image
    out = _fewer_rows(image, height) if image.shape[0] > height else image
    if out.shape[1] > width:
        out = np.ascontiguousarray(np.swapaxes(_fewer_rows(np.swapaxes(out, 0, 1), width), 0, 1))
    return out


def shrunk(picture: Picture) -> Picture:
    """The picture with no side over MAX_TEXTURE_SIDE."""
    alpha = picture.alpha
    side = MAX_TEXTURE_SIDE
    return Picture(shrink(picture.rgb, side, side), None if alpha is None else shrink(alpha, side, side))


def _refuse_large(width: int, height: int, where: str) -> None:
    if width < 1 or height < 1 or width * height > MAX_PIXELS:
        raise InputError(f"{where}: the picture is {width} × {height}, at most {MAX_PIXELS} pixels allowed; shrink it")


def decode_pillow(source: Any, where: str, raw: bool = False) -> Picture:
    """A picture that Pillow reads, from a path or a binary stream. raw: the numbers are linear already."""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error", Image.DecompressionBombWarning)
            with Image.open(source, formats=PILLOW_FORMATS) as image:
                _refuse_large(*image.size, where)
                deep = image.mode.startswith("I")
                values = np.asarray(image if deep else image.convert("RGBA"))
                alpha = not deep and image.has_transparency_data
    except (Image.DecompressionBombError, Image.DecompressionBombWarning) as error:
        raise InputError(f"{where}: the picture is too large: {error}; shrink it") from error
    except (UnidentifiedImageError, OSError, ValueError, SyntaxError, EOFError) as error:
        raise InputError(
            f"{where}: cannot decode the picture ({error}); expected PNG, JPEG, BMP, TGA or EXR"
        ) from error
    if deep:  # 16 bits of grey
        grey = np.clip(values.astype(np.float64) / 65535.0, 0.0, 1.0)
        linear = np.repeat((grey if raw else srgb_to_linear(grey))[..., None], 3, axis=2).astype(np.float32)
    else:
        linear = (EIGHT_BIT if raw else EIGHT_BIT_SRGB)[values[..., :3]]
    return Picture(linear, EIGHT_BIT[values[..., 3]] if alpha else None)


def _exr_channels(path: Path, where: str) -> dict[str, F32]:
    try:
        with OpenEXR.File(str(path), header_only=True) as head:
            low, high = head.header()["dataWindow"]
        _refuse_large(int(high[0]) - int(low[0]) + 1, int(high[1]) - int(low[1]) + 1, where)
        with OpenEXR.File(str(path), separate_channels=True) as file:
            return {n: np.asarray(c.pixels, np.float32) for n, c in file.channels().items()}
    except InputError:
        raise
    except Exception as error:  # the binding raises bare RuntimeError, TypeError and others for broken files
        raise InputError(f"{where}: cannot decode the EXR ({error}); export it again as RGB scan lines") from error


def _exr(path: Path, where: str) -> Picture:
    channels = _exr_channels(path, where)
    if {"R", "G", "B"} <= set(channels):
        rgb = np.stack([channels[c] for c in "RGB"], axis=2)
    elif "Y" in channels:
        rgb = np.repeat(channels["Y"][..., None], 3, axis=2)
    else:
        raise InputError(f"{where}: the EXR needs channels R, G, B or Y, got {sorted(channels)[:8]}")
    return Picture(rgb, channels.get("A"))


def read_picture(path: Path, where: str, raw: bool = False) -> Picture:
    """Any supported picture. Raises InputError for files that are missing, too large, broken or not finite."""
    check_file(path, where)
    where = f"{where}: {path.name}"
    picture = _exr(path, where) if path.suffix.lower() == ".exr" else decode_pillow(path, where, raw)
    if not np.isfinite(picture.rgb).all():
        raise InputError(f"{where}: the picture holds values that are not finite; repair it")
    return picture


def read_sky(path: Path, where: str) -> tuple[F32, list[str]]:
    """(H, W, 3) f32 radiance of a latitude-longitude picture, at most 512 × 1024, and notes. Raises InputError."""
    rgb = read_picture(path, where).rgb
    if rgb.min() < 0.0:
        raise InputError(f"{where}: {path.name}: the sky holds negative radiance; repair the picture")
    small = shrink(rgb, *MAX_SKY)
    notes = []
    if small.shape != rgb.shape:
        was, now = f"{rgb.shape[1]} × {rgb.shape[0]}", f"{small.shape[1]} × {small.shape[0]}"
        notes.append(f"{where}: sky averaged from {was} to {now} pixels")
    return small, notes
