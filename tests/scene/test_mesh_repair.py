"""What happens to each fault: mended, turned, kept or refused, and always said. Flips go through the real worker."""

from __future__ import annotations

import time
from pathlib import Path

import numpy as np
import pytest
from lightgauge.reference.datatypes import F64, I64, Bool
from lightgauge.reference.errors import InputError
from lightgauge.reference.scene import load_scene
from lightgauge.reference.scene.document import MeshArrays
from lightgauge.reference.scene.mesh_repair import Repaired, repair
from lightgauge.reference.scene.primitives import cube, rectangle, sphere
from lightgauge.reference.scene.repair_process import Limits, WorkerFailed
from scene_files import TOML, ply_of, write_toml

BALL = sphere()
LIMITS = Limits(30.0, 2048)


def no_worker(vertices: F64, faces: I64, limits: Limits) -> Bool:
    raise AssertionError("nothing here needs the worker")


def failing(vertices: F64, faces: I64, limits: Limits) -> Bool:
    raise WorkerFailed("mesh repair failed: pymeshlab is not installed; type this")


def harmless(mesh: MeshArrays, has_front: bool = True) -> Repaired:
    return repair(mesh, "m", has_front, no_worker)


def turned(mesh: MeshArrays, *faces: int) -> MeshArrays:
    out = mesh.faces.copy()
    out[list(faces)] = out[list(faces), ::-1]
    return MeshArrays(mesh.vertices, out, mesh.uvs)


def same_surface(a: MeshArrays, b: MeshArrays) -> bool:
    """The same triangles in the same order and winding, whatever the vertices are called."""
    return bool(np.array_equal(a.vertices[a.faces], b.vertices[b.faces]))


def volume(mesh: MeshArrays) -> float:
    p = mesh.vertices[mesh.faces]
    return float(np.einsum("fc,fc->f", p[:, 0], np.cross(p[:, 1], p[:, 2])).sum() / 6.0)


@pytest.mark.parametrize("size", [1e-4, 1.0, 1e4])
def test_clean_meshes_come_out_as_they_went_in(size: float) -> None:
    ball = MeshArrays(BALL.vertices * size, BALL.faces)
    out = harmless(ball)
    assert out.mesh is ball and out.closed and not out.notes and out.loose == 0
    square = rectangle()
    assert harmless(square).mesh is square and not harmless(square).closed


def test_duplicate_and_flat_faces_go() -> None:
    more = np.vstack([BALL.faces, np.roll(BALL.faces[:2], 1, axis=1), [[0, 0, 1]]]).astype(np.int32)
    out = harmless(MeshArrays(BALL.vertices, more))
    n = len(BALL.faces)
    assert out.closed and same_surface(out.mesh, BALL)
    assert out.notes == (f"m: 2 duplicate faces removed ({n}, {n + 1}), 1 face without area removed ({n + 2})",)


def test_flat_faces_that_join_neighbours_leave_no_gap() -> None:
    """A vertex in the middle of an edge, with a triangle of no area over it: topologically a closed tetrahedron."""
    points = np.array([[0.0, 0, 0], [2, 0, 0], [0, 1, 0], [0, 0, 1], [1, 0, 0]])
    faces = np.array([[0, 2, 4], [4, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3], [0, 4, 1]], np.int32)
    out = harmless(MeshArrays(points, faces))
    assert out.closed and len(out.mesh.faces) == 5 and volume(out.mesh) == pytest.approx(1 / 3)
    assert out.notes == ("m: 1 face without area removed (5)",)
    torn = harmless(MeshArrays(points, faces[:5]))
    assert not torn.closed and torn.notes == ("m: 1 face at a T-junction kept (2)",)


@pytest.mark.parametrize("k", range(1, 13))
def test_slivers(k: int) -> None:
    """1 : 10^k beside a proper triangle: in use, in use and said, or gone and said."""
    points = np.array([[0, 0, 0], [1, 0, 0], [0.5, 0.99 * 10.0**-k, 0], [0, -1, 0]])
    out = harmless(MeshArrays(points, np.array([[0, 1, 2], [1, 0, 3]], np.int32)))
    assert len(out.mesh.faces) == (2 if k < 7 else 1)
    if k < 4:
        assert out.notes == ()
    else:
        assert out.notes == (f"m: 1 face {'thinner than 1 : 10000 kept' if k < 7 else 'without area removed'} (0)",)


