"""G8: what is kept on disk is damaged, or belongs to another scene."""

from __future__ import annotations

import os
import tempfile
import tokenize
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from ...reference.bake_file import read_bake, write_bake
from ...reference.errors import InputError
from ...reference.scene import load_scene
from .. import cache
from ..sources import resolve_scene
from .case import Reading


@contextmanager
def own_cache() -> Iterator[Path]:
    """A cache folder of its own for as long as it lasts."""
    before = os.environ.get("LIGHTGAUGE_CACHE")
    with tempfile.TemporaryDirectory(prefix="lightgauge-") as folder:
        os.environ["LIGHTGAUGE_CACHE"] = folder
        try:
            yield Path(folder)
        finally:
            if before is None:
                del os.environ["LIGHTGAUGE_CACHE"]
            else:
                os.environ["LIGHTGAUGE_CACHE"] = before


TRIALS = 20
HEADER = {"kind": "probe bake", "scene": "s", "scene_hash": "0", "metadata": {}}


def damage(bits: float, seed: int) -> Mapping[str, Reading]:
    """G8: so many bits of kept results and of bakes flipped, at random places; and settings of which one changed."""
    rng = np.random.default_rng([seed, 8])
    arrays = {"light": rng.random((4000, 3)).astype(np.float32), "level": np.arange(4000, dtype=np.int32)}
    kept = baked = plain = wrong = 0
    with own_cache() as folder:
        for _ in range(TRIALS):
            cache.store("truth", "k", arrays)
            flip(folder / "truth" / "k.npz", int(bits), rng)
            kept += cache.load("truth", "k") is not None
            cache.store("truth", "k", arrays)
            again = cache.load("truth", "k") or {}
            wrong += any(name not in again or not np.array_equal(again[name], arrays[name]) for name in arrays)
            said = damaged_bake(folder / "b.bake", arrays, int(bits), rng)
            baked += not said
            wrong += "b.bake" not in said
            np.save(folder / "a.npy", arrays["light"])
            flip(folder / "a.npy", int(bits), rng)
            plain += readable(folder / "a.npy")
    return {
        "damaged results used": Reading(kept, n=TRIALS),
        "damaged bakes used": Reading(baked, n=TRIALS),
        "not rebuilt or not said": Reading(wrong, n=TRIALS),
        "stale results used": Reading(stale(), n=len(CHANGES)),
        "damaged used, without a checksum": Reading(plain, n=TRIALS),
    }


def damaged_bake(path: Path, arrays: Mapping[str, npt.NDArray[Any]], bits: int, rng: np.random.Generator) -> str:
    """What reading a bake with flipped bits is refused with; empty text if it is read."""
    write_bake(path, HEADER, arrays)
    flip(path, bits, rng)
    try:
        read_bake(path)
    except InputError as error:
        return str(error)
    return ""


CHANGES = ({"placement": {"min_voxel": 0.07}}, {"placement": {"probe_rays": 512}}, {"radiosity": {"rays": 512}},
           {"lights": {"lamp": {"radiance": [20.0, 10.0, 2.0]}}}, {"sampling": {"normal_offset": 0.4}},
           {"materials": {"white": {"albedo": [0.7, 0.7, 0.7]}}})  # fmt: skip


def stale() -> int:
    """Changed settings, of CHANGES, whose scene has the hash of the unchanged one."""
    path = resolve_scene("cornell")
    before = load_scene(path).content_hash
    return sum(load_scene(path, change).content_hash == before for change in CHANGES)


def flip(path: Path, bits: int, rng: np.random.Generator) -> None:
    """Turn so many distinct bits of a file."""
    data = np.frombuffer(path.read_bytes(), np.uint8).copy()
    places = rng.choice(8 * len(data), size=min(bits, 8 * len(data)), replace=False)
    np.bitwise_xor.at(data, places // 8, (1 << (places % 8)).astype(np.uint8))
    path.write_bytes(data.tobytes())


def readable(path: Path) -> bool:
    """Whether NumPy reads the file without complaint."""
    try:
        np.load(path, allow_pickle=False)
    except (ValueError, OSError, SyntaxError, EOFError, MemoryError, OverflowError, UnicodeError, tokenize.TokenError):
        return False
    return True
