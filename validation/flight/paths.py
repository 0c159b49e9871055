"""The paths a viewer takes, each a pure function of where the scene is and of the number of frames.

    orbit      once around the middle, on an ellipse of ORBIT of the half extents, looking inwards
    line       straight through the middle along the longer side at WALKING_SPEED, PER_SECOND frames a second, looking ahead
    teleport   the cameras' places first, then places spread evenly over the scene, DWELL frames at each

Heights follow the surfaces below and around: the mean height of surface points, weighted by exp(-d²/2r²) with d the horizontal
distance.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.stats import qmc

from ...reference.datatypes import F64

WALKING_SPEED, PER_SECOND = 1.4, 10.0  # m/s; frames per second
EYE = 1.7  # m above the ground
ORBIT, ORBIT_CLEARANCE = 0.6, 0.05  # of the half extents; of the horizontal diagonal
SPAN = (2.0, 98.0)  # percentiles of the surface points that count as the scene's extent
SMOOTHED = 0.015  # r, of the horizontal diagonal
HEADROOM = 0.1  # of the height: viewers stay this far under the highest point
SMALL = 0.3  # of the horizontal diagonal: no viewer stands higher than this over its ground
LOWEST = 0.1  # share of the surface around that lies under what is walked on
INNER, DWELL = 0.8, 5


@dataclass(frozen=True, eq=False)
class Places:
    """Where a scene is: points (N, 3) m on the surfaces that the viewer is to see, N ≥ 1, and the positions of its cameras, stops
    (S, 3) m."""

    points: F64
    stops: F64

    @property
    def lower(self) -> F64:
        """Lower corner of the extent, (3,) m."""
        return np.asarray(np.percentile(self.points, SPAN[0], axis=0))

    @property
    def upper(self) -> F64:
        """Upper corner of the extent, (3,) m."""
        return np.asarray(np.percentile(self.points, SPAN[1], axis=0))

    @property
    def middle(self) -> F64:
        """Centre of the extent, (3,) m, at the mean height of the points."""
        middle = 0.5 * (self.lower + self.upper)
        middle[1] = self.points[:, 1].mean()
        return np.asarray(middle)

    @property
    def diagonal(self) -> float:
        """Horizontal diagonal of the extent, m, above 0."""
        return max(float(np.hypot(*(self.upper - self.lower)[[0, 2]])), 1e-6)


@dataclass(frozen=True, eq=False)
class Path:
    """positions, targets (F, 3) f64 m: where the viewer is in each frame, and what it looks at."""

    positions: F64
    targets: F64


def viewer_path(name: str, places: Places, frames: int) -> Path:
    """The path called `name`, one of PATHS."""
    path = PATHS[name](places, frames)
    # A view straight down has no horizon: look a little past what lies below.
    away = path.targets - path.positions
    down = np.hypot(away[:, 0], away[:, 2]) < 1e-3 * places.diagonal
    return Path(path.positions, path.targets + np.where(down, 0.1 * places.diagonal, 0.0)[:, None] * [1.0, 0.0, 0.0])


def orbit(places: Places, frames: int) -> Path:
    """Once around the middle, looking inwards."""
    angle = 2.0 * np.pi * np.arange(frames) / frames
    half = 0.5 * ORBIT * (places.upper - places.lower)
    x = places.middle[0] + half[0] * np.cos(angle)
    z = places.middle[2] + half[2] * np.sin(angle)
    positions = _above(places, x, z, max(EYE, ORBIT_CLEARANCE * places.diagonal))
    return Path(positions, np.tile(places.middle, (frames, 1)))


def line(places: Places, frames: int) -> Path:
    """Through the middle at walking speed, looking ahead; not beyond the scene."""
    axis = 0 if places.upper[0] - places.lower[0] >= places.upper[2] - places.lower[2] else 2
    length = min(WALKING_SPEED / PER_SECOND * (frames - 1), INNER * float((places.upper - places.lower)[axis]))
    along = places.middle[axis] + length * (np.arange(frames) / (frames - 1) - 0.5)
    across = np.full(frames, places.middle[2 - axis])
    x, z = (along, across) if axis == 0 else (across, along)
    positions = _above(places, x, z, EYE, floor=True)
    ahead = np.zeros(3)
    ahead[axis] = max(0.1 * places.diagonal, EYE)
    return Path(positions, positions + ahead)


def teleport(places: Places, frames: int) -> Path:
    """From camera to camera, then all over the scene, looking at the middle."""
    jumps = -(-frames // DWELL)
    spread = qmc.Halton(2, scramble=False).random(jumps + 1)[1:]  # the first is a corner
    inner = places.middle[[0, 2]] + INNER * (spread - 0.5) * (places.upper - places.lower)[[0, 2]]
    anywhere = _above(places, inner[:, 0], inner[:, 1], EYE, floor=True)
    stops = np.concatenate([places.stops.reshape(-1, 3), anywhere])[:jumps]
    return Path(np.repeat(stops, DWELL, axis=0)[:frames], np.tile(places.middle, (frames, 1)))


def _above(places: Places, x: F64, z: F64, clearance: float, floor: bool = False) -> F64:
    """Places (F, 3) m at (x, z), `clearance` m above the surfaces around: above their mean, or above the lowest of them, which who
    walks stands on though there be a roof above."""
    d2 = (places.points[:, 0] - x[:, None]) ** 2 + (places.points[:, 2] - z[:, None]) ** 2
    weight = np.exp(-(d2 - d2.min(axis=1, keepdims=True)) / (2.0 * (SMOOTHED * places.diagonal) ** 2))
    ground = weight @ places.points[:, 1] / weight.sum(axis=1)
    if floor:
        order = np.argsort(places.points[:, 1])
        below = np.cumsum(weight[:, order], axis=1) / weight.sum(axis=1, keepdims=True)
        ground = places.points[order, 1][(below >= LOWEST).argmax(axis=1)]
    clearance = min(clearance, SMALL * places.diagonal)
    top, height = float(places.points[:, 1].max()), float(np.ptp(places.points[:, 1]))
    # A room has a ceiling; a plain with some bushes has none.
    ceiling = np.maximum(top - HEADROOM * height, ground) if height > clearance else np.inf
    return np.column_stack([x, np.minimum(ground + clearance, ceiling), z])


PATHS: dict[str, Callable[[Places, int], Path]] = {"orbit": orbit, "line": line, "teleport": teleport}
