"""The virtual texture under stress: E1 … E8 of the failure catalogue.

What is measured is the product's: the OpenCL kernels in their layouts, the tile cache, the clipmap and the residency. Curves without a
good value do without the remedy: a filter of a texture unit, a cache read without borders, positions in single precision.
"""

from __future__ import annotations

import math

from .case import Band, Case, Curve, at_least, at_most, within
from .late import late

HALF_STEP = 2.0**-11  # relative rounding of a half float
BESIDE = 1e6  # L00 of the light that E3 stores beside the dim one
NORMAL = BESIDE / 2.0**15 * 2.0 * 2.0**-14  # what is stored beside it under this is a subnormal half float, or nothing
REACH, BLEND = 6.0, 0.25  # of E8: metres that the finest level serves, share of a ring that is blended
SINGLE = 2.0**-23  # spacing of floats at 1
TWO_SIDED = 2.0  # a spacing is at most so many times the value's own


def _dim(brightness: float) -> Band:
    return Band(0.0, 1.0) if brightness < NORMAL else Band(0.0, 1.01 * HALF_STEP)


def _bare(brightness: float) -> Band:
    """65,520 and more is infinite; under 3e-8 nothing is left; between, normal numbers round by 2^-11."""
    if brightness >= 65520.0 or brightness < 2.9e-8:
        return Band(1.0, 1.0)
    return Band(0.0, 1.01 * max(HALF_STEP, 2.0**-25 / brightness))


def _ulps_in_voxels(distance: float) -> Band:
    """Between a tenth of the spacing of floats there, in voxels of 0.25 m, and all of it."""
    spacing = SINGLE * distance / 0.25
    return Band(0.1 * spacing, 2.0 * spacing + 2e-5)


def _refused(most: float) -> Band:
    return Band(1.0, 1.0) if most >= 255.5 else Band(0.0, 0.0)


def _stepped(step: float) -> Band:
    return Band(0.0, min(1.0, step / (BLEND * REACH)) + 1e-3)


def _filtered(contrast: float) -> float:
    """RMS error of fractions rounded to 1/256, over the light, for small contrasts [A]: three axes, each off by ±1/512 at random (a
    third of its square), times the slope between neighbours of variance 2 σ² each, mixed by bilinear weights (Σ w² = 4/9)."""
    return contrast * math.sqrt(8.0 / 9.0) / 512.0


def _percentile_of(contrast: float) -> Band:
    """2.3 to 3.4 times the RMS for small contrasts (2.6 if normal); where the light's logarithm is far from linear, up to its bound."""
    return Band(2.2 * _filtered(contrast), (3.4 if contrast <= 0.2 else 8.0) * _filtered(contrast))


E1 = Case(
    id="E1",
    title="A hardware filter interpolates with 8-bit fractions",
    scene="4,913 probes of one level with even light, all valid or a tenth invalid",
    parameter="contrast between probes (deviation of the light's logarithm)",
    unit="",
    values=(0.05, 0.1, 0.2, 0.4, 0.8, 1.2),
    metric="99th percentile (and worst) of the error of interpolated irradiance, relative",
    curves=(
        Curve("explicit loads", at_most(1e-5), "the packed kernel interpolates in single precision: catalogue, Seam, 1e-5"),
        Curve("images", lambda c: Band(high=_percentile_of(c).high + 1e-5), "the device's filter is no coarser than 24.8 (E1)"),
        Curve("images, invalid", lambda c: Band(high=4.0 * _percentile_of(c).high + 1e-5), "as images; light is divided by the weight"),
        Curve("24.8 filter", None, "fractions rounded to 1/256: an RMS of √(8/9) σ / 512 for small contrasts σ [A]",
              stated=_percentile_of),
        Curve("24.8 filter over its bound", at_most(1.0), "half a step times the steepest edge, along each axis [A]"),
        Curve("24.8 filter, invalid", None, "where little weight is left its rounding counts: more than with all valid (E1)",
              stated=lambda c: Band(_percentile_of(c).low, 4.0 * _percentile_of(c).high)),
        Curve("24.8 filter, worst", None, "by contrast"),
        Curve("24.8 filter, invalid, worst", None, "by contrast; 33 % at the worst (E1)"),
    ),
    measure=late("texture_filter", "filter_fractions"),
    log=True,
    breaks="24.8 filter",
    limit=0.007,
    notes=(
        "The error's size is the light's contrast: the catalogue's 0.7 % is read where this curve breaks, its 1.2 % with weights near.",
        "PoCL's filter has full fractions, so images read as explicit loads there; on a GPU the images curve shows the filter.",
    ),
)  # fmt: skip

