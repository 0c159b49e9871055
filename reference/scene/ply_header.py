"""The header of a PLY file: byte order, and which tables with which columns follow."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

from ..errors import InputError

MAX_HEADER_BYTES = 1 << 16
MAX_ROWS = 64_000_000
TYPES = {
    "char": "i1", "int8": "i1", "uchar": "u1", "uint8": "u1", "short": "i2", "int16": "i2", "ushort": "u2",
    "uint16": "u2", "int": "i4", "int32": "i4", "uint": "u4", "uint32": "u4", "float": "f4", "float32": "f4",
    "double": "f8", "float64": "f8",
}  # fmt: skip


class Property(NamedTuple):
    """One column. length: type of the number in front of a list, or None for a single value."""

    name: str
    item: str
    length: str | None


@dataclass(frozen=True)
class Element:
    """One table of the file."""

    name: str
    rows: int
    properties: tuple[Property, ...]

    @property
    def has_lists(self) -> bool:
        return any(p.length for p in self.properties)


def _property(words: list[str], where: str) -> Property:
    if len(words) == 5 and words[1] == "list" and words[2] in TYPES and words[3] in TYPES:
        if TYPES[words[2]][0] == "f":
            raise InputError(f"{where}: the length of list {words[4]!r} must be an integer type, got {words[2]}")
        return Property(words[4], TYPES[words[3]], TYPES[words[2]])
    if len(words) == 3 and words[1] in TYPES:
        return Property(words[2], TYPES[words[1]], None)
    raise InputError(f"{where}: cannot read PLY header line {' '.join(words)[:80]!r}")


def _rows(word: str, where: str) -> int:
    rows = int(word) if word.isascii() and word.isdigit() and len(word) < 12 else -1
    if not 0 <= rows <= MAX_ROWS:
        raise InputError(f"{where}: a PLY element needs 0 to {MAX_ROWS} rows, got {word[:40]!r}")
    return rows


def read_header(data: bytes, where: str) -> tuple[str, list[Element], int]:
    """Byte order ('ascii', '<' or '>'), elements, and where the data starts."""
    end = data.find(b"end_header", 0, MAX_HEADER_BYTES)
    stop = data.find(b"\n", end) + 1 if end >= 0 else 0
    if not data.startswith(b"ply") or stop == 0:
        raise InputError(f"{where}: not a PLY file (no 'ply' … 'end_header'); export it again as PLY")
    order, elements = "", list[Element]()
    for line in data[:end].decode("latin-1").splitlines()[1:]:
        words = line.split()
        if not words or words[0] in ("comment", "obj_info"):
            continue
        if words[0] == "format" and len(words) == 3:
            order = {"ascii": "ascii", "binary_little_endian": "<", "binary_big_endian": ">"}.get(words[1], "")
        elif words[0] == "element" and len(words) == 3:
            elements.append(Element(words[1], _rows(words[2], where), ()))
        elif words[0] == "property" and elements:
            last = elements[-1]
            elements[-1] = Element(last.name, last.rows, (*last.properties, _property(words, where)))
        else:
            raise InputError(f"{where}: cannot read PLY header line {line[:80]!r}")
    if not order:
        raise InputError(f"{where}: PLY format must be ascii, binary_little_endian or binary_big_endian")
    return order, elements, stop
