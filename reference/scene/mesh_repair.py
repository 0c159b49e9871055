"""A mesh as it was read to a mesh that can be used. What is harmless is mended, the rest turned, kept or refused, and said.

| fault | what is done |
|---|---|
| a vertex that stands twice, or that no face uses | merged, removed |
| a face without area, a duplicate face, one that repeats another from behind and fits its neighbours worse | removed |
| a flipped face | turned by the worker; if that fails, refused where the front matters, else kept |
| halves of one piece that disagree and weigh the same | refused where the front matters, else kept |
| an edge of three or more faces, a Möbius strip, a T-junction, a sliver | kept: rays do not mind |

A mesh without faults comes out as it went in, bit for bit.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from ..datatypes import F64, I64, Bool
from ..errors import InputError
from .checks import backed_faces, proportions, refuse_broken, repeated_faces, weld
from .document import MeshArrays
from .mesh_faults import Edges, Winding, edges_of, sheet_of, winding_of
from .repair_process import Limits, WorkerFailed, limits_for, turned_by_worker
from .t_junctions import t_junctions

# Height over longest edge under which a triangle has no area: a sliver of 1 : 10^7 has no stable normal in the single
# precision that ray tracing works in. Slivers under the second are kept, and said.
FLAT, SLIVER = 1e-7, 1e-4
SHOWN = 5
TWO_SIDED = "unless it shines, give its material two_sided = true"

Turner = Callable[[F64, I64, Limits], Bool]


@dataclass(frozen=True, eq=False)
class Repaired:
    """mesh: what to use. closed: watertight with consistent winding. notes: one sentence if anything was found.
    loose: how many vertices stood twice or were used by no face."""

    mesh: MeshArrays
    closed: bool
    notes: tuple[str, ...]
    loose: int


@dataclass(frozen=True, eq=False)
class _Faces:
    """Faces that hold the surface together: those with area, and those without whose three places differ, since
    without them their neighbours would have a gap. number (F,): in the mesh as read. corners (F, 3) places, points
    (P, 3) m of the places, area (F,), flat (F,): without area."""

    number: I64
    corners: I64
    points: F64
    area: F64
    flat: Bool


def repair(mesh: MeshArrays, where: str, has_front: bool, turner: Turner = turned_by_worker) -> Repaired:
    """Diagnose and mend. where: what messages call the mesh. has_front: its two sides are not alike.

    Raises InputError if the mesh is broken or has no area, or if faces are flipped and cannot be turned.
    """
    refuse_broken(mesh, where)
    places = weld(mesh.vertices)
    faces, said = _sift(mesh, places, where)
    edges = edges_of(faces.corners)
    winding = winding_of(edges, faces.area)
    turned = winding.flipped
    if winding.undecided.any() and has_front:
        raise InputError(
            f"{where}: half of the connected triangles {_list(faces.number[winding.undecided])} show their front where "
            f"the others show their back; turn one half or, {TWO_SIDED}"
        )
    if turned[~faces.flat].any():  # those without area go anyway
        turned, sentence = _turn(faces, edges, winding, where, has_front, turner)
        said.append(sentence)
    if turned.any():
        edges = edges_of(_wound(faces.corners, turned))
    said += _kept(faces, edges, winding)
    closed = edges.closed or (faces.flat.any() and edges_of(_wound(faces.corners, turned)[~faces.flat]).closed)
    used = _wound(mesh.faces[faces.number].astype(np.int64), turned)[~faces.flat]
    out, loose = _compact(mesh, used, places)
    return Repaired(out, bool(closed), (f"{where}: {', '.join(said)}",) if said else (), loose)


def _list(numbers: I64) -> str:
    return ", ".join(str(int(n)) for n in numbers[:SHOWN]) + (", …" if len(numbers) > SHOWN else "")


def _counted(numbers: I64, what: str, done: str) -> str:
    """As in `3 duplicate faces removed (4, 7, 9)`."""
    return f"{len(numbers)} {what if len(numbers) == 1 else what.replace('face', 'faces', 1)} {done} ({_list(numbers)})"


def _wound(faces: I64, turned: Bool) -> I64:
    return np.where(turned[:, None], faces[:, ::-1], faces)


def _sift(mesh: MeshArrays, places: I64, where: str) -> tuple[_Faces, list[str]]:
    """Faces worth keeping, and what is said of the others. Raises InputError if there is no area."""
    double_area, longest = proportions(mesh.vertices, mesh.faces)
    flat = double_area <= FLAT * longest
    if flat.all():
        raise InputError(
            f"{where}: the mesh has no area: all {len(flat)} triangles are degenerate; repair or remove it"
        )
    corners = places[mesh.faces]
    joins = (corners != np.roll(corners, 1, axis=1)).all(axis=1)
    repeated = repeated_faces(corners)
    backed = np.zeros(len(flat), dtype=np.bool_)
    alone = np.flatnonzero(~repeated & ~flat)
    backed[alone] = backed_faces(corners[alone])
    said = []
    for found, what in (
        (repeated & ~flat, "duplicate face"),
        (backed, "face that repeats another from behind"),
        (flat, "face without area"),
    ):
        if found.any():
            said.append(_counted(np.flatnonzero(found), what, "removed"))
    repeated |= backed
    sliver = np.flatnonzero((double_area <= SLIVER * longest) & ~flat & ~repeated)
    if len(sliver):
        said.append(_counted(sliver, "face thinner than 1 : 10000", "kept"))
    number = np.flatnonzero(joins & ~repeated)
    points = np.empty((int(places.max()) + 1, 3))
    points[places] = mesh.vertices
    return _Faces(number, corners[number], points, 0.5 * double_area[number], flat[number]), said


def _turn(
    faces: _Faces, edges: Edges, winding: Winding, where: str, has_front: bool, turner: Turner
) -> tuple[Bool, str]:
    """Which faces to turn (F,), and the sentence. The worker's answer must be what the edges say, piece by piece.

    Raises InputError if the worker fails and the front matters.
    """
    numbers = faces.number[winding.flipped & ~faces.flat]
    mine = np.flatnonzero(np.isin(winding.piece, np.unique(winding.piece[winding.flipped])))
    vertices, triangles, owner = sheet_of(faces.corners, faces.points, edges, mine)
    try:
        answer = turner(vertices, triangles, limits_for(len(triangles)))
        # The worker does not know which side of a piece is its front, so it may have turned the others.
        pieces, piece = np.unique(winding.piece[owner], return_inverse=True)
        differ = np.bincount(piece, answer != winding.flipped[owner])
        if np.any((differ != 0) & (differ != np.bincount(piece))):
            raise WorkerFailed(f"mesh repair left neighbours that disagree, in {len(pieces)} pieces")
    except WorkerFailed as error:
        if has_front:
            raise InputError(
                f"{where}: {_counted(numbers, 'flipped face', 'found')}, wound against their neighbours, and {error}; "
                f"turn them in a modelling program or, {TWO_SIDED}"
            ) from error
        return np.zeros(len(faces.number), bool), _counted(numbers, "flipped face", f"kept, because {error}")
    return winding.flipped, _counted(numbers, "flipped face", "turned")


def _kept(faces: _Faces, edges: Edges, winding: Winding) -> list[str]:
    """What is wrong and stays."""
    crowded = edges.count > 2
    found: list[tuple[npt.NDArray[np.integer], str]] = [
        (np.flatnonzero(winding.undecided), "face that disagrees with as many others which side is the front"),
        (np.flatnonzero(winding.twisted), "face of a piece that has no consistent front"),
        (edges.faces_at(crowded), "face at an edge of three or more"),
        (t_junctions(faces.points, edges), "face at a T-junction"),
    ]
    return [_counted(faces.number[numbers], what, "kept") for numbers, what in found if len(numbers)]


def _compact(mesh: MeshArrays, faces: I64, places: I64) -> tuple[MeshArrays, int]:
    """The mesh with these faces (F, 3), each vertex once, and how many vertices stood twice or were not used."""
    lead = _first_of_kind(mesh, places)
    loose = len(places) - int(_marked(lead[mesh.faces], len(places)).sum())
    used = _marked(lead[faces], len(places))
    if used.all() and np.array_equal(faces, mesh.faces):
        return mesh, loose
    renumbered = (np.cumsum(used) - 1)[lead[faces]].astype(np.int32)
    uvs = None if mesh.uvs is None else mesh.uvs[used]
    return MeshArrays(mesh.vertices[used], renumbered, uvs), loose


def _marked(numbers: I64, count: int) -> Bool:
    out = np.zeros(count, bool)
    out[numbers] = True
    return out


def _first_of_kind(mesh: MeshArrays, places: I64) -> I64:
    """(V,) the first vertex with the same place and texture coordinates."""
    kind = places if mesh.uvs is None else weld(np.column_stack([places, mesh.uvs]))
    backwards = np.arange(len(kind))[::-1]
    first = np.empty(len(kind), np.int64)
    first[kind[::-1]] = backwards  # where numbers repeat the last one assigned stays
    return np.asarray(first[kind], np.int64)
