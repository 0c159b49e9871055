"""Hostile input, written to a folder: scenes with a fault, pictures that unpack to gigabytes, a library that tells when it runs."""

from __future__ import annotations

import math
import struct
import subprocess
import zlib
from collections.abc import Sequence
from pathlib import Path

TOML = """[materials.grey]
albedo = [0.5, 0.4, 0.3]
[meshes.wall]
file = "wall.ply"
material = "grey"
[lights.sky]
type = "sky"
radiance = [1, 1, 1]
"""
MEMBER = 1 << 22
SIDE = 65  # corners on a side of the sheet: room for thousands of lies


def sheet(side: int = SIDE) -> tuple[list[tuple[str, ...]], list[tuple[int, ...]]]:
    """A square cut into triangles: corners as text with u and v, faces."""
    at = [i / (side - 1) for i in range(side)]
    corners: list[tuple[str, ...]] = [(repr(x), repr(y), "0", repr(x), repr(y)) for y in at for x in at]
    faces: list[tuple[int, ...]] = []
    for j in range(side - 1):
        for i in range(side - 1):
            a = j * side + i
            faces += [(a, a + 1, a + side + 1), (a, a + side + 1, a + side)]
    return corners, faces


def ply_text(
    corners: Sequence[Sequence[str]], faces: Sequence[Sequence[int]], promised: tuple[int, int] | None = None
) -> str:
    """ASCII PLY. promised: counts of corners and faces in the header, where they shall lie."""
    vertices, triangles = promised or (len(corners), len(faces))
    head = ["ply", "format ascii 1.0", f"element vertex {vertices}", *(f"property float {c}" for c in "xyzuv"),
            f"element face {triangles}", "property list uchar int vertex_indices", "end_header"]  # fmt: skip
    rows = [" ".join(c) for c in corners] + [" ".join(map(str, (len(f), *f))) for f in faces]
    return "\n".join([*head, *rows]) + "\n"


def write_toml(folder: Path, ply: str | None = None, picture: str | None = None, name: str = "scene") -> Path:
    """scene.toml with one sheet under a sky; picture: a file beside it as the sheet's texture."""
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "wall.ply").write_text(ply_text(*sheet(3)) if ply is None else ply, encoding="ascii")
    text = TOML if picture is None else TOML.replace("albedo =", f'texture = "{picture}"\nalbedo =')
    path = folder / f"{name}.toml"
    path.write_text(text, encoding="utf-8")
    return path


def write_xml(folder: Path, body: str) -> Path:
    """A Mitsuba scene with a sky, a rectangle and `body`."""
    folder.mkdir(parents=True, exist_ok=True)
    text = f'<scene version="3.0.0"><emitter type="constant"/><shape type="rectangle" id="floor"/>{body}</scene>'
    (folder / "scene.xml").write_text(text, encoding="utf-8")
    return folder / "scene.xml"


def png_bomb(path: Path, unpacked: int) -> int:
    """A valid black RGB picture whose rows unpack to about so many bytes; returns its pixels.

    One compressed run of zeros is repeated, so that gigabytes are written at once.
    """
    side = max(1, math.isqrt(unpacked // 3))
    total = side * (1 + 3 * side)
    packer = zlib.compressobj(9, zlib.DEFLATED, -15)
    member = packer.compress(bytes(MEMBER)) + packer.flush(zlib.Z_FULL_FLUSH)
    last = zlib.compressobj(9, zlib.DEFLATED, -15)
    rest = last.compress(bytes(total % MEMBER)) + last.flush()
    adler = ((total % 65521) << 16) | 1  # of zeros only
    data = b"\x78\xda" + member * (total // MEMBER) + rest + struct.pack(">I", adler)
    with path.open("wb") as file:
        file.write(b"\x89PNG\r\n\x1a\n")
        for kind, body in (
            (b"IHDR", struct.pack(">IIBBBBB", side, side, 8, 2, 0, 0, 0)),
            (b"IDAT", data),
            (b"IEND", b""),
        ):
            file.write(struct.pack(">I", len(body)) + kind + body + struct.pack(">I", zlib.crc32(kind + body)))
    return side * side


def telltale_library(folder: Path) -> tuple[Path, Path]:
    """A shared library that makes a file when it is loaded; returns both. Raises OSError without a C compiler (set-up installs one)."""
    library, mark = folder / "telltale.so", folder / "ran"
    code = (
        f'#include <stdio.h>\n__attribute__((constructor)) static void run(void) {{ fclose(fopen("{mark}", "w")); }}\n'
    )
    source = folder / "telltale.c"
    source.write_text(code, encoding="utf-8")
    subprocess.run(
        ["cc", "-shared", "-fPIC", "-o", str(library), str(source)], check=True, capture_output=True, timeout=60
    )
    return library, mark
