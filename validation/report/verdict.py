"""What the numbers of a scene say, in words a reader can act on: a headline and warnings, worst scenes first."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Literal

from .words import SUFFIXES, Z95, percent

Tone = Literal["good", "fair", "bad", "mute"]
RANK: dict[Tone, int] = {"good": 0, "mute": 1, "fair": 2, "bad": 3}
AT_FLOOR, NEAR_FLOOR, SMALL, LEAKS, SEAM, HIDDEN, FARTHER = 1.25, 1.5, 0.02, 1e-3, 1e-2, 2.0, 1.25
CAMERA = "relrmse_camera_"
PATCHES, KERNEL, UNLIT = 0.7, 1e-5, 1e-3


@dataclass(frozen=True)
class Verdict:
    """A few words, their tone, and a sentence that says why."""

    words: str
    tone: Tone
    why: str


def headline(scene: Mapping[str, Any]) -> Verdict:
    """The one thing to know about a scene."""
    metrics: Mapping[str, Any] = scene.get("metrics", {})
    if scene["status"] != "ok":
        return Verdict("failed", "bad", "This scene gave no result; the reason is in its section.")
    if "relrmse" not in metrics:
        return Verdict("not measured", "mute", "The error could not be measured; the reason is in the scene's notes.")
    error = metrics["relrmse"]
    value, half = float(error["value"]), Z95 * float(error.get("se") or 0.0)
    if error.get("below_noise"):
        return Verdict("below the noise floor", "mute", "The error is too small for this reference to tell from zero.")
    if value + half <= SMALL:
        return Verdict("accurate", "good", f"The whole 95 % interval is under {percent(SMALL)}.")
    ratio = floor_ratio(metrics)
    if patch_share(metrics) > PATCHES:
        words = (
            f"Without probes the patches' light is already wrong by {percent(_value(metrics, 'patch_relrmse'), 2)}: "
        )
        tone: Tone = "fair" if ratio is not None and ratio <= AT_FLOOR else "bad"
        return Verdict(
            "patches limited", tone, words + "finer patches help, or it is model error such as gloss; probes do not."
        )
    if ratio is None:
        return Verdict("no floor to compare", "mute", "Without the floor it is open what limits the error.")
    if ratio <= AT_FLOOR:
        return Verdict("at its floor", "good", "More or better placed probes would not help: L1 is the limit.")
    if ratio <= NEAR_FLOOR:
        return Verdict("near its floor", "fair", "Finer probes can still win a little.")
    return Verdict("placement limited", "bad", f"{ratio:.1f} times its floor: better placed or finer probes help.")


def warnings(scene: Mapping[str, Any]) -> list[Verdict]:
    """What else a reader must not miss."""
    metrics: Mapping[str, Any] = scene.get("metrics", {})
    found = []
    if _low(metrics, "leak") > LEAKS:
        found.append(Verdict("leaks light", "bad", "Light where there is none: a wall thinner than its voxels?"))
    if max(_low(metrics, "seam_sup"), _low(metrics, "seam_sup_half")) > SEAM:
        found.append(Verdict("visible seams", "bad", "The light jumps by over 1 % between voxels that meet."))
    if _value(metrics, "kernel_deviation") > KERNEL:
        found.append(Verdict("kernel deviates", "bad", "The kernel does not give what its specification gives."))
    if max(_low(metrics, f"unlit_share{suffix}") for suffix in SUFFIXES) > UNLIT:
        found.append(Verdict("unlit points", "fair", "Some points find no valid probe around them and get no light."))
    seen = _value(metrics, "relrmse")
    for suffix, where in (("_surface", "on other surfaces"), ("_volume", "in mid-air")):
        if seen > 0.0 and _low(metrics, f"relrmse{suffix}") > HIDDEN * seen:
            found.append(Verdict(f"worse {where}", "fair", "Over twice the error of what the cameras see."))
    for name in sorted(metrics):
        if name.startswith(CAMERA) and seen > 0.0 and _low(metrics, name) > HIDDEN * seen:
            camera = name.removeprefix(CAMERA)
            found.append(Verdict(f"worse from {camera}", "fair", "Over twice the error of all cameras together."))
    if seen > 0.0 and _low(metrics, "relrmse_lod") > FARTHER * seen:
        away = percent(_value(metrics, "relrmse_lod"), 3)
        why = f"At the levels that the cameras' distances ask for the error is {away}; the other figures read the finest voxels."
        found.append(Verdict("worse at its levels of detail", "bad", why))
    if 0.0 < seen < 2.0 * _value(metrics, "reference_noise"):
        found.append(Verdict("noisy reference", "fair", "Its noise is over half the error: trace more paths."))
    return found


def patch_share(metrics: Mapping[str, Any]) -> float:
    """The patches' own error over the total; 0 where it is not known or lost in the reference's noise."""
    error, total = metrics.get("patch_relrmse"), _value(metrics, "relrmse")
    return float(error["value"]) / total if error and total > 0.0 and not error.get("below_noise") else 0.0


def floor_ratio(metrics: Mapping[str, Any]) -> float | None:
    """Error over the L1 floor. Where the floor is below the noise, its upper bound (two standard errors) stands in."""
    if "relrmse_over_floor" in metrics:
        return float(metrics["relrmse_over_floor"]["value"])
    record = metrics.get("floor_l1", {})
    floor = _value(metrics, "floor_l1")
    if record.get("below_noise"):
        floor += 2.0 * float(record.get("se") or 0.0)
    return _value(metrics, "relrmse") / floor if floor > 0.0 and "relrmse" in metrics else None


def badness(scene: Mapping[str, Any]) -> tuple[int, float]:
    """Sort key, largest first: failed, then by tone, then by error."""
    tones = [headline(scene).tone, *(w.tone for w in warnings(scene))]
    rank = 9 if scene["status"] != "ok" else max(RANK[tone] for tone in tones)
    return rank, _value(scene.get("metrics", {}), "relrmse")


def _value(metrics: Mapping[str, Any], name: str) -> float:
    return float(metrics[name]["value"]) if name in metrics else 0.0


def _low(metrics: Mapping[str, Any], name: str) -> float:
    """Lower end of the 95 % interval, 0 for what was not measured."""
    return _value(metrics, name) - Z95 * float(metrics[name].get("se") or 0.0) if name in metrics else 0.0
