"""Placement efficiency: how many probes a uniform grid needs for the same error."""
