"""Form factors against closed forms and published values, their standard errors, row sums, repeatability."""

from __future__ import annotations

import math
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest
from lightgauge.reference.progress import silent
from lightgauge.reference.sh import irradiance
from lightgauge.reference.sky import SKY_BINS
from lightgauge.reference.transport import accumulate
from lightgauge.reference.transport import form_factors as ff
from lightgauge.reference.transport.accumulate import Batch, collect_batch, finish_batch, launch_batch
from lightgauge.reference.transport.form_factors import REPLICATES, FormFactors, patch_form_factors, probe_form_factors
from lightgauge.reference.transport.hits import upload_patches
from lightgauge.reference.transport.lumels import build_lumels, lumel_receivers
from lightgauge.reference.transport.patches import Patches
from lightgauge.reference.transport.receivers import (
    Receivers,
    area_receivers,
    element_corners,
    patch_elements,
    patch_receivers,
    point_receivers,
    probe_receivers,
    texel_receivers,
)
from lightgauge.reference.variant import ensure_variant
from lightgauge.reference.visibility import Geometry
from scipy import sparse, stats
from small_scenes import (
    box,
    box_quads,
    material,
    one_patch_each,
    polygon_mesh,
    quad,
    random_units,
    scene,
    sphere_mesh,
    surfaces,
    with_lumels,
)

Array = npt.NDArray[Any]
T95 = float(stats.t.ppf(0.975, REPLICATES - 1))
SEEDS = 200


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


@pytest.mark.parametrize("rays", [16, 128, 4096])
def test_rows_sum_to_one(rays: int) -> None:
    """Hits, sky and absorbed share: nothing is lost, and 1/N is exact in float32."""
    walls = [quad(q, mat=i % 2) for i, q in enumerate(box_quads((0, 0, 0), (1, 2, 1))[:5])]  # open at +z
    crate = box((0.2, 0.2, 0.2), (0.5, 0.5, 0.5), inward=False)
    g, p = surfaces(scene([*walls, crate], [material(), material(two_sided=True)]), 0.4)
    rows = patch_form_factors(g, p, rays, 3, silent)
    assert rows.rows == p.count and (rows.values > 0).all() and (rows.rays == rays).all()
    np.testing.assert_array_equal(rows.matrix().toarray().sum(axis=1), 1.0)
    assert rows.matrix()[:, [p.count + b for b in range(SKY_BINS)]].sum() > 0.1


@pytest.mark.parametrize("rays", [0, 8, 24, 1000])
def test_other_ray_counts_are_refused(rays: int) -> None:
    g, p = surfaces(scene([box((0, 0, 0), (1, 1, 1))]), 0.7)
    with pytest.raises(ValueError, match=f"power of two, at least 16, got {rays}"):
        patch_form_factors(g, p, rays, 1, silent)


def test_each_row_has_its_own_rays() -> None:
    """Rows of mixed counts are those of the same counts for all."""
    g, p = surfaces(scene([box((0, 0, 0), (1, 1, 1))]), 0.4)
    counts = np.array([16, 64, 1024])[np.arange(p.count) % 3]
    mixed = patch_form_factors(g, p, counts, 3, silent)
    np.testing.assert_array_equal(mixed.rays, counts)
    for n in (16, 64, 1024):
        same = patch_form_factors(g, p, n, 3, silent)
        for i in np.flatnonzero(counts == n):
            for name in ("columns", "values", "se"):
                a, b = (getattr(r, name)[r.indptr[i] : r.indptr[i + 1]] for r in (mixed, same))
                np.testing.assert_array_equal(a, b)


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
    assert form_factor(published[case], 1 << 14)[:2] == (0.0, 0.0)


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
    """Within 4 standard errors (under t with 7 degrees of freedom 0.5 % each: with binomial spread as the floor under it far
    less), or the float32 geometry: 31 cases."""
    exact = published[case]["F12"]
    value, se, rays = form_factor(published[case], 1 << 14)
    bound = max(4 * se, 3 * math.sqrt(exact * (1 - exact) / rays))
    assert abs(value - exact) < bound + 2e-5, (value, se, exact)


def emitter_and_receiver(case: dict[str, Any]) -> tuple[Geometry, Patches, Array, Array]:
    """One patch a mesh and normal; the front patches of emitter and receiver."""
    meshes = []
    for part in case["geometry"]:
        assert part["type"] == "mesh", "only meshes here"
        two = part["role"] == "occluder"
        name = part["role"]
        meshes.append(polygon_mesh(part["vertices"], part["faces"], mat=2 if two else len(meshes), name=name))
    g, p = surfaces(scene(meshes, [material(), material(), material(two_sided=True)]), 1e9)
    owner = np.full(p.count, -1)
    owner[p.element_patch] = g.mesh[p.element_triangle]
    front = np.arange(p.count) < p.front
    return g, p, np.flatnonzero((owner == 0) & front), np.flatnonzero((owner == 1) & front)


