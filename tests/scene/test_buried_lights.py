"""Lights inside walls and on surfaces: winding numbers and distances with known answers."""

from __future__ import annotations

import time

import numpy as np
import pytest
from lightgauge.reference.config import PointLight, SpotLight
from lightgauge.reference.datatypes import F64, Material, Mesh
from lightgauge.reference.errors import InputError
from lightgauge.reference.scene.buried_lights import NEAR, refuse_buried, triangle_distance
from lightgauge.reference.scene.document import MeshArrays
from lightgauge.reference.scene.primitives import cube, rectangle, sphere

GREY = Material("grey", np.full(3, 0.5))
BOTH = Material("both", np.full(3, 0.5), two_sided=True)
GLASS = Material("glass", np.zeros(3), passes_light=True)
MATERIALS = (GREY, BOTH, GLASS)


def mesh(
    name: str, arrays: MeshArrays, size: float = 1.0, at: tuple[float, float, float] = (0, 0, 0), *,
    inwards: bool = False, material: Material = GREY, closed: bool = True, static: bool = True,
) -> Mesh:  # fmt: skip
    faces = arrays.faces[:, ::-1] if inwards else arrays.faces
    vertices = arrays.vertices * size + np.array(at)
    number = MATERIALS.index(material)
    return Mesh(name, vertices, faces, None, number, static, True, None, np.zeros(3), False, closed)


def refused(meshes: list[Mesh], position: tuple[float, float, float]) -> str:
    """The message, or nothing."""
    light = PointLight(type="point", position=position, intensity=(1, 1, 1))
    try:
        refuse_buried({"bulb": light}, meshes, MATERIALS, "scene.toml")
    except InputError as error:
        assert str(error).startswith("scene.toml: lights.bulb.position: ") and "move it" in str(error)
        return str(error)
    return ""


def test_solid() -> None:
    ball = mesh("ball", sphere())
    assert "lies inside mesh 'ball'" in refused([ball], (0.3, 0.2, 0.1))
    assert not refused([ball], (0.9, 0.9, 0.9)) and not refused([ball], (5, 0, 0))


def test_room_and_the_wall_around_it() -> None:
    """A shell as two closed pieces of one mesh, or as two meshes: inside the wall only."""
    outer, inner = mesh("outer", cube(), 1.2), mesh("inner", cube(), 1.0, inwards=True)
    joined = MeshArrays(
        np.vstack([outer.vertices, inner.vertices]), np.vstack([outer.faces, inner.faces + len(outer.vertices)])
    )
    for shell in ([outer, inner], [mesh("shell", joined)]):
        assert not refused(shell, (0.0, 0.1, 0.2)) and not refused(shell, (1.3, 0.1, 0.2))
        assert "lies inside mesh" in refused(shell, (1.1, 0.1, 0.2))
    assert not refused([inner], (0.0, 0.1, 0.2)), "a room without a shell"


def test_meshes_that_close_a_surface_together() -> None:
    """Six squares, each a mesh of its own and none closed."""
    box = cube()
    sides = [mesh(f"side{k}", MeshArrays(box.vertices, box.faces[2 * k : 2 * k + 2]), closed=False) for k in range(6)]
    assert "and others" in refused(sides, (0.3, 0.2, 0.1))
    assert not refused(sides[1:], (0.3, 0.2, 0.1)), "open: it has no inside"


def test_what_is_no_wall() -> None:
    inside = (0.3, 0.2, 0.1)
    assert not refused([mesh("bulb", sphere(), material=GLASS)], inside), "a lamp in its glass"
    assert not refused([mesh("ball", sphere(), static=False)], inside), "a mesh that moves away"
    lamp = mesh("lamp", sphere(), material=BOTH, closed=False)
    assert not refused([lamp], inside), "sheets that reflect on both sides, some of which happen to close"
    assert refused([mesh("lamp", sphere(), material=BOTH)], inside), "closed as a mesh: solid, for probes too"


@pytest.mark.parametrize("size", [1e-3, 1.0, 1e4])
def test_on_a_surface(size: float) -> None:
    floor = mesh("floor", rectangle(), size, closed=False)  # in the plane z = 0, 2 × size long
    wall = mesh("wall", rectangle(), size, (0, 0, size), closed=False)
    near = NEAR * 2 * size
    for z, said in ((0.0, True), (0.9 * near, True), (-0.9 * near, True), (1.1 * near, False)):
        assert ("lies on mesh 'floor'" in refused([floor, wall], (0.1 * size, 0.2 * size, z))) == said


def test_spot_lights_too_and_others_not() -> None:
    spot = SpotLight(type="spot", position=(0, 0, 0.1), direction=(0, -1, 0), intensity=(1, 1, 1))
    with pytest.raises(InputError, match=r"lights\.lamp\.position: \[0.0, 0.0, 0.1\]"):
        refuse_buried({"lamp": spot}, [mesh("ball", sphere())], MATERIALS, "x")


def brute_distance(corners: F64, position: F64) -> float:
    """Nearest of many points of the triangle."""
    w = np.random.default_rng(1).dirichlet([0.5, 0.5, 0.5], 200_000)
    return float(np.linalg.norm(w @ corners - position, axis=1).min())


@pytest.mark.parametrize("seed", range(6))
def test_distance_against_sampling(seed: int) -> None:
    rng = np.random.default_rng(seed)
    corners, position = rng.random((3, 3)), 2.0 * rng.random(3) - 0.5
    exact = triangle_distance(corners[None], position)[0]
    assert exact <= brute_distance(corners, position) + 1e-12
    assert exact == pytest.approx(brute_distance(corners, position), rel=2e-2, abs=2e-3)


def test_large_scenes() -> None:
    """131 k triangles, 20 lights: measured at 1 s of processor time."""
    ball = sphere()
    balls = [mesh(f"b{k}", ball, 1.0, (3.0 * k, 0, 0)) for k in range(64)]
    lights = {f"l{k}": PointLight(type="point", position=(3.0 * k + 1.5, 0, 0), intensity=(1, 1, 1)) for k in range(20)}
    start = time.process_time()
    refuse_buried(lights, balls, MATERIALS, "x")
    assert time.process_time() - start < 6.0
    assert "'b31'" in refused(balls, (93.0, 0.1, 0.0))
