"""Thin walls (failure-catalogue C7): how much light comes through, beside the line t = h (|nx| + |ny| + |nz|)."""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np

from ...reference.config_base import Vec3
from ...reference.sh import COSINE_A0, Y0
from ...reference.variant import ensure_variant
from ..benchmarks.leak_scene import VOXEL, dark_places, leaky_shift, two_rooms
from ..leaks.prediction import wall_points
from .case import Reading

TURNS: dict[str, Vec3] = {"straight": (0, 0, 0), "turned_30": (0, 30, 0), "turned_45": (0, 45, 0)}
PLACES = 1500


def needed(turn: str) -> float:
    """Thickness, in voxels, from which the upright walls of the turned rooms keep light in."""
    angle = math.radians(TURNS[turn][1])
    return math.cos(angle) + math.sin(angle)


def thin_wall(thickness: float, seed: int) -> Mapping[str, Reading]:
    """Walls of `thickness` voxels between two rooms and around them, on the lattice that is worst for them. By turn of the rooms:
    the most light at a place of the dark room over the light beyond its walls, through voxels of the usual size; printed_…: largest
    relative error of the voxel size that the product says its upright walls need."""
    ensure_variant()
    found = {}
    for name, turn in TURNS.items():
        rooms = two_rooms(thickness, turn)
        shift = leaky_shift(rooms)
        field = rooms.field(shift)
        at = dark_places(rooms, field, seed, PLACES)
        leaks = rooms.search(field, at, shift).leaks(field, at)
        own = leaks.leaks & (leaks.answers >= leaks.holds)
        strength = np.where(own, np.abs(leaks.strength), 0.0) / (COSINE_A0 * Y0)  # beyond the walls L00 is 1
        found[name] = Reading(float(strength.max()), 0.0, len(strength))
        walls = wall_points(rooms.scene, field.geometry, field.octree, field.texture, field.lift, seed)
        upright = (walls.mesh == 2) & (np.abs(walls.normals[:, 1]) < 0.5)
        wanted = VOXEL * thickness / needed(name)
        error = np.abs(walls.need[upright] / wanted - 1.0)
        found[f"printed_{name}"] = Reading(float(error.max()), 0.0, int(upright.sum()))
    return found
