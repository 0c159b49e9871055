"""Lumels: they cover their mesh once, and gather what patches gather."""

from __future__ import annotations

import math

import numpy as np
import pytest
from lightgauge.reference.config import CubemapSettings
from lightgauge.reference.datatypes import Scene
from lightgauge.reference.pipeline import bake_receivers, bake_surfaces, light_patches
from lightgauge.reference.progress import silent
from lightgauge.reference.sky import SKY_BINS
from lightgauge.reference.transport.form_factors import form_factors, patch_form_factors
from lightgauge.reference.transport.gather import gather, upload
from lightgauge.reference.transport.lumels import build_lumels, lumel_receivers
from lightgauge.reference.visibility import build_geometry
from small_scenes import box, box_quads, material, quad, scene, sphere_mesh, surfaces, with_lumels

SIZES = {"wall": 0.3, "ball": 0.1, "crate": 9.0}


def room(emission: float = 0.0) -> Scene:
    """A room of six walls, one of them with lumels, a ball and a crate with them, and one crate without."""
    walls = [quad(q, name="wall" if i == 0 else f"wall {i}", emission=emission, mat=i) for i, q in
             enumerate(box_quads((-1, -1, -1), (1, 2, 1)))]  # fmt: skip
    ball = sphere_mesh(0.3, 1, inward=False, name="ball", mat=6)
    crates = [
        box((x, 1, 0), (x + 0.3, 1.4, 0.3), inward=False, name=n, mat=6) for x, n in ((-0.5, "crate"), (0.4, "plain"))
    ]
    return with_lumels(scene([*walls, ball, *crates], [material(0.5)] * 7), SIZES)


def test_lumels_cover_their_meshes_once() -> None:
    """Areas by mesh, normals, size of edges; meshes without a size have none."""
    s = room()
    g = build_geometry(s)
    lumels = build_lumels(s, g)
    names = np.array([m.name for m in s.meshes])
    assert set(names[lumels.mesh]) == set(SIZES) and lumels.count == len(lumels.corners) == len(lumels.normals)
    cross = np.cross(lumels.corners[:, 1] - lumels.corners[:, 0], lumels.corners[:, 2] - lumels.corners[:, 0])
    area = 0.5 * np.linalg.norm(cross, axis=1)
    np.testing.assert_allclose(cross, 2.0 * area[:, None] * lumels.normals, atol=1e-12)  # front counter-clockwise
    for name, size in SIZES.items():
        number = int(np.flatnonzero(names == name)[0])
        mine = lumels.mesh == number
        assert area[mine].sum() == pytest.approx(g.areas[g.mesh == number].sum(), rel=1e-12)
        edges = np.linalg.norm(lumels.corners[mine] - np.roll(lumels.corners[mine], 1, axis=1), axis=2)
        assert edges.max() <= size * (1 + 1e-6)
    np.testing.assert_allclose(lumels.centres, lumels.corners.mean(axis=1))
    assert (names[lumels.mesh] == "crate").sum() == 12  # larger than its triangles: they are the lumels


def test_no_lumels() -> None:
    s = scene([box((0, 0, 0), (1, 1, 1))])
    g, p = surfaces(s, 0.5)
    lumels = build_lumels(s, g)
    assert lumels.count == 0 and lumels.centres.shape == (0, 3)
    assert form_factors(g, p, lumel_receivers(g, lumels), 64, 1, silent, "lumels").rows == 0


def test_lumels_of_an_evenly_lit_room_get_the_same() -> None:
    """Every surface sends B = 1: E = 1 W·m⁻² on every lumel, exactly; and they do not see what is behind them."""
    s = room()
    g, p = surfaces(s, 0.4)
    rows = form_factors(g, p, lumel_receivers(g, build_lumels(s, g)), 64, 1, silent, "lumels")
    light = np.concatenate([np.ones(p.count), np.zeros(SKY_BINS + 1)])
    np.testing.assert_array_equal(rows.matrix() @ light, 1.0)
    assert not rows.back_share.any()


def test_the_mean_over_a_mesh_is_that_of_its_patches() -> None:
    """One bright wall: power received by the wall with lumels, by lumels and by patches: 1,024 rays on hundreds each, 1 %."""
    s = room()
    g, p = surfaces(s, 0.3)
    lumels = build_lumels(s, g)
    rows = form_factors(g, p, lumel_receivers(g, lumels), 1024, 1, silent, "lumels")
    light = np.zeros((p.count + SKY_BINS + 1, 3))
    light[: p.count][p.normal[:, 1] < -0.9] = [1.0, 2.0, 0.5]  # the ceiling, and undersides
    on_lumels = gather(upload(rows), light)[:, 0]
    whole = form_factors(g, p, lumel_receivers(g, lumels), 4096, 2, silent, "again")
    np.testing.assert_allclose(gather(upload(whole), light)[:, 0], on_lumels, atol=0.15)
    cross = np.cross(lumels.corners[:, 1] - lumels.corners[:, 0], lumels.corners[:, 2] - lumels.corners[:, 0])
    area = 0.5 * np.linalg.norm(cross, axis=1)
    on_patches = gather(upload(patch_form_factors(g, p, 1024, 3, silent)), light)[:, 0]
    wall = p.normal[:, 0] > 0.99
    at_wall = wall & (np.abs(p.centroid[:, 0] + 1.0) < 1e-9)
    mine = lumels.mesh == 0
    mean = (area[mine] @ on_lumels[mine]) / area[mine].sum()
    np.testing.assert_allclose(mean, (p.area[at_wall] @ on_patches[at_wall]) / p.area[at_wall].sum(), rtol=0.01)


def test_a_bake_keeps_lumels_and_cubemaps() -> None:
    """A furnace: all walls emit E and reflect half, so B = 2 E everywhere: irradiance 2 E on lumels, radiance 2 E/π in cubemaps."""
    s = room(emission=1.0 / math.pi)
    cubemap = CubemapSettings(position=(0.7, 0.7, 0.7), size=4)
    meshes = [m for m in s.meshes if m.name.startswith("wall")]
    settings = s.settings.model_copy(update={"cubemaps": {"hall": cubemap}})
    s = type(s)(s.name, settings, tuple(meshes), s.materials, None, (), "0")
    baked = bake_surfaces(s, 1)
    kept = bake_receivers(s, baked, 1)
    light = light_patches(s, baked, 1).radiosity.light
    np.testing.assert_allclose(light[: baked.patches.count], 2.0, rtol=1e-4)
    assert kept.lumels.count > 40 and kept.lumel_rows.rows == kept.lumels.count
    np.testing.assert_allclose(gather(upload(kept.lumel_rows), light)[:, 0], 2.0, rtol=1e-4)
    assert list(kept.cubemap_rows) == ["hall"] and kept.cubemap_rows["hall"].rows == 6 * 16
    np.testing.assert_allclose(gather(upload(kept.cubemap_rows["hall"]), light)[:, 0], 2.0 / math.pi, rtol=1e-4)
