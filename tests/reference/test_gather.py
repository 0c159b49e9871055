"""The Dr.Jit gather against its plain twin, SciPy's CSR product."""

from __future__ import annotations

import numpy as np
import pytest
from lightgauge.reference.sky import SKY_BINS
from lightgauge.reference.transport.form_factors import FormFactors
from lightgauge.reference.transport.gather import gather, upload


def random_rows(rows: int, patches: int, k: int, seed: int) -> FormFactors:
    """Rows of very unlike length, some empty."""
    rng = np.random.default_rng(seed)
    lengths = rng.integers(0, 40, rows)
    lengths[::5] = 0
    lengths[-1] = patches + SKY_BINS + 1
    columns = np.concatenate([np.sort(rng.choice(patches + SKY_BINS + 1, n, replace=False)) for n in lengths])
    values = (rng.random((len(columns), k)) - 0.3).astype(np.float32)
    indptr = np.concatenate([[0], np.cumsum(lengths)]).astype(np.int64)
    return FormFactors(
        indptr, columns.astype(np.int32), values, patches, np.zeros(rows), np.full(rows, 64), np.zeros_like(values)
    )


@pytest.mark.parametrize("k", [1, 4])
@pytest.mark.parametrize("rows", [1, 7, 1000])
def test_equals_the_csr_product(rows: int, k: int) -> None:
    made = random_rows(rows, 300, k, rows + k)
    light = np.random.default_rng(3).random((300 + SKY_BINS + 1, 3))
    got = gather(upload(made), light)
    assert got.shape == (rows, k, 3) and got.dtype == np.float32
    for n in range(k):
        np.testing.assert_allclose(got[:, n], made.matrix(n).astype(np.float64) @ light, rtol=2e-5, atol=2e-5)


def test_repeats_bit_for_bit() -> None:
    rows = upload(random_rows(500, 200, 4, 9))
    light = np.random.default_rng(4).random((200 + SKY_BINS + 1, 3))
    first = gather(rows, light)
    for _ in range(5):
        np.testing.assert_array_equal(gather(rows, light), first)


def test_no_rows() -> None:
    none = np.zeros((0, 4), np.float32)
    empty = FormFactors(np.zeros(1, np.int64), np.zeros(0, np.int32), none, 5, np.zeros(0), np.zeros(0, np.int64), none)
    assert gather(upload(empty), np.zeros((5 + SKY_BINS + 1, 3))).shape == (0, 4, 3)
