"""Two rooms in one block, of any wall thickness and turned any way: where light leaks can be known exactly.

Everything but the second room counts as lit: the first room, and the outside. So each wall of the second room is tried, and a
place in it leaks exactly when it reads a probe that stands elsewhere. No light needs to be computed.
"""

from __future__ import annotations

import dataclasses
import itertools
import json
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ...reference import pipeline
from ...reference.config import SceneSettings
from ...reference.config_base import Vec3
from ...reference.datatypes import F64, I64, BitmapLayer, Material, Mesh, Scene
from ...reference.lattice import OCTANTS, index_of, keys
from ...reference.placement.dead_edges import ALONG, light_from
from ...reference.progress import silent
from ...reference.texture_types import VirtualTexture
from ...reference.truth.points import inside_share
from ...reference.turned import TurnedBox, rotation_matrix, turned
from ...reference.volume.indirection import build_indirection
from ...reference.volume.layout import build_layout
from ...reference.volume.tiles import fill_tiles, probe_texels, with_copies
from ..leaks.field import LightField, Places, places
from ..leaks.search import Search
from ..leaks.tips import BEYOND, IN_ROOM, IN_WALL, ServedBy, askew, served_by
from ..leaks.walls import spread

ROOM = np.array([4.0, 3.0, 3.0])  # voxels of 1 m
VOXEL = 1.0
INWARDS = 0.02  # of a voxel
TIP = 0.02  # of a voxel: by how much an edge pokes in
TIPS_TRIED = 64
LEVELS = 4  # of voxels that are held against a tip: 16 m are larger than the block
SIX = np.concatenate([np.eye(3), -np.eye(3)])  # ways along the lattice, voxels
OFF_MIDDLE = np.array([0.4371, 0.4639, 0.4713])
FACES = ((0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3))


@dataclass(frozen=True, eq=False)
class TwoRooms:
    """thickness, m, of all walls; matrix (3, 3) turns the scene; dark, lit: the second room and the first; block: both with their
    walls; surfaces: baked, as placement needs them."""

    thickness: float
    matrix: F64
    scene: Scene
    dark: TurnedBox
    lit: TurnedBox
    block: TurnedBox
    surfaces: pipeline.Surfaces

    def field(self, shift: F64, layers: Sequence[BitmapLayer] = ()) -> LightField:
        """Probes on a lattice shifted by (3,) voxels, with light where they do not stand in the dark room."""
        scene, g = dataclasses.replace(self.scene, bitmap=tuple(layers)), self.surfaces.geometry
        s = scene.settings.placement
        tree = pipeline.place(scene, self.surfaces, 0, shift)
        valid = inside_share(g, tree.positions, None) <= s.backface_tolerance
        source = light_from(g, tree, valid, s.backface_tolerance, 7)
        coefficients = np.zeros((len(valid), 4, 3), dtype=np.float32)
        coefficients[~self.dark.inside(tree.positions), 0] = 1.0
        layout = build_layout(tree)
        texels = fill_tiles(layout, probe_texels(*with_copies(coefficients, source)))
        grid = tree.grid
        texture = VirtualTexture(grid.origin, grid.finest, grid.level, grid.extent, build_indirection(layout), texels)
        return LightField(g, tree, layout, texture, source, coefficients, 0.5 * grid.wanted)

    @property
    def spreads(self) -> F64:
        """|nx| + |ny| + |nz| (3,) of the walls' three normals."""
        return spread(self.matrix.T)

    @property
    def keeps_light_in(self) -> bool:
        """Whether t ≥ h (|nx| + |ny| + |nz|) holds for all walls."""
        return bool((self.thickness >= VOXEL * self.spreads).all())

    @property
    def askew(self) -> bool:
        """Whether the room has edges that are askew to the lattice: of the four edges between each two walls, some turn either way."""
        m = self.matrix.T
        pairs = [(m[a], sign * m[b]) for a, b in ((0, 1), (0, 2), (1, 2)) for sign in (1.0, -1.0)]
        return any(bool(askew(a, b)) for a, b in pairs)

    @property
    def leak_free_everywhere(self) -> bool:
        """Whether no lattice of these voxels exists on which light comes in (`leaks.tips`)."""
        return self.keeps_light_in and not self.askew

    def kind(self, positions: F64) -> I64:
        """Whether positions (N, 3) m are in a wall, in the dark room, or beyond its walls: as in `leaks.tips`."""
        wall = self.block.inside(positions) & ~self.lit.inside(positions)
        return np.where(self.dark.inside(positions), IN_ROOM, np.where(wall, IN_WALL, BEYOND))

    def predicted(self, field: LightField, at: Places) -> ServedBy:
        """What answers at places, by half-spaces: corners in walls hold no light, but where placement copied a neighbour's."""
        octree, source = field.octree, field.source
        of_probe = self.kind(octree.positions)
        copied = (of_probe == IN_WALL) & (source >= 0) & (source != np.arange(len(source)))
        of_probe = np.where(copied, of_probe[source], of_probe)
        known, deepest = keys(octree.corners), octree.grid.level

        def kind(corner: I64, level: int) -> I64:
            return np.asarray(of_probe[index_of(known, keys(corner << (deepest - level)))])

        return served_by((at.positions - octree.grid.origin) / octree.grid.finest, deepest, kind)

    def search(self, field: LightField, at: Places, shift: F64) -> Search:
        """For leaks and edits: the second room must stay dark at places `at`."""
        return Search(field, at, self.dark.inside, 1.0, lambda layers: self.field(shift, layers))


