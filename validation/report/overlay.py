"""Probes drawn over a camera's picture: where they are, at which level, of which kind.

Colour says the level (blue the coarsest, red the finest), shape the kind: a filled disc is a real, valid probe, a small
ring a virtual one, a cross an invalid one. A probe behind the surface seen there is hidden; the nearest is drawn last.
The dots grow with their voxel and shrink with distance, within what can be read. Probes further than a voxel from all
that the camera sees cannot light any of it: they are faint and below the others, else the air in front of a far
surface, or the sky, would hide what the picture is about.
"""

from __future__ import annotations

import math

import numpy as np
from PIL import Image, ImageDraw
from scipy.spatial import cKDTree

from ...reference.datatypes import F32, F64, I32, U8, Bool
from .pictures import (
    INVALID,
    VIRTUAL,
    CameraPictures,
    CameraPose,
    ProbeDots,
    error_floor,
    exposure,
    luminance,
    srgb_bytes,
)

MIN_WIDTH = 800
SUPERSAMPLE = 2
RADIUS = (1.7, 6.5)
DOT_PER_VOXEL = 0.065
FAINT, FAINT_RADIUS = 0.32, 2.4
SOFT = {VIRTUAL: 0.8, INVALID: 0.7}
NEAR = 1e-6
# Coarse to fine, bright enough for a dark ground, told apart also by colour-blind readers through their lightness.
LEVEL_STOPS = ((64, 124, 255), (48, 205, 230), (105, 225, 105), (255, 224, 70), (255, 150, 50), (245, 80, 85))
Colour = tuple[int, int, int]


def level_colours(levels: I32 | list[int]) -> dict[int, Colour]:
    """Colour of each level that occurs, spread over the whole scale."""
    found = sorted({int(level) for level in levels})
    places = np.linspace(0.0, len(LEVEL_STOPS) - 1.0, len(found)) if len(found) > 1 else np.zeros(len(found))
    at = range(len(LEVEL_STOPS))
    rgb = [[round(float(np.interp(p, at, [s[i] for s in LEVEL_STOPS]))) for i in range(3)] for p in places]
    return {level: (c[0], c[1], c[2]) for level, c in zip(found, rgb, strict=True)}


def axes(pose: CameraPose) -> F64:
    """(3, 3) rows: unit vectors to the right, up and ahead."""
    origin, target, up = (np.asarray(v, np.float64) for v in (pose.origin, pose.target, pose.up))
    ahead = (target - origin) / np.linalg.norm(target - origin)
    right = np.cross(ahead, up)
    right /= np.linalg.norm(right)
    return np.stack([right, np.cross(right, ahead), ahead])


def focal(pose: CameraPose) -> float:
    """Pixels per unit of tangent: focal length in pixels."""
    return 0.5 * pose.width / math.tan(math.radians(pose.fov_deg) / 2.0)


def project(pose: CameraPose, points: F32 | F64) -> tuple[F64, F64]:
    """(N, 3) m -> (N, 2) pixel coordinates (0, 0 the top left corner; NaN behind the camera) and (N,) distances, m."""
    offset = np.asarray(points, np.float64).reshape(-1, 3) - np.asarray(pose.origin, np.float64)
    right, up, ahead = (offset @ axis for axis in axes(pose))
    per_metre = np.divide(focal(pose), ahead, out=np.full(len(offset), np.nan), where=ahead > NEAR)
    xy = np.stack([0.5 * pose.width + right * per_metre, 0.5 * pose.height - up * per_metre], axis=-1)
    return xy, np.linalg.norm(offset, axis=-1)


def seen_points(pictures: CameraPictures, pose: CameraPose) -> F64:
    """(N, 3) m, the surface points behind the pixels: the inverse of `project` at the pixels' middles."""
    row, column = np.nonzero(pictures.hit & np.isfinite(pictures.depth))
    x, y = (column + 0.5 - 0.5 * pose.width) / focal(pose), (0.5 * pose.height - row - 0.5) / focal(pose)
    direction = np.stack([x, y, np.ones_like(x)], axis=-1) @ axes(pose)
    direction /= np.linalg.norm(direction, axis=-1, keepdims=True)
    points: F64 = np.asarray(pose.origin, np.float64) + direction * pictures.depth[row, column, None]
    return points


def lighting(pictures: CameraPictures, pose: CameraPose, dots: ProbeDots, sizes: dict[int, float]) -> Bool:
    """(N,) bool: no further than its own voxel size from a surface point that the camera sees."""
    points = seen_points(pictures, pose)
    if not len(points) or not len(dots.level):
        return np.zeros(len(dots.level), np.bool_)
    reach = np.array([sizes[int(level)] for level in dots.level])
    gap, _ = cKDTree(points).query(dots.positions, distance_upper_bound=float(reach.max()) * 1.001)
    result: Bool = gap <= reach
    return result


def visible(pictures: CameraPictures, xy: F64, distance: F64, tolerance: float = 0.02) -> Bool:
    """(N,) bool: inside the picture, and not behind the surface seen there (2 % and a pixel's slope are forgiven)."""
    height, width = pictures.hit.shape
    inside = np.isfinite(xy).all(axis=-1) & (xy >= 0.0).all(axis=-1) & (xy[:, 0] < width) & (xy[:, 1] < height)
    column, row = np.where(inside[:, None], xy, 0.0).astype(np.int64).T
    seen = np.where(pictures.hit & np.isfinite(pictures.depth), pictures.depth, np.inf)
    result: Bool = inside & (distance <= seen[row, column] * (1.0 + tolerance))
    return result


