"""What `run --waterfall` and `run --explain` ask for, checked before anything is computed."""

from __future__ import annotations

import re
from dataclasses import dataclass

from ...reference.datatypes import Scene
from ...reference.errors import InputError

FORM = "X,Y or CAMERA:X,Y, whole numbers from the picture's upper left corner on, such as 320,200"
WRITTEN = re.compile(r"(?:(?P<camera>.+):)?(?P<x>\d{1,6}),(?P<y>\d{1,6})")


@dataclass(frozen=True)
class PixelAddress:
    """A pixel by column and row; camera: its name, None for the scene's first."""

    x: int
    y: int
    camera: str | None = None


@dataclass(frozen=True)
class Dissection:
    """waterfall: whether the error is taken apart link by link. pixel: the one that is explained, or None."""

    waterfall: bool
    pixel: PixelAddress | None


def dissection(waterfall: bool, explain: str | None) -> Dissection | None:
    """The options --waterfall and --explain; None where neither was given. Raises InputError for what is no pixel."""
    if not waterfall and explain is None:
        return None
    return Dissection(waterfall, None if explain is None else pixel_address(explain))


def pixel_address(text: str) -> PixelAddress:
    """A pixel as it is typed. Raises InputError."""
    found = WRITTEN.fullmatch(text.strip())
    if found is None:
        raise InputError(f"--explain {text}: expected {FORM}")
    return PixelAddress(int(found["x"]), int(found["y"]), found["camera"])


def camera_of(scene: Scene, address: PixelAddress) -> str:
    """Name of the camera whose pixel it is. Raises InputError for one that the scene does not have, or a pixel outside its picture."""
    cameras = scene.settings.cameras
    if not cameras:
        raise InputError(f"scene '{scene.name}', --explain: it has no camera; add a [cameras.NAME]")
    name = next(iter(cameras)) if address.camera is None else address.camera
    if name not in cameras:
        raise InputError(f"scene '{scene.name}', --explain: it has no camera '{name}'; take {', '.join(cameras)}")
    width, height = cameras[name].width, cameras[name].height
    if address.x >= width or address.y >= height:
        raise InputError(
            f"scene '{scene.name}', --explain {address.x},{address.y}: the picture of camera '{name}' has {width} × {height} pixels, "
            f"so X is 0 to {width - 1} and Y 0 to {height - 1} (--set cameras.{name}.width=… makes it larger)"
        )
    return name