def form_factor(case: dict[str, Any], rays: int) -> tuple[float, float, int]:
    """Emitter to receiver of a published case, its standard error and the rays behind it."""
    g, p, emitter, receiver = emitter_and_receiver(case)
    rows = patch_form_factors(g, p, rays, 5, silent)
    value = se2 = 0.0
    for i in emitter:
        mine = slice(rows.indptr[i], rows.indptr[i + 1])
        share, wanted = p.area[i] / p.area[emitter].sum(), np.isin(rows.columns[mine], receiver)
        value += share * rows.values[mine][wanted].sum(dtype=np.float64)
        se2 += share**2 * (rows.se[mine][wanted].astype(np.float64) ** 2).sum()
    return float(value), math.sqrt(se2), rays * len(emitter)


# Standard errors


REACHABLE = ("par_unit_gap1", "par_unit_gap0p25", "par_aspect_1to1000_gap1", "par_tiny_to_huge_1e6", "par_overlap_half_gap1e-2",
             "perp_unit_common_edge", "perp_c15_b", "perp_common_corner_only", "perp_edges_gap1e-3", "perp_short_edge_inside_long",
             "wedge_unit_1deg", "wedge_unit_60deg", "wedge_unit_120deg", "wedge_unit_150deg", "pentagon_square_common_edge_ees",
             "corner_tetra_leg_hyp", "needle_triangles_1000", "hexagon_hexagon_h2", "perp_unit_common_edge_rotated",
             "perp_unit_common_edge_scaled_1e4", "clip_receiver_below_apart", "clip_tilted_receiver", "shapiro_F31",
             "occ_view3d_corner_square", "occ_half_plane_edge", "occ_near_receiver_gap1e-3", "occ_double_overlapping_shadows",
             "occ_outside_coplanar_with_emitter", "occ_doorway_between_rooms", "occ_Lroom_S2_S6", "occ_perp_common_edge_with_fin",
             "occ_triangle_oblique_rotated", "occ_cube_in_cube_top_bottom", "boxinbox_inner_top_outer_top")  # fmt: skip


def randomised(case: dict[str, Any], rays: int) -> tuple[Array, Array]:
    """Emitter to receiver under SEEDS independent randomisations: values and standard errors. One call serves them all: the
    receiver's number enters a scramble as the seed does."""
    g, p, emitter, receiver = emitter_and_receiver(case)
    assert len(emitter) == len(receiver) == 1
    element, sign, patch = patch_elements(p)
    mine = np.flatnonzero(patch == emitter[0])
    triangle = p.element_triangle[element[mine]]
    corners = element_corners(g, p.cuts, p.first_element, triangle, element[mine])
    normals, begin = sign[mine, None] * g.normals[triangle], np.arange(SEEDS) * len(mine)
    receivers = area_receivers(
        g, np.tile(corners, (SEEDS, 1, 1)), np.tile(normals, (SEEDS, 1)), begin, begin + len(mine)
    )
    rows = ff.form_factors(g, p, receivers, rays, 11, silent, "copies")
    matrix = sparse.csr_array((rows.se[:, 0], rows.columns, rows.indptr), shape=(SEEDS, rows.patches + SKY_BINS + 1))
    values, se = (m[:, [receiver[0]]].toarray()[:, 0].astype(np.float64) for m in (rows.matrix(), matrix))
    return values, se


def test_intervals_of_published_cases_cover(published: dict[str, Any]) -> None:
    """95 % intervals of 200 randomisations, 34 cases of 4,096 rays with at least four hits expected in each replicate: 6,800 of
    them, so the pooled share has a standard error of 0.3 %; 93 … 97 % are six of it (the aim is 92 … 98). Each case by itself
    within 5 of its own 1.5 %. And the mean of se² is the mean square error: within 11 % over all cases, where ten other sets of
    seeds read 1.011 with a spread of 0.019."""
    shares, ratios = [], []
    for name in REACHABLE:
        exact = published[name]["F12"]
        value, se = randomised(published[name], 4096)
        shares.append((np.abs(value - exact) <= T95 * se + 1e-7).mean())  # 1e-7: of the geometry in float32
        ratios.append((se**2).mean() / ((value - exact) ** 2).mean())
    by_case = dict(zip(REACHABLE, zip(shares, ratios, strict=True), strict=True))
    assert min(shares) > 0.95 - 5 * 0.0154, by_case
    assert 0.93 < np.mean(shares) < 0.97, (np.mean(shares), by_case)
    assert np.mean(ratios) == pytest.approx(1.0, abs=0.11), by_case