def two_rooms(thickness: float, rotation: Vec3) -> TwoRooms:
    """The scene with walls of `thickness` voxels, turned by degrees about x, then y, then z."""
    t, m = thickness, rotation_matrix(rotation)
    x, y, z = ROOM
    boxes = {
        "outside": (np.array([-t, -t, -t]), np.array([2 * x + 2 * t, y + t, z + t]), False),
        "lit_room": (np.zeros(3), ROOM, True),
        "dark_room": (np.array([x + t, 0, 0]), np.array([2 * x + t, y, z]), True),
    }
    meshes = tuple(_box(name, low, high, inward, m) for name, (low, high, inward) in boxes.items())
    volumes = {n: {"min": boxes[n][0].tolist(), "max": boxes[n][1].tolist()} for n in ("lit_room", "dark_room")}
    tables = {
        "scene": {"rotation": list(rotation)}, "materials": {}, "meshes": {}, "volumes": volumes,
        # `touching`: that walls are given voxels at all must not depend on what far corners happen to see.
        "placement": {"min_voxel": VOXEL, "touching": True},
        "radiosity": {"patch_size": 4.0, "rays": 64, "noise": 1.0},
    }  # fmt: skip
    settings = SceneSettings.model_validate_json(json.dumps(tables), strict=True)
    scene = Scene("two rooms", settings, meshes, (Material("grey", np.full(3, 0.5)),), None, (), "0")
    dark, lit, block = (TurnedBox(*boxes[name][:2], m) for name in ("dark_room", "lit_room", "outside"))
    return TwoRooms(t, m, scene, dark, lit, block, pipeline.bake_surfaces(scene, 0, silent))


def _box(name: str, low: F64, high: F64, inward: bool, matrix: F64) -> Mesh:
    corners = np.array(list(itertools.product((0, 1), repeat=3))) * (high - low) + low
    faces = np.array([(f[0], f[i], f[i + 1]) for f in FACES for i in (1, 2)], dtype=np.int32)
    faces = np.ascontiguousarray(faces[:, ::-1]) if inward else faces
    return Mesh(name, turned(corners, matrix), faces, None, 0, True, True, None, np.zeros(3), False, True)


