"""Thin walls (failure-catalogue C7): how much light comes through, beside the line t = h (|nx| + |ny| + |nz|)."""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np

from ...reference.config_base import Vec3
from ...reference.datatypes import F64
from ...reference.sh import COSINE_A0, Y0
from ...reference.variant import ensure_variant
from ..benchmarks.leak_scene import VOXEL, TwoRooms, dark_places, edge_corners, leaky_shift, tip_shift, two_rooms
from ..leaks.attribution import LEAKS_IN_DARK
from ..leaks.field import LightField, places
from ..leaks.prediction import wall_points
from .case import Reading
from .kernel_curve import KERNEL
from .kernel_reads import kernel_off, kernel_samples, mean_light
from .texture_worlds import units

TURNS: dict[str, Vec3] = {"straight": (0, 0, 0), "turned_30": (0, 30, 0), "turned_45": (0, 45, 0)}
PLACES = 1500
ON_EDGES = 100  # places along each of a room's edges


def needed(turn: str) -> float:
    """Thickness, in voxels, from which the upright walls of the turned rooms keep light in."""
    angle = math.radians(TURNS[turn][1])
    return math.cos(angle) + math.sin(angle)


def thin_wall(thickness: float, seed: int) -> Mapping[str, Reading]:
    """Walls of `thickness` voxels between two rooms and around them, on the lattice that is worst for them. By turn of the rooms:
    the most light at a place of the dark room over the light beyond its walls, through voxels of the usual size, by the weights of the
    probes read or as the kernel samples it; printed_…: largest relative error of the voxel size that the product says its upright walls
    need; edges_…: share of places along the turned rooms' edges, on a lattice into whose voxels one pokes without a corner, lit
    otherwise than half-spaces say; kernel: its largest difference from the plain sampler at those places."""
    ensure_variant()
    found: dict[str, Reading] = {}
    off: list[Reading] = []
    for name, turn in TURNS.items():
        rooms = two_rooms(thickness, turn)
        shift = leaky_shift(rooms)
        field = rooms.field(shift)
        at = dark_places(rooms, field, seed, PLACES)
        leaks = rooms.search(field, at, shift).leaks(field, at)
        own = leaks.leaks & (leaks.answers >= leaks.holds)
        strength = np.where(own, np.abs(leaks.strength), 0.0) / (COSINE_A0 * Y0)  # beyond the walls L00 is 1
        usual = leaks.answers >= leaks.holds
        found[name] = Reading(
            max(float(strength.max()), _sampled(field, at.positions[usual], seed)), 0.0, len(strength)
        )
        off += kernel_off(field.texture, at.positions, seed).values()
        walls = wall_points(rooms.scene, field.geometry, field.octree, field.texture, field.lift, seed)
        upright = (walls.mesh == 2) & (np.abs(walls.normals[:, 1]) < 0.5)
        wanted = VOXEL * thickness / needed(name)
        error = np.abs(walls.need[upright] / wanted - 1.0)
        found[f"printed_{name}"] = Reading(float(error.max()), 0.0, int(upright.sum()))
        if rooms.askew:
            found[f"edges_{name}"] = _along_edges(rooms, seed)
    return found | ({KERNEL: max(off, key=lambda r: r.value)} if off else {})


def _along_edges(rooms: TwoRooms, seed: int) -> Reading:
    """Along askew edges a larger voxel answers, and lights them through any wall that it reaches through."""
    shift = tip_shift(rooms, seed)
    field = rooms.field(shift)
    at = places(edge_corners(rooms, seed, ON_EDGES), None, "edges")
    leaks = rooms.search(field, at, shift).leaks(field, at).leaks
    foreseen = rooms.predicted(field, at).beyond * COSINE_A0 * Y0 > LEAKS_IN_DARK
    return Reading(float((leaks != foreseen).mean()), 0.0, at.count)


def _sampled(field: LightField, positions: F64, seed: int) -> float:
    """The most light that the kernel reads at positions (N, 3) m, over that beyond the walls; 0 without a device."""
    got = kernel_samples(field.texture, positions, units(len(positions), seed))
    return 0.0 if got is None else float(mean_light(got.irradiance).max(initial=0.0))
