"""Sampling statistics: standard errors, tests that find bias, tests that accept equality, and how many samples a decision needs."""
