"""Wavefront OBJ: positions, texture coordinates, polygons, material names. Negative indices count back, as the format
says. Normals only tell which side of a face is its front; groups, lines and curves are passed over."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from ..datatypes import F32, F64, I32, I64, Bool
from ..errors import InputError
from .document import MeshArrays
from .paths import MAX_TEXT_BYTES, read_bytes
from .polygons import fan


@dataclass(frozen=True, eq=False)
class ObjFile:
    """vertices (V, 3) f64, uvs (V, 2) f32 or None, faces (F, 3) i32, materials (F,) an index into `names`
    ("" where a face came before any usemtl), libraries: what mtllib names. against_normals: (F,) true where
    the vertex normals point to the other side than the winding."""

    vertices: F64
    uvs: F32 | None
    faces: I32
    materials: I32
    against_normals: Bool
    names: tuple[str, ...]
    libraries: tuple[str, ...]


@dataclass
class _Lines:
    """Lines of a file, sorted by keyword; per face how many v and vt stood before it, and its material."""

    v: list[bytes] = field(default_factory=list)
    vt: list[bytes] = field(default_factory=list)
    vn: list[bytes] = field(default_factory=list)
    f: list[bytes] = field(default_factory=list)
    before: list[tuple[int, int, int, int]] = field(default_factory=list)
    names: dict[str, int] = field(default_factory=dict)
    libraries: list[str] = field(default_factory=list)


def _sort(data: bytes) -> _Lines:
    out = _Lines()
    tables = {b"v": out.v, b"vt": out.vt, b"vn": out.vn}
    current = -1
    for line in data.replace(b"\\\r\n", b" ").replace(b"\\\n", b" ").splitlines():
        words = line.split(None, 1)
        if len(words) < 2:
            continue
        key, rest = words
        if (table := tables.get(key)) is not None:
            table.append(rest)
        elif key == b"f":
            if current < 0:
                current = out.names.setdefault("", len(out.names))
            out.f.append(rest.split(b"#", 1)[0])
            out.before.append((len(out.v), len(out.vt), len(out.vn), current))
        elif key == b"usemtl":
            current = out.names.setdefault(rest.decode("utf-8", "replace").strip(), len(out.names))
        elif key == b"mtllib":
            out.libraries.append(rest.decode("utf-8", "replace").strip())
    return out


def _numbers(lines: list[bytes], least: int, keep: int, what: str, where: str) -> F64:
    """(N, keep) f64 of lines with at least `least` numbers, more are dropped, fewer than `keep` padded with 0."""
    try:
        flat = list(map(float, b" ".join(lines).split()))
        if len(flat) == keep * len(lines):
            return np.array(flat, np.float64).reshape(-1, keep)
    except ValueError:
        pass  # the loop below finds the line
    rows = []
    for number, line in enumerate(lines, 1):
        try:
            row = [float(w) for w in line.split(b"#", 1)[0].split()[:keep]]
            if len(row) < least:
                raise ValueError(f"expected {least} numbers")
        except ValueError as error:
            raise InputError(f"{where}: {what} {number}: cannot read {line[:60]!r}: {error}") from error
        rows.append(row + [0.0] * (keep - len(row)))
    return np.array(rows, np.float64).reshape(-1, keep)


def _corner_indices(corners: list[bytes], where: str) -> I64:
    """(C, 3) position, texture and normal index of every corner as written, 0 where there is none."""
    try:
        if all(c.count(b"/") == 2 for c in corners) and b"//" not in (text := b" ".join(corners)):
            return np.array(list(map(int, text.replace(b"/", b" ").split())), np.int64).reshape(-1, 3)
        parts = [c.split(b"/") for c in corners]
        if max(map(len, parts)) > 3:
            raise ValueError("more than two slashes")
        padded = [(*p, b"", b"")[:3] for p in parts]
        return np.array([[int(a), int(b or 0), int(c or 0)] for a, b, c in padded], np.int64)
    except (ValueError, OverflowError) as error:
        raise InputError(f"{where}: cannot read a face corner ({error}); expected v, v/vt, v//vn or v/vt/vn") from error


def _absolute(index: I64, before: I64, total: int, owner: I64, what: str, where: str, needed: bool = False) -> I64:
    """From 1-based or negative indices to 0-based ones; InputError if one points outside.

    0 stands for none: an error if `needed`, else `total`, one past the end.
    """
    out = np.where(index > 0, index - 1, before + index)
    none = index == 0
    bad = (none & needed) | (~none & ((out < 0) | (out >= total)))
    if np.any(bad):
        k = int(np.argmax(bad))
        raise InputError(
            f"{where}: face {int(owner[k]) + 1}: {what} index {int(index[k])} out of range, "
            f"the file has {total}; repair the mesh"
        )
    return np.where(none, total, out)


def read_obj(path: Path, where: str) -> ObjFile:
    """Read an OBJ file; polygons become fans. Raises InputError naming `where`, the file and the line's number."""
    where = f"{where}: {path.name}"
    lines = _sort(read_bytes(path, where, MAX_TEXT_BYTES))
    if not lines.v or not lines.f:
        raise InputError(f"{where}: the mesh is empty (no vertices or no faces); export it with triangles")
    vertices = _numbers(lines.v, 3, 3, "vertex", where)
    texture = _numbers(lines.vt, 1, 2, "texture coordinate", where)
    normals = _numbers(lines.vn, 3, 3, "normal", where)
    polygons = [line.split() for line in lines.f]
    counts = np.array([len(p) for p in polygons], np.int64)
    if np.any(counts < 3):
        bad = int(np.argmax(counts < 3))
        raise InputError(f"{where}: face {bad + 1} has {int(counts[bad])} corners, at least 3 expected")
    v, t, n = _corner_indices([c for p in polygons for c in p], where).T
    before = np.array(lines.before, np.int64)
    owner = np.repeat(np.arange(len(counts)), counts)
    v = _absolute(v, before[owner, 0], len(vertices), owner, "vertex", where, needed=True)
    t = _absolute(t, before[owner, 1], len(texture), owner, "texture coordinate", where)
    n = _absolute(n, before[owner, 2], len(normals), owner, "normal", where)
    # Corners without a texture index or normal point one past the end: zeros.
    texture, normals = np.vstack([texture, np.zeros((1, 2))]), np.vstack([normals, np.zeros((1, 3))])
    corners, face = fan(counts)
    against = _against(vertices, normals, v[corners], n[corners])
    points, uvs, faces = _merge_corners(vertices, texture, v, t, corners)
    material = before[face, 3].astype(np.int32)
    return ObjFile(points, uvs, faces, material, against, tuple(lines.names), tuple(lines.libraries))


