"""The pictures of one camera, and how they become colours.

A picture holds indirect irradiance, W·m⁻². Shown is `sRGB(clip(exposure · E, 0, 1))`, with one exposure for truth and
ours: the 90th percentile of the truth's luminance becomes `WHITE_AT`. The signed relative error of a pixel is

    e = (Y(ours) - Y(truth)) / (Y(truth) + 0.01 mean Y(truth)),   Y the Rec. 709 luminance,

clipped at ±50 %; the second summand keeps pixels that are all but black from shouting.
"""

from __future__ import annotations

import io
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from PIL import Image

from ...reference.datatypes import F32, I32, U8, Bool

LUMINANCE = np.array([0.2126, 0.7152, 0.0722], np.float32)
WHITE_AT = 0.7
ERROR_CLIP = 0.5
NO_SURFACE = (128, 128, 128)
NOT_A_NUMBER = (255, 0, 255)
# Diverging, safe for colour-blind readers (ColorBrewer RdBu): too dark is blue, right is near white, too bright is red.
ERROR_STOPS = (
    (0.0, (5, 48, 97)), (0.2, (67, 147, 195)), (0.4, (209, 229, 240)), (0.5, (247, 247, 247)),
    (0.6, (253, 219, 199)), (0.8, (214, 96, 77)), (1.0, (103, 0, 31)),
)  # fmt: skip
REAL, VIRTUAL, INVALID = 0, 1, 2


@dataclass(frozen=True, eq=False)
class CameraPose:
    """Pinhole camera. origin, target: m. up: need not be orthogonal. fov_deg: full horizontal angle. Row 0 on top."""

    origin: Sequence[float]
    target: Sequence[float]
    up: Sequence[float]
    fov_deg: float
    width: int
    height: int


@dataclass(frozen=True, eq=False)
class ProbeDots:
    """Probes to draw. positions: (N, 3) m. level: (N,), 0 the coarsest. kind: (N,) u8, REAL, VIRTUAL or INVALID."""

    positions: F32
    level: I32
    kind: U8


@dataclass(frozen=True, eq=False)
class CameraPictures:
    """What one camera sees.

    truth, ours: (H, W, 3) f32 indirect irradiance, W·m⁻². albedo: (H, W, 3) f32, 0..1. hit: (H, W) bool, a surface is
    seen. depth: (H, W) f32, distance from the camera's origin along the pixel's ray, m. truth_noise: relative standard
    error of the truth's pixels (RMS over mean).
    """

    scene: str
    camera: str
    truth: F32
    ours: F32
    hit: Bool
    albedo: F32
    truth_noise: float
    depth: F32

    def __post_init__(self) -> None:
        height, width = self.hit.shape
        for name, last in (("truth", (3,)), ("ours", (3,)), ("albedo", (3,)), ("depth", ())):
            shape = getattr(self, name).shape
            if shape != (height, width, *last):
                raise ValueError(f"{name}: expected shape {(height, width, *last)}, got {shape}")


@dataclass(frozen=True, eq=False)
class SceneView:
    """One camera of one scene, with the probes to draw over its picture (None: nothing to draw). links: by name (H, W) f32, the signed
    relative error that each link of the waterfall makes, None where it was not taken apart."""

    pictures: CameraPictures
    pose: CameraPose
    dots: ProbeDots | None = None
    links: Mapping[str, F32] | None = None


def luminance(rgb: F32) -> F32:
    """(..., 3) linear RGB -> (...) luminance; not-a-number stays what it is."""
    result: F32 = (rgb @ LUMINANCE).astype(np.float32)
    return result


def exposure(truth: F32, ours: F32, hit: Bool) -> float:
    """Factor that takes the truth's bright end (90th percentile of what is lit, else that of ours) to `WHITE_AT`."""
    for picture in (truth, ours):
        y = luminance(picture)
        lit = y[hit & np.isfinite(y) & (y > 0.0)]
        if lit.size:
            bright = float(np.percentile(lit, 90.0))
            if bright > 1e-30:
                return WHITE_AT / bright
    return 1.0


def srgb_bytes(linear: F32) -> U8:
    """Linear 0..1 -> sRGB bytes; clips, not-a-number is 0."""
    x = np.clip(np.nan_to_num(linear, nan=0.0, posinf=1.0, neginf=0.0), 0.0, 1.0)
    encoded = np.where(x <= 0.0031308, 12.92 * x, 1.055 * np.power(x, 1.0 / 2.4) - 0.055)
    return np.round(encoded * 255.0).astype(np.uint8)


def tonemap(picture: F32, hit: Bool, factor: float) -> U8:
    """(H, W, 3) linear -> (H, W, 3) sRGB bytes at exposure `factor`; no surface is gray, not-a-number magenta."""
    shown = srgb_bytes(picture * np.float32(factor))
    shown[~np.isfinite(picture).all(axis=-1)] = NOT_A_NUMBER
    shown[~hit] = NO_SURFACE
    return shown


def error_floor(truth: F32, hit: Bool) -> float:
    """The summand 0.01 · mean Y(truth) below the fraction of the relative error, W·m⁻²."""
    y = luminance(truth)
    seen = y[hit & np.isfinite(y)]
    return 0.01 * max(float(seen.mean()), 0.0) if seen.size else 0.0


def relative_error(truth: F32, ours: F32, hit: Bool) -> F32:
    """(H, W) signed relative error, 0 where nothing is hit, NaN where a pixel is not finite. Black truth: ±1 or 0."""
    y_truth, y_ours = luminance(truth), luminance(ours)
    difference = y_ours - y_truth
    below = np.abs(y_truth) + np.float32(error_floor(truth, hit))
    ratio = np.divide(difference, below, out=np.sign(difference), where=below > 0.0)
    return np.where(hit, ratio, np.float32(0.0)).astype(np.float32)


def error_colours(error: F32, hit: Bool) -> U8:
    """(H, W) signed relative error -> (H, W, 3) sRGB bytes, clipped at ±`ERROR_CLIP`."""
    place = np.clip(np.nan_to_num(error, posinf=1.0, neginf=-1.0) / ERROR_CLIP, -1.0, 1.0) * 0.5 + 0.5
    stops = [s for s, _ in ERROR_STOPS]
    channels = [np.interp(place, stops, [c[i] for _, c in ERROR_STOPS]) for i in range(3)]
    shown = np.round(np.stack(channels, axis=-1)).astype(np.uint8)
    shown[~np.isfinite(error)] = NOT_A_NUMBER
    shown[~hit] = NO_SURFACE
    return shown


def png_bytes(picture: U8, colours: int | None = None) -> bytes:
    """(H, W, 3) sRGB bytes -> PNG, with a palette of so many colours if asked (smaller)."""
    image = Image.fromarray(picture)
    if colours is not None:
        image = image.quantize(colours, method=Image.Quantize.MEDIANCUT, dither=Image.Dither.NONE)
    buffer = io.BytesIO()
    image.save(buffer, "PNG", optimize=True)
    return buffer.getvalue()
