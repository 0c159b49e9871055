"""What `run --waterfall` adds to a scene: the table in its record, two metrics, and a picture per link for its cameras."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Mapping, Sequence
from typing import Any

from ...reference.progress import Progress
from .. import cache
from ..report.pictures import SceneView
from .kept import Parts
from .measured import measured
from .pictures import link_pictures, packed, unpacked
from .record import waterfall_metrics, waterfall_table
from .world import World


def with_waterfall(
    record: Mapping[str, Any], views: Sequence[SceneView], key: str, world: Callable[[], World], progress: Progress
) -> tuple[dict[str, Any], list[SceneView]]:
    """The record and the views of a scene with its waterfall. key: of the record, all that it depends on; world: bakes it, called only
    where the waterfall is not kept from before. A waterfall that was stopped goes on from the parts that were finished.

    Raises InputError as `measured` does.
    """
    name = cache.key(key, "waterfall")
    kept = cache.load("waterfall", name)
    if kept is None:
        parts = Parts(key)
        made = world()
        table, pictures = waterfall_table(made, measured(made, progress, parts)), link_pictures(made, progress, parts)
        cache.store("waterfall", name, {"table": cache.pack_json(table), **packed(pictures)})
    else:
        table, pictures = cache.unpack_json(kept["table"]), unpacked(kept)
    shown = [dataclasses.replace(v, links=pictures.get(v.pictures.camera)) for v in views]
    metrics = {**record["metrics"], **waterfall_metrics(table, record["metrics"])}
    return {**record, "waterfall": table, "metrics": metrics}, shown