E2 = Case(
    id="E2",
    title="NaN or infinity in a neighbouring tile enters with weight 0",
    scene="one tile of a random octree, read on its faces, the other tiles poisoned",
    parameter="share poisoned",
    unit="",
    values=(0.01, 0.1, 0.5, 1.0),
    metric="share of samples that are not finite, or not what they are without the poison",
    curves=(
        Curve("NaN next door", at_most(0.0), "each tile has its own border texels: no sample reads another tile (E2)"),
        Curve("infinity next door", at_most(0.0), "the same through separate textures (E2)"),
        Curve("NaN next door, images", at_most(0.0), "texel centres are clamped half a texel inside the tile (E2)"),
        Curve("light that is no number", at_most(0.0), "probes whose light is not finite count as invalid when tiles are filled (E2)"),
        Curve("positions that are no numbers", at_most(0.0), "a NaN position gives NaN there, and nothing else (E2)"),
        Curve("filter over tile borders", None, "a filter that reads the next texel with weight 0 makes 0 · NaN = NaN (E2)",
              stated=lambda share: Band(low=1e-3) if share >= 0.5 else Band()),
    ),
    measure=late("texture_reads", "poison"),
)  # fmt: skip

E3 = Case(
    id="E3",
    title="Half floats overflow, underflow and round",
    scene="uniform light of one brightness, alone and beside one probe of 1e6",
    parameter="radiance SH L00",
    unit="W·m⁻²·sr⁻¹",
    values=(1e-9, 1e-7, 1e-5, 1e-3, 1.0, 1e3, 6.6e4, 1e6),
    metric="relative error of irradiance, at most 1; last curve: the brightest number stored",
    curves=(
        Curve("pre-exposed", at_most(1.01 * HALF_STEP), "light is divided by a power of two before it is stored: 2^-11 is left (E3)"),
        Curve("beside 1e+06", at_most(1.01 * HALF_STEP),
              "one exposure serves the whole cache: half floats hold nine decades below the brightest light (E3)", stated=_dim),
        Curve("without exposure", None, "65,520 becomes infinite, under 3e-8 nothing is left (E3)", stated=_bare),
        Curve("brightest as stored", within(16384.0, 32768.0), "the brightest light is just under the largest half float (E3)"),
    ),
    measure=late("texture_reads", "half_floats"),
    log=True,
    breaks="beside 1e+06",
    limit=1.01 * HALF_STEP,
)  # fmt: skip

E4 = Case(
    id="E4",
    title="Addresses: texel centres, exact faces, floor against truncation",
    scene="a linear ramp of 32³ voxels about the origin, read at every voxel corner",
    parameter="floats off the face",
    unit="ulp",
    values=(-4.0, -1.0, 0.0, 1.0, 4.0),
    metric="largest error over the ramp's top",
    curves=(
        Curve("packed", at_most(2e-6), "trilinear interpolation of a ramp is the ramp; single precision leaves 1e-6 (E4)"),
        Curve("split", at_most(2e-6), "the same from separate textures (E4)"),
        Curve("images", at_most(1.0 / 256.0 / 32.0 * 1.1), "a filter's fractions of 1/256 of a texel at most, of 32 (E1, E4)"),
        Curve("truncated cells", None, "truncation names the cell beside at negative positions: one voxel of 32 (E4)",
              stated=lambda ulps: Band(0.9 / 32.0, 1.1 / 32.0) if ulps > 0.0 else Band()),
        Curve("half a texel off", None, "what is off by half a texel shows: half a voxel of 32 (E4)",
              stated=within(0.45 / 32.0, 0.55 / 32.0)),
    ),
    measure=late("texture_reads", "addresses"),
    whole=True,
)  # fmt: skip

