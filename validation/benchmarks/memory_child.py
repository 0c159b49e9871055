"""Peak memory while form factors are built, in a process of its own: `python -m … NAME PATCH_SIZE RAYS` prints one JSON object.

Peaks are the kernel's high-water mark of resident memory, set back through /proc/self/clear_refs (proc(5)) where that is allowed;
elsewhere it is the mark since the process began, which is never smaller.
"""

from __future__ import annotations

import contextlib
import json
import resource
import sys
from pathlib import Path

from ...reference.progress import silent
from ...reference.transport.form_factors import FormFactors, patch_form_factors
from ...reference.transport.reconcile import reconcile
from .ray_rows import patched

STATUS, CLEAR = Path("/proc/self/status"), Path("/proc/self/clear_refs")
FORGET_PEAK = "5"


def resident(field: str) -> int:
    """VmRSS or VmHWM of this process, bytes; the peak from getrusage (KiB on Linux) where there is no /proc."""
    try:
        line = next(line for line in STATUS.read_text().splitlines() if line.startswith(field))
        return int(line.split()[1]) << 10
    except (OSError, StopIteration):
        return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss << 10


def forget_peak() -> None:
    """Set the high-water mark back to what is resident now."""
    with contextlib.suppress(OSError):
        CLEAR.write_text(FORGET_PEAK)


def matrix_bytes(rows: FormFactors) -> int:
    """All that a finished matrix holds, standard errors included."""
    return rows.bytes + rows.se.nbytes


def measure(name: str, patch_size: float, rays: int) -> dict[str, int]:
    """Bytes: resident before, the peak while tracing and reconciling, and the finished matrix."""
    g, p = patched(name, patch_size)
    forget_peak()
    before = resident("VmRSS")
    laws = reconcile(patch_form_factors(g, p, rays, 1, silent), p.area)
    return {"patches": p.count, "before": before, "peak": resident("VmHWM"), "bytes": matrix_bytes(laws.rows)}


if __name__ == "__main__":
    print(json.dumps(measure(sys.argv[1], float(sys.argv[2]), int(sys.argv[3]))))
