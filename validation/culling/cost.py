"""What culling saves, as results.json counts it among the costs."""

from __future__ import annotations

from ...reference import pipeline


def culled_cost(culled: pipeline.Culled, virtual: int) -> dict[str, float]:
    """Counts of probes and bytes; virtual: all virtual probes, culled ones among them."""
    return {
        "culled_probes": culled.probes,
        "cullable_probes": culled.able,
        "subdivision_virtual_probes": virtual - culled.probes,
        "culled_bytes": culled.bytes,
        "cull_threshold": culled.threshold,
    }