def voxel_sizes(dots: ProbeDots) -> dict[int, float]:
    """Voxel size of each level, m, read off the lattice that the probes of the finest level stand on."""
    if not len(dots.level):
        return {}
    finest = int(dots.level.max())
    places = dots.positions[dots.level == finest].astype(np.float64)
    extent = float(np.ptp(dots.positions, axis=0).max()) or 1.0
    gaps = np.concatenate([np.diff(np.unique(np.round(places[:, axis] / extent, 5))) for axis in range(3)])
    size = float(gaps.min()) * extent if gaps.size else extent
    return {int(level): size * 2.0 ** (finest - int(level)) for level in np.unique(dots.level)}


def ground(pictures: CameraPictures, scale: float) -> Image.Image:
    """The picture to draw on: our reflected light (it has no noise) as dimmed gray, enlarged by `scale`."""
    lit = np.nan_to_num(pictures.ours * pictures.albedo, nan=0.0, posinf=0.0, neginf=0.0)
    factor = exposure(lit, lit, pictures.hit)
    lift = error_floor(lit, pictures.hit) + pictures.albedo.mean(axis=-1) * (0.06 / factor)
    gray = srgb_bytes((luminance(lit) + lift).astype(np.float32) * np.float32(factor)).astype(np.float32) * 0.5 + 14.0
    gray[~pictures.hit] = 30.0
    image = Image.fromarray(gray.astype(np.uint8))
    height, width = pictures.hit.shape
    large = image.resize((round(width * scale), round(height * scale)), Image.Resampling.BICUBIC)
    return large.convert("RGB")


def draw_probes(pictures: CameraPictures, pose: CameraPose, dots: ProbeDots) -> U8:
    """The probes over the dimmed picture -> (H', W', 3) sRGB bytes, at least `MIN_WIDTH` wide."""
    width = pictures.hit.shape[1]
    scale = max(1, math.ceil(MIN_WIDTH / width)) * SUPERSAMPLE
    image = ground(pictures, scale)
    xy, distance = project(pose, dots.positions)
    sizes, colours = voxel_sizes(dots), level_colours(dots.level)
    near = lighting(pictures, pose, dots, sizes)
    shown = np.flatnonzero(visible(pictures, xy, distance))
    order = shown[np.lexsort((-distance[shown], near[shown]))]
    canvas = ImageDraw.Draw(image)
    for i in order:
        level, kind = int(dots.level[i]), int(dots.kind[i])
        radius = DOT_PER_VOXEL * sizes[level] * focal(pose) * scale / SUPERSAMPLE / max(float(distance[i]), NEAR)
        radius = min(max(radius, RADIUS[0]), RADIUS[1] if near[i] else FAINT_RADIUS) * SUPERSAMPLE
        centre = (float(xy[i, 0]) * scale, float(xy[i, 1]) * scale)
        strength = SOFT.get(kind, 1.0) * (1.0 if near[i] else FAINT)
        draw_dot(canvas, centre, radius, mixed(colours[level], strength), kind, edged=bool(near[i]))
    small = image.resize((image.width // SUPERSAMPLE, image.height // SUPERSAMPLE), Image.Resampling.BOX)
    return np.asarray(small, np.uint8)


def mixed(colour: Colour, strength: float) -> Colour:
    """The colour over a dark gray."""
    r, g, b = (round(strength * c + (1.0 - strength) * 55.0) for c in colour)
    return r, g, b


def draw_dot(
    canvas: ImageDraw.ImageDraw, at: tuple[float, float], radius: float, colour: Colour, kind: int, edged: bool = True
) -> None:
    """One probe. Shape by kind; a real one has a dark edge that sets it off from its neighbours."""
    x, y = at
    line = max(1, round(0.32 * radius))
    if kind == INVALID:
        r = radius * 0.8
        canvas.line([(x - r, y - r), (x + r, y + r)], fill=colour, width=line)
        canvas.line([(x - r, y + r), (x + r, y - r)], fill=colour, width=line)
    elif kind == VIRTUAL:
        r = radius * 0.75
        canvas.ellipse([x - r, y - r, x + r, y + r], outline=colour, width=line)
    else:
        edge = radius + SUPERSAMPLE * 0.6
        if edged:
            canvas.ellipse([x - edge, y - edge, x + edge, y + edge], fill=(12, 12, 14))
        canvas.ellipse([x - radius, y - radius, x + radius, y + radius], fill=colour)


def surface_marks(pictures: CameraPictures, pose: CameraPose, points: F64) -> list[tuple[int, float, float]]:
    """(index, x, y) in pixels of the surface points, (N, 3) m, that this camera sees."""
    if not len(points):
        return []
    xy, distance = project(pose, points)
    height, width = pictures.hit.shape
    column, row = (np.clip(np.nan_to_num(xy[:, i]), 0, n - 1).astype(np.int64) for i, n in ((0, width), (1, height)))
    near = np.abs(pictures.depth[row, column] - distance) <= 0.05 * distance
    keep = visible(pictures, xy, distance, 0.05) & pictures.hit[row, column] & near
    return [(int(i), float(xy[i, 0]), float(xy[i, 1])) for i in np.flatnonzero(keep)]


def space_marks(pictures: CameraPictures, pose: CameraPose, points: F64) -> list[tuple[int, float, float]]:
    """(index, x, y) in pixels of the places, (N, 3) m, on surfaces or in the air before them, that this camera sees."""
    if not len(points):
        return []
    xy, distance = project(pose, points)
    return [(int(i), float(xy[i, 0]), float(xy[i, 1])) for i in np.flatnonzero(visible(pictures, xy, distance))]
