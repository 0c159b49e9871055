"""Relighting against what the memory can do, and against SciPy's CSR product on the same matrices.

    relight_bandwidth_share = (bytes of the matrices / time of a frame) / (bytes copied / time of the copy)
    relight_vs_scipy        = time of SciPy's products / time of ours

A frame is `Relight.frame` with one bounce: light in, patches, all probes, light out. A copy moves 256 MiB by np.copyto on two
threads each, or within the device's memory where that is not the host's; bytes are counted once, though a copy reads and writes them.

A frame is shorter than a tick of Linux's scheduler (4 ms). Where the other tasks have kept the cores busy, it may put both of PoCL's
threads on one core until the next tick, so `fastpath.device` pins them: on one machine, three runs of these rows each, frames that took
4.4 to 5.9 ms (0.43 to 0.57 of the copy) then took 3.5 to 3.9 (0.71 to 0.74).
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy import sparse

from ...fastpath.device import OpenDevice, open_device, pyopencl_module
from ...fastpath.rows import Relight, Rows
from ...reference import pipeline
from ...reference.datatypes import F32, F64, Scene
from ...reference.progress import Progress
from ...reference.sky import SKY_BINS
from ...reference.transport.form_factors import FormFactors
from .places import bundled
from .rows import Group, Row, Wanted, row_of
from .timing import interleaved, timed

COPY_BYTES, COPY_THREADS = 256 << 20, 2
REPEATS = 45  # a frame takes milliseconds, and other tenants of the memory come and go
NAMES = (
    "relight_bandwidth_share", "relight_bandwidth_share_counting_writes", "relight_kernels_bandwidth_share", "relight_vs_scipy",
    "relight_frame_ms", "copy_gb_per_s",
)  # fmt: skip


@dataclass(frozen=True, eq=False)
class Baked:
    """A bake on the device: its rows on the host, the frames, and products with light that is there already."""

    patch_rows: FormFactors
    probe_rows: FormFactors
    relight: Relight
    frame: Callable[[], object]
    kernels: Callable[[], object]
    bytes: int


def baked(scene: Scene, device: OpenDevice, progress: Progress) -> Baked:
    """Bake a scene at its own settings and put it on the device."""
    surfaces = pipeline.bake_surfaces(scene, 0, progress)
    probes = pipeline.bake_probes(scene, surfaces, pipeline.place(scene, surfaces, 0), 0, progress)
    p = surfaces.patches
    patch_rows, probe_rows = (on_device(device, f) for f in (surfaces.rows, probes.rows))
    albedo, exitance = p.albedo.astype(np.float32), p.exitance.astype(np.float32)
    relight = Relight(device, patch_rows, {"probes": probe_rows}, albedo, exitance)
    direct, sky = np.ones((p.count, 3), np.float32), np.ones((SKY_BINS, 3), np.float32)
    return Baked(
        surfaces.rows,
        probes.rows,
        relight,
        lambda: relight.frame(direct, sky, sky),
        products(device, patch_rows, probe_rows),
        patch_rows.bytes + probe_rows.bytes,
    )


def on_device(device: OpenDevice, f: FormFactors) -> Rows:
    """Form factors in the device's memory."""
    return Rows(device, f.indptr, f.columns, f.values, f.patches + SKY_BINS + 1)


def products(device: OpenDevice, *all_rows: Rows) -> Callable[[], object]:
    """The rows' products with light on the device, into buffers on the device."""
    cl, read_write = pyopencl_module(), pyopencl_module().mem_flags.READ_WRITE
    light = [cl.Buffer(device.context, read_write, 16 * rows.columns_count) for rows in all_rows]
    out = [cl.Buffer(device.context, read_write, 12 * rows.rows * rows.components) for rows in all_rows]
    for buffer in light:
        cl.enqueue_fill_buffer(device.queue, buffer, np.ones(1, np.float32), 0, buffer.size)

    def work() -> None:
        for rows, source, target in zip(all_rows, light, out, strict=True):
            rows.gather(source, target)
        device.queue.finish()

    return work


