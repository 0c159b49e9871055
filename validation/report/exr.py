"""Pictures as one multi-layer OpenEXR file: truth, ours, error, albedo and depth, for HDRView, tev or a script."""

from __future__ import annotations

import importlib
from pathlib import Path
from typing import Any

import numpy as np

from ...reference.datatypes import F32
from ..record import atomic_path
from .pictures import CameraPictures, relative_error

# The binding has no type information.
OpenEXR: Any = importlib.import_module("OpenEXR")


def layers(pictures: CameraPictures) -> dict[str, F32]:
    """Channel name -> (H, W) f32.

    RGB layers `truth`, `ours` (W·m⁻²) and `albedo`; `error.Y`, signed relative; `depth.Z`, m; `hit.A`, 0 or 1.
    """
    error = relative_error(pictures.truth, pictures.ours, pictures.hit)
    found = {"error.Y": error, "depth.Z": pictures.depth, "hit.A": pictures.hit}
    for name in ("truth", "ours", "albedo"):
        rgb = getattr(pictures, name)
        found |= {f"{name}.{letter}": rgb[..., i] for i, letter in enumerate("RGB")}
    return {name: np.ascontiguousarray(channel, np.float32) for name, channel in sorted(found.items())}


def write_exr(path: Path, pictures: CameraPictures) -> None:
    """Write all layers as float32, losslessly compressed, whole or not at all."""
    header = {
        "compression": OpenEXR.ZIP_COMPRESSION,
        "type": OpenEXR.scanlineimage,
        "comments": f"lightgauge: indirect irradiance, W/m2; truth noise {pictures.truth_noise:.4g} (relative)",
    }
    with atomic_path(path) as temporary:
        OpenEXR.File(header, layers(pictures)).write(str(temporary))


def read_exr(path: Path) -> dict[str, F32]:
    """Channel name -> (H, W) f32, as written by `write_exr`."""
    with OpenEXR.File(str(path), separate_channels=True) as file:
        return {name: np.array(channel.pixels, np.float32) for name, channel in file.channels().items()}