def test_duplicate_and_unused_vertices_are_merged() -> None:
    box = cube()
    out = harmless(MeshArrays(np.vstack([[[1e6, 0, 0]], box.vertices]), box.faces + 1))
    assert len(out.mesh.vertices) == 8 and out.loose == 17 and out.closed and same_surface(out.mesh, box)
    assert out.mesh.vertices.max() == 1.0


def test_texture_seams_stay() -> None:
    """Vertices of one place that differ in texture coordinates are two; those that agree are one."""
    square = rectangle()
    assert square.uvs is not None
    soup = MeshArrays(square.vertices[square.faces.ravel()], np.arange(6, dtype=np.int32).reshape(2, 3))
    same = MeshArrays(soup.vertices, soup.faces, square.uvs[square.faces.ravel()])
    out = harmless(same)
    assert len(out.mesh.vertices) == 4 and out.loose == 2 and out.mesh.uvs is not None
    assert np.array_equal(out.mesh.uvs[out.mesh.faces], square.uvs[square.faces])
    uvs = same.uvs.copy() if same.uvs is not None else np.zeros(0)
    uvs[3:] += 0.25
    seam = MeshArrays(soup.vertices, soup.faces, uvs)
    assert harmless(seam).mesh is seam


@pytest.mark.parametrize("inwards", [False, True])
def test_flipped_faces_are_turned(inwards: bool) -> None:
    """The majority decides, so a room stays a room. The answer is the untouched mesh, bit for bit."""
    good = MeshArrays(BALL.vertices, BALL.faces[:, ::-1].copy()) if inwards else BALL
    out = repair(turned(good, 7, 8, 900), "m", True)
    assert out.closed and np.array_equal(out.mesh.faces, good.faces) and out.mesh.vertices is not None
    assert np.array_equal(out.mesh.vertices, good.vertices)
    assert out.notes == ("m: 3 flipped faces turned (7, 8, 900)",)


def test_repair_restores_the_volume() -> None:
    """What one flipped face costs: the closed surface's volume, which a count of edges alone would not show."""
    bad = turned(BALL, 5)
    assert abs(volume(bad) / volume(BALL) - 1.0) > 5e-4
    assert volume(repair(bad, "m", True).mesh) == volume(BALL)


def test_clean_pieces_are_not_sent(tmp_path: Path) -> None:
    """The worker gets the piece with the flip alone, each of its edges with at most two faces."""
    far = MeshArrays(
        np.vstack([BALL.vertices, BALL.vertices + 5.0]), np.vstack([BALL.faces, BALL.faces + len(BALL.vertices)])
    )
    sent: list[int] = []

    def watching(vertices: F64, faces: I64, limits: Limits) -> Bool:
        sent.append(len(faces))
        assert np.allclose(np.linalg.norm(vertices - 5.0, axis=1), np.linalg.norm(BALL.vertices[0]), rtol=1e-6)
        return np.arange(len(faces)) != 3  # the other side of the piece: as good an answer

    out = repair(turned(far, len(BALL.faces) + 3), "m", True, watching)
    assert sent == [len(BALL.faces)] and np.array_equal(out.mesh.faces, far.faces)


def test_worker_that_contradicts_the_edges() -> None:
    def wrong(vertices: F64, faces: I64, limits: Limits) -> Bool:
        return np.arange(len(faces)) == 1

    with pytest.raises(InputError, match="disagree"):
        repair(turned(BALL, 3), "m", True, wrong)


def test_failed_worker_refuses_what_has_a_front() -> None:
    with pytest.raises(InputError) as caught:
        repair(turned(BALL, 7, 8), "scene.toml: meshes.ball", True, failing)
    for word in ("meshes.ball", "2 flipped faces", "(7, 8)", "pymeshlab", "type this", "two_sided"):
        assert word in str(caught.value)


def test_failed_worker_keeps_what_has_none() -> None:
    bad = turned(BALL, 7, 8)
    out = repair(bad, "m", False, failing)
    assert out.mesh is bad and not out.closed
    assert out.notes[0].startswith("m: 2 flipped faces kept, because mesh repair failed") and "(7, 8)" in out.notes[0]


def test_halves_of_one_weight() -> None:
    square = turned(rectangle(), 1)
    with pytest.raises(InputError, match="m: half of the connected triangles 0, 1"):
        harmless(square)
    out = harmless(square, has_front=False)
    assert out.mesh is square and "2 faces that disagree" in out.notes[0]