E5 = Case(
    id="E5",
    title="Far from the origin",
    scene="the ramp with voxels of 0.25 m, moved away from the world's origin",
    parameter="distance",
    unit="m",
    values=(10.0, 100.0, 1e3, 1e4, 1e5, 1e6),
    metric="how far a sample seems moved, in voxels",
    curves=(
        Curve("anchored", at_most(2e-5), "whole cells and local fractions: single precision near the viewer, wherever he is (E5)"),
        Curve("single precision", None, "positions are rounded to floats: half a spacing over the voxel, 0.2 % at 10 km (E5)",
              stated=_ulps_in_voxels),
    ),
    measure=late("texture_reads", "far_away"),
    log=True,
    breaks="single precision",
    limit=0.01,
    notes=("The catalogue's 0.4 % at 10 km is the whole spacing of floats; rounding moves a position by up to half of it.",),
)  # fmt: skip

E6 = Case(
    id="E6",
    title="Bit budget of the indirection texel",
    scene="offsets, levels and caches numbered beyond 8 bits",
    parameter="largest number",
    unit="",
    values=(200.0, 254.0, 255.0, 256.0, 257.0, 512.0),
    metric="1 where it is refused; read back: bits lost; without a check: tiles off",
    curves=(
        *(Curve(name, _refused, "8 bits hold 0 … 255: 256 raises an error (E6)")
          for name in ("offset", "level", "tiles", "clipmap, tiles", "clipmap, levels")),
        Curve("read back", at_most(0.0), "what is packed is what is read (E6)"),
        Curve("without a check", None, "the number wraps around and names another tile (E6)",
              stated=lambda most: Band(low=1.0) if most >= 255.5 else Band(0.0, 0.0)),
    ),
    measure=late("texture_streams", "bit_budget"),
    whole=True,
    breaks="offset",
    limit=0.5,
)  # fmt: skip

E7 = Case(
    id="E7",
    title="Tile cache overflow",
    scene="orbit of radius 3 m in a random octree of 64³ voxels, two rounds",
    parameter="working set over capacity",
    unit="",
    values=(0.5, 0.75, 1.0, 1.5, 2.0, 3.0),
    metric="wrong reads; shares of samples; evictions per frame over the cache's tiles",
    curves=(
        Curve("wrong reads", at_most(0.0), "no sample may read a slot that holds the tile of another place (E7)"),
        Curve("unlike the plain twin", at_most(0.0), "every sample is that of the finest resident tile (E7)"),
        Curve("evictions", lambda ratio: Band(0.0, 0.0 if ratio <= 0.5 else 0.1),
              "a cache of twice the working set evicts nothing on the second round, a small one a tenth of itself a frame (E7)"),
        Curve("answered by a parent", lambda ratio: Band(0.0, 0.0 if ratio <= 0.75 else 0.25),
              "what fits is there; what does not is answered by its parent, and never black (E7)"),
        Curve("wrong reads, pointers kept", None, "a tile that leaves and stays pointed to is read for another (E7)",
              stated=lambda ratio: Band(low=1.0) if ratio >= 2.0 else Band()),
    ),
    measure=late("texture_streams", "overflow"),
    breaks="answered by a parent",
    limit=0.001,
)  # fmt: skip

E8 = Case(
    id="E8",
    title="LOD pop and clipmap shift",
    scene="the same world, all tiles resident; one step along an axis, back along another, along the diagonal",
    parameter="step",
    unit="finest voxels",
    values=(0.5, 1.0, 2.0, 5.0, 14.0, 30.0),
    metric="texels; share of points; change over the largest difference between levels of detail at the point",
    curves=(
        Curve("stale texels", at_most(0.0), "after any shift the windows are those built from nothing (E8)"),
        Curve("changed without a change of level", at_most(0.0), "points whose level stays keep every bit (Temporal)"),
        Curve("pop, blended", _stepped, "the share of the next level moves by at most step / (blend · distance of the ring) [A]"),
        Curve("pop", None, "without blending a point that crosses a ring takes the whole difference (E8)", stated=within(0.3, 1.001)),
        Curve("stale texels, slabs not written", None, "a window that moves without writing what enters it keeps old pointers (E8)",
              stated=at_least(1.0)),
    ),
    measure=late("texture_streams", "shift"),
    log=True,
    breaks="pop, blended",
    limit=0.5,
    notes=("Positions count from one anchor here: from the viewer, rounding changes the last bit of most samples at every step.",),
)  # fmt: skip

CASES: tuple[Case, ...] = (E1, E2, E3, E4, E5, E6, E7, E8)
