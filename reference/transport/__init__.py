"""Patches, form factors, direct light and radiosity."""
