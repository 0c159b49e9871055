"""Form factors against closed forms and published values, row sums, repeatability."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from lightgauge.reference.progress import silent
from lightgauge.reference.sh import irradiance
from lightgauge.reference.sky import SKY_BINS
from lightgauge.reference.transport import form_factors as ff
from lightgauge.reference.transport.form_factors import FormFactors, compress, patch_form_factors, probe_form_factors
from lightgauge.reference.transport.patches import Patches
from lightgauge.reference.visibility import Geometry
from small_scenes import box, box_quads, material, polygon_mesh, quad, random_units, scene, sphere_mesh, surfaces


def between(g: Geometry, p: Patches, rows: FormFactors, meshes: int) -> np.ndarray:
    """Form factors (meshes, meshes) between whole meshes: area-weighted over the emitter's patches."""
    owner = np.zeros(p.count, dtype=int)
    owner[p.element_patch] = g.mesh[p.element_triangle]
    m = rows.matrix().toarray()[:, : p.count]
    out = np.zeros((meshes, meshes))
    for i in range(meshes):
        mine = owner == i
        for j in range(meshes):
            out[i, j] = p.area[mine] @ m[np.ix_(mine, owner == j)].sum(axis=1) / p.area[mine].sum()
    return out


def separate(quads: list[np.ndarray], **more: Any) -> Any:
    return scene([quad(q, mat=i, **more) for i, q in enumerate(quads)], [material(0.5)] * len(quads))


def test_faces_of_a_cube() -> None:
    """failure-catalogue A5. Binomial standard error of 96 × 4,096 rays (an upper bound of ours): 4 of them over 30 pairs:
    error rate 0.2 % at the bound, far less with stratified rays."""
    g, p = surfaces(separate(box_quads((0, 0, 0), (1, 1, 1))), 0.25)
    rows = patch_form_factors(g, p, 4096, 1, silent)
    f = between(g, p, rows, 6)
    n = 4096 * p.count / 6
    se = math.sqrt(0.2 * 0.8 / n)
    for i in range(6):
        for j in range(6):
            exact = 0.0 if i == j else 0.199825 if i // 2 == j // 2 else 0.200044
            assert abs(f[i, j] - exact) < (4 * se if i != j else 1e-15), (i, j, f[i, j], exact)


@pytest.mark.parametrize("rays", [16, 1000, 1024])
def test_rows_sum_to_one(rays: int) -> None:
    """Hits, sky and absorbed share: nothing is lost. Exactly 1 in float32 where 1/N is exact."""
    walls = [quad(q, mat=i % 2) for i, q in enumerate(box_quads((0, 0, 0), (1, 2, 1))[:5])]  # open at +z
    crate = box((0.2, 0.2, 0.2), (0.5, 0.5, 0.5), inward=False)
    g, p = surfaces(scene([*walls, crate], [material(), material(two_sided=True)]), 0.4)
    rows = patch_form_factors(g, p, rays, 3, silent)
    sums = rows.matrix().toarray().sum(axis=1)
    assert rows.rows == p.count and (rows.values > 0).all()
    if rays & (rays - 1) == 0:
        np.testing.assert_array_equal(sums, 1.0)
    np.testing.assert_allclose(sums, 1.0, rtol=1e-6)
    assert rows.matrix()[:, [p.count + b for b in range(SKY_BINS)]].sum() > 0.1


def test_a_closed_room_sees_neither_sky_nor_backs() -> None:
    g, p = surfaces(scene([sphere_mesh(1.0, 3)]), 0.3)
    rows = patch_form_factors(g, p, 1024, 1, silent)
    assert (rows.columns < p.count).all()
    assert not rows.back_share.any()


def test_floor_without_walls_sees_only_sky() -> None:
    g, p = surfaces(scene([quad([[0, 0, 0], [0, 0, 1], [1, 0, 1], [1, 0, 0]])]), 0.3)
    rows = patch_form_factors(g, p, 256, 1, silent)
    assert ((rows.columns >= p.count) & (rows.columns < p.count + SKY_BINS)).all()


@pytest.mark.parametrize(
    "case", ["zero_coplanar_adjacent", "zero_facing_away", "zero_back_to_back_gap1e-3", "zero_below_horizon",
             "zero_fully_occluded_large", "zero_Lroom_S2_S5_fully_occluded"],
)  # fmt: skip
def test_published_zeros_are_exactly_zero(published: dict[str, Any], case: str) -> None:
    assert form_factor(published[case], 1 << 14)[0] == 0.0