def runs(g: Geometry, p: Patches, rows: Array, rays: int) -> Iterator[Batch]:
    """The same rows under SEEDS seeds."""
    device, receivers = upload_patches(g, p), patch_receivers(g, p)
    for seed in range(SEEDS):
        yield finish_batch(collect_batch(launch_batch(g, device, receivers, rows, rays, REPLICATES, seed)))


def test_intervals_of_whole_rows_cover(shared_truth: Path) -> None:
    """Cube in a cube, 16 of 204 rows, 2,048 rays, 200 seeds, exact form factors. Entries with 4 hits or more expected in a
    replicate: 92 … 98 % of their intervals. Those with fewer have se and error in many seeds 0, so no interval; but the mean
    of se² is the mean square error for every entry, found or not, and so for a row: its spread over seeds is within 5 %
    (16 × 200 rows of about 60 entries each: standard error below 1 %)."""
    box_in_box = np.load(shared_truth / "boxinbox_204_truth.npz")
    g, p, number = one_patch_each(box_in_box["quads"])
    exact = np.zeros((p.count, p.count + SKY_BINS + 1))
    exact[np.ix_(number, number)] = box_in_box["F"]
    rows, rays = np.arange(0, p.count, 13), 2048
    covered = intervals = 0
    se2, error2 = np.zeros(len(rows)), np.zeros(len(rows))
    for batch in runs(g, p, rows, rays):
        row = np.repeat(np.arange(len(rows)), batch.lengths)
        value, se = np.zeros((len(rows), exact.shape[1])), np.zeros((len(rows), exact.shape[1]))
        value[row, batch.columns], se[row, batch.columns] = batch.values[:, 0], batch.se[:, 0]
        error = value - exact[rows]
        judged = exact[rows] * rays / REPLICATES >= 4.0
        covered += int((np.abs(error) <= T95 * se)[judged].sum())
        intervals += int(judged.sum())
        se2 += (se**2).sum(axis=1) / SEEDS
        error2 += (error**2).sum(axis=1) / SEEDS
    assert intervals > 40_000 and 0.92 < covered / intervals < 0.98, (intervals, covered / intervals)
    assert se2.sum() / error2.sum() == pytest.approx(1.0, abs=0.05), se2 / error2
    np.testing.assert_allclose(se2 / error2, 1.0, atol=0.2)


def test_row_se_is_the_root_sum_of_squares() -> None:
    g, p = surfaces(scene([box((0, 0, 0), (1, 1, 1))]), 0.5)
    rows = probe_form_factors(g, p, np.full((3, 3), 0.4), 128, 1, silent)
    for i in range(3):
        mine = rows.se[rows.indptr[i] : rows.indptr[i + 1]].astype(np.float64)
        np.testing.assert_allclose(rows.row_se[i], np.sqrt((mine**2).sum(axis=0)), rtol=1e-9)


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


# Repeatability


def all_kinds() -> tuple[Geometry, Patches, dict[str, Receivers]]:
    """A room with a crate, open above, and every kind of receiver in it."""
    walls = [quad(q, mat=1) for i, q in enumerate(box_quads((0, 0, 0), (1, 1, 1))) if i != 3]
    crate = box((0.2, 0.2, 0.2), (0.5, 0.5, 0.5), inward=False, name="crate")
    s = with_lumels(scene([*walls, crate], [material(), material(two_sided=True)]), {"crate": 0.15})
    g, p = surfaces(s, 0.2)
    positions = np.random.default_rng(0).uniform(0.1, 0.9, (33, 3))
    lumels = build_lumels(s, g)
    assert lumels.count > 100
    return g, p, {
        "patches": patch_receivers(g, p),
        "points": point_receivers(g, positions, random_units(33, 4)),
        "probes": probe_receivers(g, positions),
        "texels": texel_receivers(g, positions[:2], 4),
        "lumels": lumel_receivers(g, lumels),
    }  # fmt: skip


def all_rows(g: Geometry, p: Patches, kinds: dict[str, Receivers]) -> dict[str, FormFactors]:
    """Two ray counts in one call, so that batches of both kinds are there."""
    return {
        name: ff.form_factors(g, p, r, np.where(np.arange(r.count) % 3 == 0, 64, 128), 1, silent, name)
        for name, r in kinds.items()
    }