def scipy_products(*all_rows: FormFactors) -> Callable[[], object]:
    """The same products by SciPy, a matrix per component, everything float32 and contiguous."""
    matrices = []
    for f in all_rows:
        shape = (f.rows, f.patches + SKY_BINS + 1)
        for k in range(f.values.shape[1]):
            values = np.ascontiguousarray(f.values[:, k])
            matrices.append(sparse.csr_array((values, f.columns, f.indptr.astype(np.int32)), shape=shape))
    light: F32 = np.ones((matrices[0].shape[1], 3), np.float32)
    return lambda: [m @ light for m in matrices]


def copy_arrays(size: int = COPY_BYTES) -> list[tuple[F64, F64]]:
    """Source and target of each copy, `size` bytes each, touched."""
    return [(np.ones(size // 8), np.full(size // 8, 2.0)) for _ in range(COPY_THREADS)]


def host_copy(pool: ThreadPoolExecutor, pairs: list[tuple[F64, F64]]) -> Callable[[], object]:
    """All copies at once."""
    return lambda: list(pool.map(lambda pair: np.copyto(pair[1], pair[0]), pairs))


def device_copy(device: OpenDevice) -> Callable[[], object]:
    """The same number of bytes copied within the device's memory."""
    cl, flags = pyopencl_module(), pyopencl_module().mem_flags
    pairs = [
        tuple(cl.Buffer(device.context, flags.READ_WRITE, COPY_BYTES) for _ in range(2)) for _ in range(COPY_THREADS)
    ]

    def work() -> None:
        for source, target in pairs:
            cl.enqueue_copy(device.queue, target, source)
        device.queue.finish()

    return work


def relight(wanted: Wanted, progress: Progress) -> Iterator[Row]:
    """All relight rows, on the house at its own settings."""
    del wanted
    device = open_device()
    b = baked(bundled("house"), device, progress)
    with ThreadPoolExecutor(COPY_THREADS) as pool:
        copy = device_copy(device) if device.info.kind == "gpu" else host_copy(pool, copy_arrays())
        work: dict[str, Any] = {
            "frame": b.frame,
            "kernels": b.kernels,
            "scipy": scipy_products(b.patch_rows, b.probe_rows),
            "copy": copy,
        }
        s = interleaved({name: timed(f) for name, f in work.items()}, REPEATS, progress, "relight")
    per_second = {name: b.bytes / s[name] for name in ("frame", "kernels")}
    copied = COPY_THREADS * COPY_BYTES / s["copy"]
    size = f"{b.bytes / 2**20:.0f} MiB of matrices"
    rows = f"{b.patch_rows.rows} patch rows and {b.probe_rows.rows} probe rows of the house, {size}, {device.info.name}"
    note = f"{rows}; copy: bytes copied, counted once"
    share, ratio = per_second["frame"] / copied, s["scipy"] / s["frame"]
    yield row_of("relight_bandwidth_share", share, "ratio", "higher", 0.5, note)
    twice = "as above, against bytes read and written by the copy"
    yield row_of("relight_bandwidth_share_counting_writes", share / 2.0, "ratio", "higher", note=twice)
    alone = "products alone, light on the device already"
    yield row_of("relight_kernels_bandwidth_share", per_second["kernels"] / copied, "ratio", "higher", note=alone)
    note = f"{rows}; SciPy: csr_array @ (columns, 3) float32, once for patches, four times for probes"
    yield row_of("relight_vs_scipy", ratio, "ratio", "higher", 3.0, note)
    yield row_of("relight_frame_ms", 1e3 * s["frame"], "ms", "lower")
    yield row_of("copy_gb_per_s", 1e-9 * copied, "GB/s", "higher")


GROUPS = (Group(NAMES, relight),)
