"""Peak memory of building form factors against the size of the finished matrices.

    memory_vs_matrices = (peak - 512 MiB) / bytes of the finished rows (pointers, columns, values, standard errors)

0 where that is negative. The peak is of the whole process, Python and all libraries included, while form factors are traced
and reconciled as a bake does it. Tracing needs half of it; the peak comes when rows are reconciled. A first run, which compiles the
kernels, takes 15 MiB more.
"""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Iterator

from ...reference.progress import Progress
from .ray_rows import HOUSE_20K, RAYS
from .rows import CannotMeasure, Group, Row, row_of

ALLOWED = 512 << 20
TIME_LIMIT_S = 300.0
NAMES = ("memory_vs_matrices", "memory_growth_vs_matrices", "memory_growth_mib", "memory_matrices_mib")


def measured(name: str, patch_size: float, rays: int) -> dict[str, int]:
    """`memory_child.measure` in a process of its own. Raises CannotMeasure if that fails."""
    command = [sys.executable, "-m", f"{__package__}.memory_child", name, str(patch_size), str(rays)]
    try:
        done = subprocess.run(command, capture_output=True, text=True, timeout=TIME_LIMIT_S, check=False)
    except subprocess.TimeoutExpired:
        raise CannotMeasure(f"form factors of {name} in a process of their own took over {TIME_LIMIT_S:g} s") from None
    if done.returncode != 0:
        last = (done.stderr.strip().splitlines() or ["no message"])[-1]
        raise CannotMeasure(f"form factors of {name} in a process of their own failed ({done.returncode}): {last}")
    found: dict[str, int] = json.loads(done.stdout.splitlines()[-1])
    return found


def memory(progress: Progress, place: tuple[str, float] = HOUSE_20K, rays: int = RAYS) -> Iterator[Row]:
    """All memory rows, of one build."""
    progress("memory", 0, 1)
    m = measured(*place, rays)
    progress("memory", 1, 1)
    size, growth = m["bytes"], m["peak"] - m["before"]
    note = f"{place[0]}, {m['patches']} patches, {rays} rays per patch"
    whole = f"{note}; the process with its libraries, {m['before'] >> 20} MiB before"
    yield row_of("memory_vs_matrices", max(0.0, (m["peak"] - ALLOWED) / size), "ratio", "lower", 1.5, whole)
    yield row_of("memory_growth_vs_matrices", growth / size, "ratio", "lower", note="nothing subtracted")
    yield row_of("memory_growth_mib", growth / 2**20, "MiB", "lower", note=note)
    yield row_of("memory_matrices_mib", size / 2**20, "MiB", "lower", note=note)


GROUPS = (Group(NAMES, lambda wanted, progress: memory(progress)),)