def assert_same(a: dict[str, FormFactors], b: dict[str, FormFactors]) -> None:
    for name in a:
        for field in ("indptr", "columns", "values", "se", "back_share", "rays"):
            np.testing.assert_array_equal(getattr(a[name], field), getattr(b[name], field), err_msg=f"{name} {field}")


def test_batches_get_smaller_to_the_end() -> None:
    """Every row once, in batches no larger than allowed, and little left to sum after the last is traced."""
    counts = np.array([1024, 64])[np.arange(9001) % 2]
    batches = [(rows, n) for rows, n in ff._batches(counts) if rows is not None]
    np.testing.assert_array_equal(np.sort(np.concatenate([rows for rows, _ in batches])), np.arange(9001))
    for rays in (64, 1024):
        sizes = [len(rows) * n for rows, n in batches if n == rays]
        assert all((counts[rows] == rays).all() for rows, n in batches if n == rays)
        assert sizes == sorted(sizes, reverse=True)
        assert sizes[0] <= ff.RAYS_PER_BATCH and sizes[-1] <= ff.RAYS_PER_LAST_BATCH


def test_results_do_not_depend_on_the_batch_size(monkeypatch: pytest.MonkeyPatch) -> None:
    g, p, kinds = all_kinds()
    whole = all_rows(g, p, kinds)
    for size in (1 << 13, 1000, 1):
        monkeypatch.setattr(ff, "RAYS_PER_BATCH", size)
        monkeypatch.setattr(ff, "RAYS_PER_LAST_BATCH", max(1, size // 8))
        monkeypatch.setattr(accumulate, "RAYS_PER_PART", max(1, size // 3))
        some = {name: r for name, r in kinds.items() if size > 1 or name in ("points", "probes")}
        assert_same(all_rows(g, p, some), whole)


def test_results_do_not_depend_on_the_number_of_threads() -> None:
    ensure_variant()
    import drjit as dr

    g, p, kinds = all_kinds()
    before = dr.thread_count()
    found = []
    try:
        for threads in (1, 2, 5):
            dr.set_thread_count(threads)
            assert dr.thread_count() == threads
            found.append(all_rows(g, p, kinds))
    finally:
        dr.set_thread_count(before)
    for other in found[1:]:
        assert_same(found[0], other)


def test_seed_changes_the_result_and_the_same_seed_does_not() -> None:
    g, p = surfaces(scene([box((0, 0, 0), (1, 1, 1))]), 0.3)
    a, b, c = (patch_form_factors(g, p, 256, s, silent).matrix().toarray() for s in (1, 1, 2))
    np.testing.assert_array_equal(a, b)
    assert not np.array_equal(a, c)


def test_probe_in_a_constant_enclosure() -> None:
    """Radiance L everywhere: E = π L for every normal, since Σ_j c_j = ∫Y dω = (√4π, 0, 0, 0). The linear coefficients have no bias
    (means of 64 probes within 4 standard errors, 3 of them: error rate 2e-4), and at most a quarter of the spread √(4π/N) that N
    independent rays would have (it is a twelfth, known to a tenth of itself)."""
    g, p = surfaces(scene([sphere_mesh(1.0, 3)]), 0.3)
    positions = np.random.default_rng(1).uniform(-0.5, 0.5, (64, 3))
    rows = probe_form_factors(g, p, positions, 512, 1, silent)
    sh = np.stack(
        [rows.matrix(k) @ np.full(p.count + SKY_BINS + 1, math.pi) for k in range(4)], axis=1
    )  # B = π L, L = 1
    np.testing.assert_allclose(sh[:, 0], math.sqrt(4 * math.pi), rtol=1e-5)
    spread = sh[:, 1:].std(axis=0, ddof=1)
    assert (np.abs(sh[:, 1:].mean(axis=0)) < 4 * spread / math.sqrt(len(sh))).all(), (sh.mean(axis=0), spread)
    assert (spread < math.sqrt(4 * math.pi / 512) / 4).all(), spread
    for n in random_units(10, 2):
        e = irradiance(np.repeat(sh[:, :, None], 3, axis=2), np.broadcast_to(n, (*sh[:, 0].shape, 3)))
        np.testing.assert_allclose(e.mean(axis=0), math.pi, rtol=5e-3)


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


def test_no_receivers() -> None:
    g, p = surfaces(scene([box((0, 0, 0), (1, 1, 1))]), 0.5)
    rows = probe_form_factors(g, p, np.zeros((0, 3)), 64, 1, silent)
    assert rows.rows == 0 and rows.values.shape == (0, 4)