@pytest.mark.parametrize(
    "case",
    ["par_unit_gap1", "par_unit_gap0p25", "par_unit_gap1e-6", "par_tiny_to_huge_1e6", "perp_unit_common_edge", "perp_edges_gap1e-3",
     "perp_common_corner_only", "perp_short_edge_inside_long", "wedge_unit_1deg", "wedge_unit_60deg", "wedge_unit_120deg",
     "tri_tri_general_nar6", "pentagon_square_common_edge_ees", "corner_tetra_leg_hyp", "hexagon_hexagon_h2",
     "frame_receiver_with_hole", "perp_unit_common_edge_rotated", "perp_unit_common_edge_scaled_1e4", "clip_receiver_below_apart",
     "clip_tilted_receiver", "occ_view3d_corner_square", "occ_half_plane_edge", "occ_near_receiver_gap1e-3",
     "occ_double_overlapping_shadows", "occ_outside_coplanar_with_emitter", "occ_doorway_between_rooms", "occ_Lroom_S2_S6",
     "occ_perp_common_edge_with_fin", "occ_triangle_oblique_rotated", "occ_cube_in_cube_top_bottom", "boxinbox_inner_top_outer_top"],
)  # fmt: skip
def test_published_form_factors(published: dict[str, Any], case: str) -> None:
    """Within 4 standard errors, binomial or of the float32 geometry: 31 cases, error rate under 0.2 %."""
    exact = published[case]["F12"]
    value, rays = form_factor(published[case], 1 << 14)
    assert abs(value - exact) < 4 * math.sqrt(exact * (1 - exact) / rays) + 2e-5, (value, exact)


def form_factor(case: dict[str, Any], rays: int) -> tuple[float, int]:
    """Emitter to receiver of a published case, and the rays behind it."""
    meshes = []
    for part in case["geometry"]:
        assert part["type"] == "mesh", "only meshes here"
        two = part["role"] == "occluder"
        name = part["role"]
        meshes.append(polygon_mesh(part["vertices"], part["faces"], mat=2 if two else len(meshes), name=name))
    s = scene(meshes, [material(), material(), material(two_sided=True)])
    g, p = surfaces(s, 1e9)
    rows = patch_form_factors(g, p, rays, 5, silent)
    owner = np.full(p.count, -1)
    owner[p.element_patch] = g.mesh[p.element_triangle]
    receiver = np.flatnonzero((owner == 1)[: p.count] & (np.arange(p.count) < p.front))
    emitter = np.flatnonzero((owner == 0) & (np.arange(p.count) < p.front))
    m = rows.matrix().toarray()
    f = m[emitter][:, receiver].sum(axis=1)
    return float(p.area[emitter] @ f / p.area[emitter].sum()), rays * len(emitter)


def test_reciprocity_within_noise() -> None:
    """A_i F_ij = A_j F_ji for patches of unlike size. z of all pairs: mean square under 1.2 (stratified rays: below 1);
    with 500 pairs and independent noise its standard error is 0.06."""
    g, p = surfaces(scene([box((0, 0, 0), (1, 2, 3)), box((0.3, 0.3, 1), (0.6, 0.9, 1.5), inward=False)]), 0.7)
    n = 4096
    f = patch_form_factors(g, p, n, 1, silent).matrix().toarray()[:, : p.count]
    flow = p.area[:, None] * f
    variance = p.area[:, None] ** 2 * f * (1 - f) / n
    pair = np.triu_indices(p.count, 1)
    difference, noise = (flow - flow.T)[pair], (variance + variance.T)[pair]
    enough = (f[pair] > 0.002) & (f.T[pair] > 0.002)
    assert enough.sum() > 300
    z = difference[enough] / np.sqrt(noise[enough])
    assert (z**2).mean() < 1.2
    assert np.abs(difference).sum() / flow.sum() < 0.05


def test_results_do_not_depend_on_the_batch_size(monkeypatch: pytest.MonkeyPatch) -> None:
    g, p = surfaces(scene([box((0, 0, 0), (1, 1, 1))]), 0.2)
    positions = np.random.default_rng(0).uniform(0.1, 0.9, (33, 3))
    results = []
    for size in (1 << 21, 5000, 1):
        monkeypatch.setattr(ff, "RAYS_PER_BATCH", size)
        results.append((patch_form_factors(g, p, 128, 1, silent), probe_form_factors(g, p, positions, 128, 1, silent)))
    for other in results[1:]:
        for a, b in zip(results[0], other, strict=True):
            for field in ("indptr", "columns", "values", "back_share"):
                np.testing.assert_array_equal(getattr(a, field), getattr(b, field), err_msg=field)


