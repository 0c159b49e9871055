"""Metrics, gates, charts, reports and the command line."""
