"""Owen-scrambled Sobol points on the device: one table of raw points for everybody, one scramble per receiver.

Raw points: Joe and Kuo 2008, "Constructing Sobol sequences with better two-dimensional projections" (direction numbers
of the first four dimensions, in natural binary order). Scrambling: the hash of Laine and Karras 2011, "Stratified
sampling for stochastic transparency", in the form of Burley 2020, "Practical hash-based Owen scrambling", section 4:
every seed keeps each elementary interval's share exactly, and two seeds are independent randomisations.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np

from .datatypes import U32
from .device_arrays import to_u32
from .variant import ensure_variant

DIMENSIONS = 4
BITS = 32
_GOLDEN = 0x9E3779B9
_PER_DIMENSION = (0x2C1B3C6D, 0x297A2D39, 0x7FEB352D, 0x846CA68B)
# (coefficients of the primitive polynomial, first direction integers m_k) of dimensions 2, 3, 4.
_POLYNOMIALS = (((0, 1), (1,)), ((1, 2), (1, 3)), ((1, 3), (1, 3, 1)))


@dataclass(frozen=True, eq=False)
class SobolTable:
    """count: points. reversed_bits: flat mi.UInt32 (count · DIMENSIONS,), raw points with their bits reversed. (A point's
    dimensions side by side: one load for them all.)"""

    count: int
    reversed_bits: Any


@cache
def direction_numbers() -> U32:
    """Direction numbers (DIMENSIONS, BITS) u32, most significant bit first. Read-only."""
    v = np.zeros((DIMENSIONS, BITS), dtype=np.uint64)
    v[0] = [1 << (BITS - 1 - k) for k in range(BITS)]
    for d, ((a, degree), m) in enumerate(_POLYNOMIALS, start=1):
        for k in range(BITS):
            if k < degree:
                v[d, k] = m[k] << (BITS - 1 - k)
                continue
            value = int(v[d, k - degree]) ^ (int(v[d, k - degree]) >> degree)
            for j in range(1, degree):
                if (a >> (degree - 1 - j)) & 1:
                    value ^= int(v[d, k - j])
            v[d, k] = value
    made = v.astype(np.uint32)
    made.flags.writeable = False
    return made


def sobol_points(count: int) -> U32:
    """First `count` raw Sobol points, (count, DIMENSIONS) u32, 2^-32 to the unit, in binary (not Gray-code) order."""
    v, points = direction_numbers(), np.zeros((count, DIMENSIONS), dtype=np.uint32)
    for bit in range(
        max(0, count - 1).bit_length()
    ):  # the next 2^bit points are the first ones, this bit's numbers added
        have = 1 << bit
        points[have : 2 * have] = points[: min(have, count - have)] ^ v[:, bit]
    return points


def sobol_table(count: int) -> SobolTable:
    """Raw points on the device. count: a power of two, so that every scramble of it is a digital net."""
    if count < 1 or count & (count - 1):
        raise ValueError(f"count must be a power of two, got {count}")
    ensure_variant()
    import drjit as dr

    table = dr.brev(to_u32(sobol_points(count)))
    dr.eval(table)
    return SobolTable(count, table)


def scrambled(table: SobolTable, index: Any, seed: Any, dimension: int) -> Any:
    """Coordinate `dimension` of points `index` under the Owen scramble `seed` (both mi.UInt32): mi.Float in [0, 1)."""
    import drjit as dr
    import mitsuba as mi

    x = dr.gather(mi.Vector4u, table.reversed_bits, index)[
        dimension
    ]  # Dr.Jit loads it once, however often it is asked for
    # One well-mixed seed serves all dimensions. Its low bits decide the coarsest cells, and an odd multiplier alone leaves the
    # lowest as it is, the same in every dimension: the shift brings down high bits, which depend on the multiplier.
    own = seed * _PER_DIMENSION[dimension]
    x = laine_karras(x, (own ^ (own >> 15)) * 0xD35A2D97)
    return mi.Float(dr.brev(x) >> 8) * (1.0 / (1 << 24))


def laine_karras(x: Any, seed: Any) -> Any:
    """Random permutation of u32 in which each bit depends only on lower ones (Burley 2020, listing 2, better constants of
    Vegdahl 2021, "Building a better LK hash"). Works on mi.UInt32 and on NumPy arrays of u32."""
    x = x ^ (x * 0x3D20ADEA)
    x = x + seed
    x = x * ((seed >> 16) | 1)
    x = x ^ (x * 0x05526C56)
    return x ^ (x * 0x53A22864)


def mixed(x: Any) -> Any:
    """Well-mixed u32 of a u32 (Wellons 2018, "Prospecting for hash functions", lowbias32). mi.UInt32 or NumPy u32."""
    x = x ^ (x >> 16)
    x = x * 0x21F0AAAD
    x = x ^ (x >> 15)
    x = x * 0xD35A2D97
    return x ^ (x >> 15)


def receiver_seeds(receivers: Any, replicate: Any, seed: int) -> Any:
    """Scramble seed of each lane: a function of receiver number, replicate number (mi.UInt32 or NumPy u32) and run."""
    return mixed(mixed(receivers + (seed * _GOLDEN & 0xFFFFFFFF)) ^ (replicate * 0x85EBCA6B + 0x68E31DA4))