def finned() -> MeshArrays:
    """A cube with a triangle standing on one of its edges."""
    box = harmless(MeshArrays(cube().vertices, cube().faces)).mesh
    edge = box.faces[0, :2]
    tip = 2.0 * box.vertices[edge].sum(axis=0, keepdims=True)
    return MeshArrays(np.vstack([box.vertices, tip]), np.vstack([box.faces, [[*edge, 8]]]).astype(np.int32))


def test_edges_of_three_faces_are_kept() -> None:
    out = harmless(finned())
    assert same_surface(out.mesh, finned()) and not out.closed
    assert "3 faces at an edge of three or more kept (0, " in out.notes[0] and ", 12)" in out.notes[0]


@pytest.mark.parametrize("face", [0, 5])
def test_flips_beside_such_an_edge_are_turned(face: int) -> None:
    out = repair(turned(finned(), face), "m", True)
    assert same_surface(out.mesh, finned()) and f"1 flipped face turned ({face})" in out.notes[0]


def test_many_faults_in_one_sentence() -> None:
    faces = np.vstack([turned(BALL, 4).faces, BALL.faces[9:10], [[1, 1, 2]]]).astype(np.int32)
    out = repair(MeshArrays(BALL.vertices, faces), "m", True)
    assert out.closed and np.array_equal(out.mesh.faces, BALL.faces)
    n = len(BALL.faces)
    assert out.notes == (
        f"m: 1 duplicate face removed ({n}), 1 face without area removed ({n + 1}), 1 flipped face turned (4)",
    )


def test_load_scene_says_it(tmp_path: Path) -> None:
    ball = turned(BALL, 11)
    path = write_toml(tmp_path, ply=ply_of(np.vstack([ball.vertices, ball.vertices[:1]]), ball.faces))
    scene = load_scene(path)
    assert f"{path}: meshes.wall (wall.ply): 1 flipped face turned (11)" in scene.notes
    assert any(note.startswith(f"{path}: meshes: 1 vertices were there twice or unused") for note in scene.notes)
    assert scene.meshes[0].closed and np.array_equal(scene.meshes[0].faces, BALL.faces)


@pytest.mark.parametrize(("extra", "front"), [("", True), ("two_sided = true\n", False)])
@pytest.mark.parametrize("glows", [False, True])
def test_what_has_a_front(
    tmp_path: Path, extra: str, front: bool, glows: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Emission leaves by the front alone, so a two-sided lamp has one too."""
    monkeypatch.setattr(repair, "__defaults__", (failing,))
    text = TOML.replace("albedo", extra + ("emission = [1, 1, 1]\n" if glows else "") + "albedo")
    path = write_toml(tmp_path, text, ply_of(BALL.vertices, turned(BALL, 2).faces))
    if front or glows:
        with pytest.raises(InputError, match=r"meshes\.wall \(wall\.ply\): 1 flipped face"):
            load_scene(path)
    else:
        assert not load_scene(path).meshes[0].closed


def grid(n: int) -> MeshArrays:
    x, z = (a.ravel() for a in np.meshgrid(np.arange(n + 1.0), np.arange(n + 1.0), indexing="ij"))
    i = (np.arange(n)[:, None] * (n + 1) + np.arange(n)).ravel()
    faces = np.concatenate([np.stack([i, i + 1, i + n + 1], 1), np.stack([i + 1, i + n + 2, i + n + 1], 1)])
    return MeshArrays(np.stack([x, np.sin(0.1 * x) * np.cos(0.07 * z), z], 1), faces.astype(np.int32))


def test_big_meshes_are_judged_fast() -> None:
    """200 k faces: measured at 0.2 s clean and 0.9 s as loose cards (400 k open edges) of processor time."""
    terrain = grid(316)
    corner = np.random.default_rng(1).random((100_000, 1, 3)) * 100.0
    square = np.array([[0.0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]])
    cards = (corner + square).reshape(-1, 3)
    first = 4 * np.arange(100_000)[:, None]
    faces = (first + np.array([0, 1, 2, 0, 2, 3])).reshape(-1, 3).astype(np.int32)
    for mesh, limit in ((terrain, 3.0), (MeshArrays(cards, faces), 6.0)):
        start = time.process_time()
        assert harmless(mesh).mesh is mesh
        assert time.process_time() - start < limit  # a busy machine passes, a loop over faces does not
