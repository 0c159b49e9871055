"""Who is to blame for a patch that culling makes worse, and what is given back for it."""

from __future__ import annotations

import numpy as np
import pytest
from lightgauge.reference.datatypes import Bool
from lightgauge.reference.placement.culling import Candidates, Choice, choose, mended, replaced
from lightgauge.reference.placement.judge import Blame, Judge, Stage
from lightgauge.reference.placement.mending import given_back
from lightgauge.reference.placement.norms import NORMS
from lightgauge.reference.sh import irradiance_weights
from scipy import sparse

COARSE, PROBES, COLUMNS, POINTS = 8, 60, 80, 400
TARGET = 0.02


def stage(seed: int, rows: np.ndarray) -> Stage:
    """Points that read eight probes each; light that they gather themselves is what the probes say, and some more. rows (R, C, 4)."""
    rng = np.random.default_rng(seed)
    count = len(rows)
    reading = np.zeros((POINTS, count))
    for point in reading:
        point[rng.choice(count, 8, replace=False)] = 1.0 / 8.0
    normals = rng.normal(size=(POINTS, 3))
    weights = irradiance_weights(normals / np.linalg.norm(normals, axis=1)[:, None])
    read = np.einsum("pk,pr,rck->pc", weights, reading, rows)
    truth = read * (1.0 + 0.3 * rng.normal(size=read.shape))
    halves = [sparse.csr_array(truth * (1.0 + 0.02 * rng.normal(size=truth.shape))) for _ in range(2)]
    factors = sparse.csr_array(np.concatenate([rows[:, :, k] for k in range(4)]).astype(np.float32))
    return Stage(
        sparse.csr_array(reading), weights, factors, (halves[0], halves[1]), rng.random((COLUMNS, 6)), np.ones(COLUMNS),
        np.arange(COLUMNS) // 4,
    )  # fmt: skip


@pytest.fixture(scope="module")
def made() -> tuple[Candidates, tuple[Judge, Judge]]:
    """Probes that are nearly the mean of two coarse ones, but that every fifth sees one patch that those do not."""
    rng = np.random.default_rng(5)
    coarse = rng.random((COARSE, COLUMNS, 4)) * [1.0, 0.2, 0.2, 0.2] + [0.2, 0, 0, 0]
    parents = np.zeros((PROBES, PROBES))
    for row in parents[COARSE:]:
        row[rng.choice(COARSE, 2, replace=False)] = 0.5
    rows = np.concatenate([coarse, np.zeros((PROBES - COARSE, COLUMNS, 4))])
    rows[COARSE:] = np.einsum("ij,jck->ick", parents, rows)[COARSE:] * (
        1.0 + 0.02 * rng.normal(size=(PROBES - COARSE, COLUMNS, 1))
    )
    for number in range(COARSE, PROBES, 5):
        rows[number, rng.integers(COLUMNS)] += [3.0, 0.5, 0.0, 0.5]
    able = np.arange(PROBES) >= COARSE
    judges = Judge(stage(1, rows)), Judge(stage(2, rows))
    entries = sparse.csr_array(rows.reshape(PROBES, -1).astype(np.float32))
    level = np.where(able, 2, 1).astype(np.int32)
    weights = 1.0 / judges[0].square
    c = Candidates(
        level, able, sparse.csr_array(parents), NORMS["relative"], entries, None, weights, np.full(PROBES, 1.0 / PROBES)
    )
    return c, judges


def test_parts_add_up_to_what_the_error_grows_by(made: tuple[Candidates, tuple[Judge, Judge]]) -> None:
    """By brute force from dense matrices: every probe's part, and their sum, under each patch that is over."""
    c, (judge, _) = made
    mix, culled = replaced(c, c.able)
    blame = judge.blame(mix, TARGET)
    assert len(blame.excess) > 3
    np.testing.assert_allclose(blame.parts.sum(axis=0), 1.0 + blame.excess, rtol=2e-3)
    assert not blame.parts.toarray()[~culled].any(), "who stays is not to blame"


def test_the_guiltiest_are_given_back_and_no_more() -> None:
    parts = np.array([[2.0, 0.0], [0.7, 0.9], [-0.5, 0.1], [0.3, 0.4], [0.2, 0.9]])
    culled = np.array([True, True, True, True, False])
    back = given_back(Blame(np.array([2.5, 0.6]), sparse.csc_array(parts)), culled)
    # The first patch needs 2.5: 2.0 and 0.7. The second needs 0.6, and 0.9 of it is back already.
    assert back.tolist() == [True, True, False, False, False]
    little = given_back(Blame(np.array([0.1, 0.3]), sparse.csc_array(parts)), culled)
    assert little.tolist() == [False, True, False, False, False], "the second patch is worse, and its probe serves both"


def test_mending_leaves_no_patch_over_and_takes_back_few(made: tuple[Candidates, tuple[Judge, Judge]]) -> None:
    c, (judge, _) = made
    before, everything = replaced(c, c.able)
    kept: Bool = mended(c, c.able, np.inf, judge, TARGET)
    after = judge(replaced(c, kept)[0], TARGET).over
    assert judge(before, TARGET).over > 0.05 and after < 0.1 * judge(before, TARGET).over
    guilty = np.zeros(PROBES, dtype=np.bool_)
    guilty[COARSE::5] = True
    assert kept[~guilty & c.able].mean() > 0.8 > 0.4 > kept[guilty].mean()
    assert not (kept & ~everything).any()


def test_the_second_judge_has_the_last_word(made: tuple[Candidates, tuple[Judge, Judge]]) -> None:
    """What is chosen passes both; more goes than by the threshold alone; where nobody may go, nobody goes."""
    c, judges = made
    found = choose(c, judges[0], lambda: judges[1], TARGET)
    mix = replaced(c, found.culled)[0]
    assert found.culled.sum() > 10 and found.verdict.over <= 0.02
    assert all(judge(mix, TARGET).over <= 0.02 for judge in judges)
    final = judges[1](mix, TARGET)
    assert (found.verdict.worst, found.verdict.own) == (final.worst, final.own), (
        "about what goes, after the last mending"
    )
    assert found.verdict.over >= final.over, "but for what that mending itself took to nothing"


def test_nobody_checks_where_there_is_no_choice(made: tuple[Candidates, tuple[Judge, Judge]]) -> None:
    """Where nobody may go, nobody goes, and the second judge, who traces rays, is not made."""

    def check() -> Judge:
        raise AssertionError("nothing to check")

    nothing: Choice = choose(made[0], made[1][0], check, 1e-9)
    assert not nothing.culled.any() and nothing.verdict.over == 0.0
