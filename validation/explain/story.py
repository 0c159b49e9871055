"""What `run --waterfall` and `run --explain` add to a scene, computed now or kept from before; both share one bake."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import cache as once
from typing import Any

from ...fastpath.device import OpenDevice
from ...reference.datatypes import Scene
from ...reference.progress import Progress
from .. import cache
from ..report.pictures import SceneView
from ..waterfall.kept import Parts
from ..waterfall.story import with_waterfall
from ..waterfall.world import Made, World, world
from .pixel import explain_pixel
from .request import Dissection, PixelAddress, camera_of


def with_dissection(
    record: Mapping[str, Any], views: Sequence[SceneView], key: str, asked: Dissection, scene: Scene, device: OpenDevice,
    seed: int, progress: Progress, made: Made | None = None,
) -> tuple[dict[str, Any], list[SceneView]]:  # fmt: skip
    """The record and views of a scene with what was asked. key: of the record, all that it depends on. made: the truth and the bake of
    the record, where it was measured just now; without them the scene is baked again where something is not kept.

    Raises InputError for a pixel that the scene does not have or that sees no surface, and as `with_waterfall` does.
    """

    @once
    def baked() -> World:
        return world(scene, device, seed, progress, Parts(key), made)

    found, shown = dict(record), list(views)
    if asked.pixel is not None:
        address = PixelAddress(asked.pixel.x, asked.pixel.y, camera_of(scene, asked.pixel))
        name = cache.key(key, "pixel", address.camera, address.x, address.y)
        kept = cache.load("pixel", name)
        table = explain_pixel(baked(), address, progress) if kept is None else cache.unpack_json(kept["table"])
        if kept is None:
            cache.store("pixel", name, {"table": cache.pack_json(table)})
        found["pixel"] = table
    if asked.waterfall:
        found, shown = with_waterfall(found, shown, key, baked, progress)
    return found, shown
