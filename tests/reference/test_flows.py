"""Flows between patches against a plain loop, and the way back to rows."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt
import pytest
from lightgauge.reference.sky import SKY_BINS
from lightgauge.reference.transport.flows import flows_of_rays, row_sums, rows_of_flows
from lightgauge.reference.transport.form_factors import FormFactors

Array = npt.NDArray[Any]


def random_rays(patches: int, seed: int) -> tuple[FormFactors, Array]:
    """Rows with gaps on either side of the diagonal, entries on it, sky and absorbed columns, and unlike ray counts."""
    rng = np.random.default_rng(seed)
    columns = []
    for i in range(patches):
        inside = rng.random(patches) < 0.4
        inside[i] = i % 3 == 0
        outside = rng.random(SKY_BINS + 1) < 0.01
        outside[-1] = i % 4 == 1
        columns.append(np.flatnonzero(np.concatenate([inside, outside])))
    lengths = np.array([len(c) for c in columns])
    lengths[-1] = 0  # a row that is empty
    columns[-1] = columns[-1][:0]
    values = rng.random((lengths.sum(), 1)).astype(np.float32)
    se = rng.random((lengths.sum(), 1)).astype(np.float32)
    rays = 2 ** rng.integers(4, 9, patches)
    indptr = np.concatenate([[0], np.cumsum(lengths)])
    back = rng.random(patches)
    flat = np.concatenate(columns).astype(np.int32)
    return FormFactors(indptr, flat, values, patches, back, rays, se), rng.random(patches) + 0.5


@pytest.mark.parametrize("patches", [1, 2, 30])
def test_flows_are_those_of_a_plain_loop(patches: int) -> None:
    raw, area = random_rays(patches, patches)
    flows, defect = flows_of_rays(raw, area)
    f = raw.matrix().toarray().astype(np.float64)
    spread = np.zeros_like(f)
    row = np.repeat(np.arange(patches), np.diff(raw.indptr))
    spread[row, raw.columns] = raw.se[:, 0]
    weight = raw.rays / area
    expected = {}
    different = total = 0.0
    for i in range(patches):
        for j in range(i, patches):
            one, two = area[i] * f[i, j], area[j] * f[j, i]
            total += one if i == j else one + two
            different += abs(one - two) * 2.0
            if one == two == 0.0:
                continue
            if i == j:
                expected[i, j] = (one, one / weight[i], (area[i] * spread[i, i]) ** 2)
                continue
            w = weight[i] + weight[j]
            x = (weight[i] * one + weight[j] * two) / w
            s = (weight[i] * area[i] * spread[i, j]) ** 2 + (weight[j] * area[j] * spread[j, i]) ** 2
            expected[i, j] = (x, x / w, s / w**2)
    assert list(zip(flows.lo.tolist(), flows.hi.tolist(), strict=True)) == sorted(expected)
    x, variance, square = np.array([expected[k] for k in sorted(expected)]).reshape(-1, 3).T
    np.testing.assert_allclose(flows.x, x, rtol=1e-12)
    np.testing.assert_allclose(flows.variance, variance, rtol=1e-7)
    np.testing.assert_allclose(flows.spread, square, rtol=1e-7)
    assert defect == pytest.approx(different / total if total else 0.0, rel=1e-12)
    i, c = np.nonzero(f[:, patches:])
    np.testing.assert_array_equal(flows.out_row, i)
    np.testing.assert_array_equal(flows.out_column, c + patches)
    out = area[i] * f[i, c + patches]
    np.testing.assert_allclose(flows.out_x, out, rtol=1e-12)
    np.testing.assert_allclose(flows.out_variance, out / weight[i], rtol=1e-7)
    np.testing.assert_allclose(flows.out_spread, (area[i] * spread[i, c + patches]) ** 2, rtol=1e-7)


def test_entries_that_are_zero_are_kept() -> None:
    """Rows that were made of flows before hold some, with an error or without, on either side of a pair or on both."""
    values = np.float32([[0.0], [0.5], [0.0], [0.25], [0.0], [0.0]])
    se = np.float32([[0.0], [0.1], [0.2], [0.0], [0.0], [0.0]])
    columns = np.int32([1, 2, 0, 2, 0, 1])
    raw = FormFactors(np.array([0, 2, 4, 6]), columns, values, 3, np.zeros(3), np.full(3, 16), se)
    flows, _ = flows_of_rays(raw, np.ones(3))
    assert flows.lo.tolist() == [0, 0, 1] and flows.hi.tolist() == [1, 2, 2]
    np.testing.assert_allclose(flows.x, [0.0, 0.25, 0.125], atol=1e-30)
    np.testing.assert_allclose(flows.spread, [0.01, 0.0025, 0.0], rtol=1e-6, atol=1e-30)
    rows = rows_of_flows(flows, np.ones(3), raw)
    np.testing.assert_array_equal(
        rows.matrix().toarray()[:, :3], np.float32([[0, 0, 0.25], [0, 0, 0.125], [0.25, 0.125, 0]])
    )


@pytest.mark.parametrize("patches", [1, 2, 30])
def test_rows_are_the_flows_over_the_area(patches: int) -> None:
    raw, area = random_rays(patches, patches + 50)
    flows, _ = flows_of_rays(raw, area)
    dense, spread = np.zeros((patches, patches + SKY_BINS + 1)), np.zeros((patches, patches + SKY_BINS + 1))
    for target, pairs, out in ((dense, flows.x, flows.out_x), (spread, flows.spread, flows.out_spread)):
        target[flows.lo, flows.hi] = target[flows.hi, flows.lo] = pairs
        target[flows.out_row, flows.out_column] = out
    rows = rows_of_flows(flows, area, raw)
    np.testing.assert_allclose(rows.matrix().toarray(), dense / area[:, None], rtol=1e-7)
    se = rows.matrix().astype(np.float64)
    se.data[:] = rows.se[:, 0]
    np.testing.assert_allclose(se.toarray(), np.sqrt(spread) / area[:, None], rtol=2e-7)  # rounded twice
    for i in range(patches):
        mine = rows.columns[rows.indptr[i] : rows.indptr[i + 1]]
        assert (np.diff(mine) > 0).all()  # ascending, none twice
    np.testing.assert_array_equal(rows.rays, raw.rays)
    np.testing.assert_array_equal(rows.back_share, raw.back_share)
    np.testing.assert_allclose(row_sums(flows, patches), dense.sum(axis=1), rtol=1e-12)


def test_reciprocal_rows_pass_unchanged() -> None:
    raw, area = random_rays(20, 3)
    rows = rows_of_flows(flows_of_rays(raw, area)[0], area, raw)
    again, defect = flows_of_rays(rows, area)
    assert defect < 1e-7
    np.testing.assert_allclose(rows_of_flows(again, area, raw).values, rows.values, rtol=1e-6)


def test_negative_flows_are_cut_off_and_held() -> None:
    raw, area = random_rays(10, 4)
    flows, _ = flows_of_rays(raw, area)
    below = flows._replace(
        x=np.where(np.arange(len(flows.x)) == 3, -1.0, flows.x), out_x=flows.out_x - flows.out_x.max()
    )
    cut = below.without_negatives()
    assert cut.x[3] == 0.0 == cut.variance[3] and (cut.x >= 0.0).all() and (cut.out_x == 0.0).all()
    assert not cut.out_variance.any() and (np.delete(cut.variance, 3) > 0.0).all()


def test_no_light_anywhere() -> None:
    """No entry at all: no flows and no defect."""
    none = np.zeros((0, 1), np.float32)
    empty = FormFactors(np.zeros(4, np.int64), np.zeros(0, np.int32), none, 3, np.zeros(3), np.full(3, 16), none)
    flows, defect = flows_of_rays(empty, np.ones(3))
    assert len(flows.x) == len(flows.out_x) == 0 and defect == 0.0
    assert rows_of_flows(flows, np.ones(3), empty).indptr.tolist() == [0, 0, 0, 0]
