"""How far chance may take a random quantity from its expectation, at a stated error rate.

"Within 4 standard errors" means one failure in 16,000 for a normal quantity of known spread. Standard errors from few runs are
themselves random: with 8 of them 4 are exceeded once in 190, and with several values in a test more often still.
"""

from __future__ import annotations

from scipy import stats

RATE = 1e-4  # of a test: a hundred of them under 50 seeds fail by chance with one half


def standard_errors(runs: int, values: int = 1) -> float:
    """Of how many standard errors, estimated from `runs` independent runs, the largest of `values` deviations stays under with a
    probability of 1 - RATE (Student's t, Bonferroni's correction)."""
    return float(stats.t.isf(RATE / (2.0 * values), runs - 1))
