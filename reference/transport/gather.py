"""Products of form-factor rows with light: a Dr.Jit kernel, one lane per row, that walks the row in order.

No atomics: each row is summed by one lane in the order of its columns, so the result is repeatable bit for bit.
Its plain twin is `FormFactors.matrix(k) @ light`.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from ..datatypes import F32, F64
from ..device_arrays import to_f32, to_u32
from ..variant import ensure_variant
from .form_factors import FormFactors


@dataclass(frozen=True, eq=False)
class DeviceRows:
    """Form-factor rows in device memory. rows R, components K; begin, end (R,), columns (nnz,), values (nnz · K,)."""

    rows: int
    components: int
    begin: Any
    end: Any
    columns: Any
    values: Any


def upload(rows: FormFactors) -> DeviceRows:
    """Put the rows into device memory once; `gather` then only moves light."""
    ensure_variant()

    pointers = rows.indptr.astype(np.uint32)
    return DeviceRows(
        rows.rows,
        rows.values.shape[1],
        to_u32(pointers[:-1]),
        to_u32(pointers[1:]),
        to_u32(rows.columns),
        to_f32(rows.values),
    )


def gather(rows: DeviceRows, light: F64 | F32) -> F32:
    """Sum over columns of value × light: `light` (columns, 3); returns (R, K, 3) f32."""
    import drjit as dr
    import mitsuba as mi

    if rows.rows == 0:
        return np.zeros((0, rows.components, 3), dtype=np.float32)
    k = rows.components
    table = to_f32(light)

    def step(i: Any, *sums: Any) -> tuple[Any, ...]:
        colour = dr.gather(mi.Color3f, table, dr.gather(mi.UInt32, rows.columns, i))
        return (i + 1, *(s + dr.gather(mi.Float, rows.values, i * k + n) * colour for n, s in enumerate(sums)))

    state = (mi.UInt32(rows.begin), *(mi.Color3f(0) for _ in range(k)))
    result = dr.while_loop(state, lambda i, *_: i < rows.end, step)
    dr.eval(result)
    return np.stack([np.array(s).T for s in result[1:]], axis=1).astype(np.float32)