def all_over(rooms: TwoRooms, seed: int, count: int) -> F64:
    """Positions (count, 3) m all over the dark room, half of them within half a voxel of its walls."""
    random = np.random.default_rng([seed, 23])
    share = random.random((count, 3))
    near = np.arange(count // 2)
    axis, side = random.integers(0, 3, len(near)), random.integers(0, 2, len(near))
    edge = (rooms.dark.upper - rooms.dark.lower)[axis]
    share[near, axis] = side + (1 - 2 * side) * random.random(len(near)) * 0.5 * VOXEL / edge
    return rooms.dark.world(share)


def dark_places(rooms: TwoRooms, field: LightField, seed: int, count: int) -> Places:
    """Places all over the dark room, and just within each corner of each voxel: whatever part of a voxel is behind a wall,
    the part that is furthest behind is near a corner."""
    parts = [all_over(rooms, seed, count)]
    grid = field.octree.grid
    for level, voxels in enumerate(field.octree.voxels):
        offset = INWARDS + (1.0 - 2.0 * INWARDS) * OCTANTS
        parts.append((grid.origin + (voxels[:, None, :] + offset) * grid.size(level)).reshape(-1, 3))
    positions = np.concatenate(parts)
    return places(positions[rooms.dark.inside(positions)], None, "dark")


def leaky_shift(rooms: TwoRooms) -> F64:
    """A shift (3,) of the lattice, in voxels, that puts a probe just outside of the wall that is hardest for voxels, where
    its voxel reaches furthest: into the dark room, if any voxel does."""
    axis = int(np.argmax(rooms.spreads))
    normal = rooms.matrix[:, axis]
    # Where no voxel reaches through: just not in the plane of the wall, for the same reason as below.
    gap = max(VOXEL * rooms.spreads[axis] - rooms.thickness, 0.1)
    # Off the middle, or the lattice would lie exactly in walls: then it is rounding that decides what a probe there sees.
    middle = rooms.dark.lower + OFF_MIDDLE * (rooms.dark.upper - rooms.dark.lower)
    middle[axis] = rooms.dark.lower[axis] - rooms.thickness
    corner = turned(middle, rooms.matrix) - 0.2371 * gap * normal
    low = np.min([m.vertices.min(axis=0) for m in rooms.scene.meshes], axis=0)
    return np.asarray((low - corner) / VOXEL % 1.0)


def edge_corners(rooms: TwoRooms, seed: int, count: int) -> F64:
    """Positions (12 count, 3) m along the twelve edges of the dark room, from 0.001 to 0.3 voxels off them, as many in each octave."""
    random = np.random.default_rng([seed, 41])
    extent, parts = rooms.dark.upper - rooms.dark.lower, []
    for axis in range(3):
        b, c = (k for k in range(3) if k != axis)
        for side_b, side_c in itertools.product((0.0, 1.0), repeat=2):
            share = np.empty((count, 3))
            share[:, axis] = random.random(count)
            off, angle = 10.0 ** random.uniform(-3.0, -0.5, count) * VOXEL, random.random(count) * np.pi / 2
            share[:, b] = np.abs(side_b - off * np.cos(angle) / extent[b])
            share[:, c] = np.abs(side_c - off * np.sin(angle) / extent[c])
            parts.append(share)
    return rooms.dark.world(np.concatenate(parts))


def tip_shift(rooms: TwoRooms, seed: int) -> F64:
    """A shift (3,) of the lattice, in voxels, on which an askew edge pokes into a voxel so little that none of its probes is
    valid, nor copied, and a larger voxel answers that reaches through the wall: of many tried the one that leaks most."""
    random = np.random.default_rng([seed, 43])
    low = np.min([m.vertices.min(axis=0) for m in rooms.scene.meshes], axis=0)
    best, most = random.random(3), -1.0
    for (a, b), sides in itertools.product(((0, 1), (0, 2), (1, 2)), itertools.product((0.0, 1.0), repeat=2)):
        normals = [(1.0 - 2.0 * s) * rooms.matrix[:, k] for s, k in zip(sides, (a, b), strict=True)]
        if not askew(*normals):
            continue
        share = OFF_MIDDLE.copy()
        share[[a, b]] = sides
        into, axis = normals[0] + normals[1], int(np.argmax(normals[0] * normals[1]))
        edge = rooms.dark.world(share[None])[0]
        for _ in range(TIPS_TRIED):
            at = random.random(3) * 2.0
            at[axis] = np.floor(at[axis]) + (1.0 - TIP if into[axis] > 0.0 else TIP)
            shift = ((low - edge) / VOXEL + at) % 2.0
            leak = _tip_leak(rooms, low - shift * VOXEL, edge + 0.3 * TIP * VOXEL * into, most)
            if leak > most:
                best, most = shift, leak
            if most >= 1.0:  # nothing leaks more
                return np.asarray(best)
    return np.asarray(best)


def _tip_leak(rooms: TwoRooms, origin: F64, place: F64, least: float) -> float:
    """Share of light from beyond at a place (3,) m on a lattice from `origin` (3,); 0 where it is no more than `least`, and where the
    place's own voxel answers, or may by a copy."""
    at = (place - origin) / VOXEL
    found = served_by(at[None], LEVELS, lambda c, n: rooms.kind(origin + c * VOXEL * 2.0 ** (LEVELS - n)))
    answers, beyond = int(found.level[0]), float(found.beyond[0])
    return beyond if answers < LEVELS and beyond > least and not _mended(rooms, origin, at, answers) else 0.0


def _mended(rooms: TwoRooms, origin: F64, at: F64, answers: int) -> bool:
    """Whether placement may copy light to a corner of the voxels finer than level `answers` that hold a place `at` (3,), voxels from
    `origin`: if an edge of any level from there has both ends in walls, but passes through the room where `dead_edges` looks."""
    for level in range(answers + 1, LEVELS + 1):
        corner = (np.floor(at * 2.0 ** (level - LEVELS)).astype(np.int64) + OCTANTS) << (LEVELS - level)
        for size in 2 ** np.arange(LEVELS + 1):
            ends = corner[(corner % size == 0).all(axis=1), None]
            walled = rooms.kind((origin + (ends + size * SIX) * VOXEL).reshape(-1, 3)) == IN_WALL
            end, way = np.nonzero(walled.reshape(-1, len(SIX)))
            between = ends[end] + ALONG[:, None] * size * SIX[way, None]
            if rooms.dark.inside((origin + between * VOXEL).reshape(-1, 3)).any():
                return True
    return False
