"""MTL libraries beside OBJ files: Kd, map_Kd, Ke, map_Ke, d and Tr. The rest of the format is gloss, and is passed over."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path

from ..errors import InputError
from .paths import MAX_DOCUMENT_BYTES, read_bytes

# Options that may stand in front of the file name of a map, and how many values each takes at most.
MAP_OPTIONS = {
    "-blendu": 1, "-blendv": 1, "-boost": 1, "-mm": 2, "-o": 3, "-s": 3, "-t": 3, "-texres": 1, "-clamp": 1, "-bm": 1,
    "-imfchan": 1, "-type": 1, "-cc": 1,
}  # fmt: skip


@dataclass
class MtlMaterial:
    """One newmtl. kd, ke: linear RGB. opacity: `d`, or 1 − `Tr`. texture: map_Kd. glow: map_Ke. masked: has a map_d."""

    kd: tuple[float, float, float] | None = None
    ke: tuple[float, float, float] | None = None
    opacity: float = 1.0
    texture: str | None = None
    glow: str | None = None
    masked: bool = False

    @property
    def emission(self) -> list[float]:
        """Radiance, or what map_Ke is multiplied by: Ke, without it 1 under a map and else 0."""
        ke = self.ke or ((0.0, 0.0, 0.0) if self.glow is None else (1.0, 1.0, 1.0))
        return [max(x, 0.0) for x in ke]


def _floats(words: list[str], where: str) -> list[float]:
    try:
        values = [float(w) for w in words]
    except ValueError as error:
        raise InputError(f"{where}: expected numbers, got {' '.join(words)[:60]!r}") from error
    if not values or not all(math.isfinite(v) for v in values):
        raise InputError(f"{where}: expected finite numbers, got {' '.join(words)[:60]!r}")
    return values


def _colour(words: list[str], where: str) -> tuple[float, float, float]:
    values = _floats(words, where)
    return (values[0], values[0], values[0]) if len(values) < 3 else (values[0], values[1], values[2])


def _is_number(word: str) -> bool:
    return word.lstrip("+-").replace(".", "", 1).isdigit()


def map_file(rest: str) -> str:
    """File name of a map line, which may hold spaces, without the options in front of it."""
    words = rest.split()
    while words and words[0] in MAP_OPTIONS:
        option, words = words[0], words[1:]
        for used in range(MAP_OPTIONS[option]):
            if not words or (used and not _is_number(words[0])):
                break
            words = words[1:]
    return " ".join(words)


def _apply(material: MtlMaterial, key: str, rest: str, where: str) -> None:
    words = rest.split()
    if key == "kd":
        material.kd = _colour(words, where)
    elif key == "ke":
        material.ke = _colour(words, where)
    elif key == "d":
        material.opacity = _floats(words[-1:], where)[0]
    elif key == "tr":
        material.opacity = 1.0 - _floats(words[-1:], where)[0]
    elif key == "map_kd":
        material.texture = map_file(rest)
    elif key == "map_ke":
        material.glow = map_file(rest)
    elif key == "map_d":
        material.masked = True


def read_mtl(path: Path, where: str) -> dict[str, MtlMaterial]:
    """Materials of a library by name. Raises InputError naming `where`, the file and the line."""
    materials: dict[str, MtlMaterial] = {}
    current: MtlMaterial | None = None
    text = read_bytes(path, where, MAX_DOCUMENT_BYTES).decode("utf-8", "replace")
    for number, line in enumerate(text.splitlines(), 1):
        words = line.strip().split(None, 1)
        if not words or words[0].startswith("#"):
            continue
        key, rest = words[0].lower(), words[1].strip() if len(words) > 1 else ""
        if key == "newmtl":
            current = materials.setdefault(rest, MtlMaterial())
        elif current is not None:
            _apply(current, key, rest, f"{where}: {path.name} line {number}")
    return materials
