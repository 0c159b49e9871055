"""The artist's controls: where probes are wanted, how finely, and how the octree is made of it."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import AfterValidator, Field, model_validator

from .config_base import Frozen, Positive, Vec3, power_of_two


class BoxSettings(Frozen):
    """Axis-aligned box, m."""

    min: Vec3
    max: Vec3

    @model_validator(mode="after")
    def _check(self) -> BoxSettings:
        if any(b <= a for a, b in zip(self.min, self.max, strict=True)):
            raise ValueError(f"max must exceed min on every axis, got min {self.min} and max {self.max}")
        return self


class VolumeSettings(BoxSettings):
    """Box that moving meshes or fog may enter: probes are wanted in it, at voxel size `probe_size`, m."""

    probe_size: Positive | None = None


class LimitSettings(BoxSettings):
    """Box within which voxels are no finer than `finest`, m, and no coarser than `coarsest`, m, wherever there are any."""

    finest: Positive | None = None
    coarsest: Positive | None = None

    @model_validator(mode="after")
    def _check_sizes(self) -> LimitSettings:
        if self.finest is None and self.coarsest is None:
            raise ValueError("a limit needs finest, coarsest or both")
        if self.finest is not None and self.coarsest is not None and self.coarsest < self.finest:
            raise ValueError(f"coarsest must be at least finest ({self.finest}), got {self.coarsest}")
        return self


class MarkSettings(Frozen):
    """Geometry that no light meets and that marks the voxel bitmap: the surface of a mesh, all of a closed mesh, or a cloud of
    points (PLY or OBJ; of a cloud only the vertices count), at voxel size `probe_size`, m."""

    file: str
    kind: Literal["surface", "closed", "points"]
    probe_size: Positive | None = None


class PlacementSettings(Frozen):
    """Octree placement (talk, "Adaptive subdivision").

    min_voxel: finest voxel size, m; without it the longest side of the scene / 64.
    bitmap: voxel bitmap file laid over what meshes, volumes and marks ask for, limits included (an edit, or an engine's own;
    reference/bitmap_file.py has the format). In the scene's folder, or as typed where the command line gives it.
    threshold: a voxel is close to surfaces if a corner's harmonic mean distance is under this many of its sizes.
    touching: a voxel that a surface lit by probes touches is close to it, whatever the harmonic mean says (it is blind to
    thin and far things, failure-catalogue C6).
    subdivision: "child-only" places probes for the children that are close to surfaces; "plain" for all eight, as 3×3×3.
    rays: Fibonacci directions per corner.
    probe_rays: rays for the form factors of one real probe at most, a power of two. probe_noise: relative
    standard error of the light that probes gather, root mean square, at which they need no more of them.
    backface_tolerance: share of back-face hits above which a probe is invalid.
    cull_error: probes become virtual as long as this raises the error by at most this share of itself; without it none is.
    max_probes: refused above this many real probes.
    """

    min_voxel: Positive | None = None
    bitmap: str | None = None
    threshold: Positive = 2.0
    touching: bool = False
    subdivision: Literal["child-only", "plain"] = "child-only"
    rays: Annotated[int, Field(ge=16, le=4096)] = 64
    probe_rays: Annotated[int, Field(ge=64, le=65536), AfterValidator(power_of_two)] = 4096
    probe_noise: Positive = 0.02
    backface_tolerance: Annotated[float, Field(ge=0.0, le=1.0)] = 0.1
    cull_error: Positive | None = None
    max_probes: Annotated[int, Field(ge=8)] = 400_000