def _against(vertices: F64, normals: F64, v: I64, n: I64) -> Bool:
    """(F,) true where the mean normal of the corners and the winding disagree."""
    with np.errstate(invalid="ignore", over="ignore"):  # broken vertices are refused later, by mesh and number
        p = vertices[v]
        winding = np.cross(p[:, 1] - p[:, 0], p[:, 2] - p[:, 0])
        return np.asarray((winding * normals[n].sum(axis=1)).sum(axis=1) < 0.0, bool)


def _merge_corners(vertices: F64, texture: F64, v: I64, t: I64, corners: I64) -> tuple[F64, F32 | None, I32]:
    """One vertex for each distinct pair of position and texture coordinate."""
    has_uv = bool(np.any(t < len(texture) - 1))
    keys = v * len(texture) + (t if has_uv else 0)
    unique, inverse = np.unique(keys, return_inverse=True)
    uvs = texture[unique % len(texture)].astype(np.float32) if has_uv else None
    return vertices[unique // len(texture)], uvs, inverse.reshape(-1)[corners].astype(np.int32)


def read_obj_points(path: Path, where: str) -> F64:
    """Vertices (V, 3) of an OBJ file, whatever else it holds. Raises InputError naming `where`."""
    where = f"{where}: {path.name}"
    lines = _sort(read_bytes(path, where, MAX_TEXT_BYTES))
    if not lines.v:
        raise InputError(f"{where}: there are no points (no vertices); export it again")
    return _numbers(lines.v, 3, 3, "vertex", where)


def obj_arrays(path: Path, where: str) -> MeshArrays:
    """The whole file as one mesh, whatever materials it names."""
    read = read_obj(path, where)
    return MeshArrays(read.vertices, read.faces, read.uvs)