def test_seed_changes_the_result_and_the_same_seed_does_not() -> None:
    g, p = surfaces(scene([box((0, 0, 0), (1, 1, 1))]), 0.3)
    a, b, c = (patch_form_factors(g, p, 256, s, silent).matrix().toarray() for s in (1, 1, 2))
    np.testing.assert_array_equal(a, b)
    assert not np.array_equal(a, c)


def test_probe_in_a_constant_enclosure() -> None:
    """Radiance L everywhere: E = π L for every normal, since Σ_j c_j = ∫Y dω = (√4π, 0, 0, 0)."""
    g, p = surfaces(scene([sphere_mesh(1.0, 3)]), 0.3)
    positions = np.random.default_rng(1).uniform(-0.5, 0.5, (20, 3))
    rows = probe_form_factors(g, p, positions, 512, 1, silent)
    sh = np.stack(
        [rows.matrix(k) @ np.full(p.count + SKY_BINS + 1, math.pi) for k in range(4)], axis=1
    )  # B = π L, L = 1
    np.testing.assert_allclose(sh[:, 0], math.sqrt(4 * math.pi), rtol=1e-5)
    for n in random_units(10, 2):
        e = irradiance(np.repeat(sh[:, :, None], 3, axis=2), np.broadcast_to(n, (20, 3)))
        np.testing.assert_allclose(e, math.pi, rtol=0.01)


def test_probe_at_the_middle_of_a_cube_with_one_bright_wall(published: dict[str, Any]) -> None:
    """The published SH coefficients; 64 probes with rotated directions at one place, their mean within 4 standard errors
    (4 coefficients, error rate 3e-4)."""
    case = published["sh_probe_cube_center_one_wall"]
    quads = box_quads((-1, -1, -1), (1, 1, 1))
    g, p = surfaces(separate(quads), 0.5)
    rows = probe_form_factors(g, p, np.zeros((64, 3)), 1024, 1, silent)
    owner = np.zeros(p.count, int)
    owner[p.element_patch] = g.mesh[p.element_triangle]
    names = ["x-", "x+", "y-", "y+", "z-", "z+"]
    values = np.array([case["wall_B"].get(k, 0.0) for k in names])
    light = np.zeros(p.count + SKY_BINS + 1)
    light[: p.count] = values[owner]
    sh = np.stack([rows.matrix(k) @ light for k in range(4)], axis=1)
    se = sh.std(axis=0, ddof=1) / 8
    assert (np.abs(sh.mean(axis=0) - case["L_coeffs"][:4]) < 4 * se + 1e-6).all(), (
        sh.mean(axis=0),
        case["L_coeffs"][:4],
        se,
    )


def test_back_share_tells_inside_from_outside() -> None:
    crate = box((0, 0, 0), (1, 1, 1), inward=False)
    room = box((-2, -2, -2), (3, 3, 3))
    g, p = surfaces(scene([crate, room]), 0.5)
    rows = probe_form_factors(g, p, np.array([[0.5, 0.5, 0.5], [1.5, 0.5, 0.5]]), 256, 1, silent)
    assert rows.back_share.tolist() == [1.0, 0.0]
    assert (rows.columns[: rows.indptr[1]] == p.count + SKY_BINS).all()


def test_compress_against_a_plain_twin() -> None:
    rng = np.random.default_rng(0)
    columns = rng.integers(0, 9, (7, 50)).astype(np.int32)
    weights = rng.random((7, 50, 3)).astype(np.float32)
    lengths, found, values = compress(columns, weights)
    at = 0
    for r in range(7):
        distinct = sorted(set(columns[r].tolist()))
        assert lengths[r] == len(distinct) and found[at : at + len(distinct)].tolist() == distinct
        for c in distinct:
            np.testing.assert_allclose(values[at], weights[r][columns[r] == c].sum(axis=0, dtype=np.float64), rtol=1e-6)
            at += 1
    assert at == len(values)


def test_no_receivers() -> None:
    g, p = surfaces(scene([box((0, 0, 0), (1, 1, 1))]), 0.5)
    rows = probe_form_factors(g, p, np.zeros((0, 3)), 64, 1, silent)
    assert rows.rows == 0 and rows.values.shape == (0, 4)
