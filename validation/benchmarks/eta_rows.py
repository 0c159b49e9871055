"""Placement efficiency η: how many more probes a uniform grid needs for the error of the scene's own placement.

Both at as many random placements (SHIFTS) of their lattice and at the best of the same sample offsets, chosen by the error that is
compared; the spread of a row holds the noise of the points and that of both placements. `eta_house` and `eta_valley` are at equal
relRMSE over the cameras, `eta_cornell` at equal placement-only error, because there the floor of L1 is most of the rest. `_inside` and
`_outside`: each camera of house for itself. `_placement`: at equal placement-only error. `_valid`, `_bytes`, `_update`: by valid
probes, bytes of form factors and texture, by the time of an update. Near the floor of L1 the grids' curve is flat and η by total error
says little more than that grids do not get there; the placement-only rows do not suffer from that. They are read off a line through
the grids near in error, with points and placements taken into account together (`efficiency.paired`); the others between the two
nearest grids.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from functools import partial

from ...fastpath.device import open_device
from ...reference import pipeline
from ...reference.progress import Progress
from ...reference.variant import ensure_variant
from ..efficiency.curve import OFFSETS, Cost, GridRow, Key, bracketing_curve
from ..efficiency.eta import eta
from ..efficiency.judged import judges
from ..efficiency.paired import paired_eta
from ..efficiency.placements import Reached, random_shifts, reached
from ..ground_truth import ground_truth
from .places import bundled
from .rows import Group, Row, Wanted

SHIFTS: Mapping[str, int] = {"cornell": 12, "house": 5, "valley": 5}  # what is near to its target needs more of them
STEP, MOST = 2.0**0.5, 9
SEED = 0
COSTS: Mapping[str, Cost] = {"": "probes", "_valid": "valid_probes", "_bytes": "bytes", "_update": "entries"}
TARGETS = {"eta_house": 15.0, "eta_valley": 8.0, "eta_cornell": 1.3}
TARGETS |= {"eta_house_inside": 15.0, "eta_house_outside": 15.0}
# Row name without the cost's suffix → what is judged.
JUDGED: Mapping[str, Mapping[str, Key]] = {
    "cornell": {"eta_cornell": ("camera", "placement"), "eta_cornell_surface": ("surface", "placement")},
    "house": {
        "eta_house": ("camera", "total"),
        "eta_house_inside": ("camera_inside", "total"),
        "eta_house_outside": ("camera_outside", "total"),
        "eta_house_placement": ("camera", "placement"),
    },
    "valley": {"eta_valley": ("camera", "total"), "eta_valley_placement": ("camera", "placement")},
}


def names(scene: str) -> tuple[str, ...]:
    """Row names of a scene."""
    return tuple(row + suffix for row in JUDGED[scene] for suffix in COSTS)


def efficiency(scene_name: str, wanted: Wanted, progress: Progress) -> Iterator[Row]:
    """Rows of one scene."""
    del wanted
    ensure_variant()
    scene, device = bundled(scene_name), open_device()
    truth = ground_truth(scene, SEED, progress)
    surfaces = pipeline.bake_surfaces(scene, SEED, progress)
    light = pipeline.light_patches(scene, surfaces, SEED, progress)
    asked = list(judges(scene, truth, ("camera", "surface")))
    count = SHIFTS[scene_name]
    shifts = random_shifts(scene, surfaces, count, SEED)
    ours = reached(scene, device, (surfaces, light), truth, asked, shifts, SEED, progress, offsets=OFFSETS)
    wanted_errors = {key: ours.error[key].value for key in JUDGED[scene_name].values()}
    curve = bracketing_curve(
        scene, surfaces, light, truth, asked, wanted_errors, ours.cost["probes"], STEP, MOST, count, SEED, progress
    )
    for row, key in JUDGED[scene_name].items():
        for suffix, cost in COSTS.items():
            yield _row(row + suffix, curve, ours, key, cost)


def _row(name: str, curve: list[GridRow], ours: Reached, key: Key, cost: Cost) -> Row:
    error, placements = ours.error[key], len(ours.each[key])
    found = eta(curve, key, cost, ours.cost[cost], error.value, ours.blocks[key].mean(axis=0), ours.spread(key))
    note = (
        f"{found.bound + '; ' if found.bound else ''}{key[0]} points, {key[1]} error {error.value:.2%} ± {error.se:.2%} by its points, "
        f"± {ours.spread(key):.2%} by its placements, samples {ours.offset[key]} voxels off; "
        f"{ours.cost['probes']:.0f} probes, {ours.cost['valid_probes']:.0f} valid; grids "
        + ", ".join(f"{r.voxel:.3g} m {r.cost['probes']:.0f} {r.error[key]:.2%}" for r in curve)
    )
    paired = None
    if key[1] == "placement":
        paired = paired_eta(
            ours.cost[cost], ours.blocks[key], [r.cost[cost] for r in curve], [r.blocks[key] for r in curve]
        )
    if paired is None:
        ends = "{:.3g} to {:.3g} at 95 %; ".format(*found.interval)
        return Row(name, found.value, "x", TARGETS.get(name), "higher", found.se, placements, ends + note)
    low, high = paired.interval
    said = (
        f"{low:.2f} to {high:.2f} at two standard errors of log η: {paired.points:.3f} by points, {paired.ours:.3f} by our "
        f"placements, {paired.theirs:.3f} by the grids'; line through {paired.grids} grids, slope {paired.slope:.2f}; "
    )
    return Row(name, paired.value, "x", TARGETS.get(name), "higher", paired.value * paired.se, placements, said + note)


GROUPS = tuple(Group(names(scene), partial(efficiency, scene)) for scene in JUDGED)
