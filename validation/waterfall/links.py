"""The links of the waterfall: the stages between the path-traced truth and the pixel, each exchanged for its exact counterpart in turn.

    E_0  path traced                                    the reference R
    E_1  path traced, with what the bake sees           every surface diffuse; what moves, or lets light through, is gone
    E_2  patches, better form factors                   radiosity from EXACT_RAYS times the rays, gathered by rays at the point
    E_3  patches as baked                               gathered by the same rays
    E_4  exact SH at the point                          the same light by the same rays, in the order that the scene reconstructs from
    E_5  exact SH at the sample                         where the sampler reads: off the surface by sampling.normal_offset
    E_6  probes of E_3's light, by more rays            interpolated over the uncut placement, float32, all levels
    E_7  probes as baked                                interpolated in the same way, by the kernel's plain twin
    E_8  culled placement                               float32
    E_9  as stored                                      half floats, each level rounded before the next is interpolated
    E_10 as the run samples it                          on the device; by distance from the viewer where the scene says so

Link k is d_k = E_k - E_(k-1); their sum is the whole error, E_10 - E_0. Light of punctual lights tagged `input` is in all of them.
"""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Link:
    """name: in the record. label: for a reader. says: what the difference is made of."""

    name: str
    label: str
    says: str


LINKS = (
    Link(
        "materials",
        "Diffuse materials",
        "gloss, masks, glass and meshes that move, which the bake leaves out or makes diffuse",
    ),
    Link(
        "patches",
        "Patches and bounces",
        "one radiosity for a whole patch, one radiance for a bin of the sky, bounces the solver leaves out",
    ),
    Link(
        "form_factors", "Form-factor noise", "patch form factors and direct light from as many rays as the bake spends"
    ),
    Link(
        "sh_order",
        "SH order",
        "the point's own light in a few SH coefficients, before any probe: the floor of the method",
    ),
    Link(
        "offset",
        "Sample offset",
        "the sample is taken off the surface (sampling.normal_offset), where other light arrives",
    ),
    Link("interpolation", "Interpolation and validity", "light between probes, invalid probes left out, copies, leaks"),
    Link("probe_rays", "Probe noise", "probes from as many rays as the bake spends"),
    Link("culling", "Culling", "probes that became virtual"),
    Link("storage", "Quantisation", "half-float light and the stored weight"),
    Link(
        "device",
        "LOD and clipmap",
        "coarser levels with distance where the scene asks for them, and the device's arithmetic",
    ),
)
STAGES = len(LINKS) + 1
NAMES = tuple(link.name for link in LINKS)
