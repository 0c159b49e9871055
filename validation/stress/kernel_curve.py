"""The curve `kernel` of cases that read the plain sampler: what it is held to. Its readings are kernel_reads.py's."""

from __future__ import annotations

from .case import Curve, at_most

KERNEL = "kernel"
LIMIT = 1e-5  # of single precision: as a seam's, and as the gates hold the kernel to


def kernel_curve(limit: float = LIMIT) -> Curve:
    """The kernel's largest difference from its plain twin, relative; absent without an OpenCL device."""
    return Curve(
        KERNEL,
        at_most(limit),
        "the OpenCL kernel reads what its plain twin reads, on both sides of every border (E4)",
        needs="an OpenCL device",
    )
