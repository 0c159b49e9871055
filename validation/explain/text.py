"""An explained pixel in the lines that `run --explain` prints."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from ..summary import number, plain, table


def pixels_text(results: Mapping[str, Any]) -> str:
    """A few lines for each scene of a results object with an explained pixel."""
    return "\n".join(_lines(scene["name"], scene["pixel"]) for scene in results["scenes"] if scene.get("pixel"))


def _lines(name: str, pixel: Mapping[str, Any]) -> str:
    ours, truth, se = (sum(pixel[k]) / 3.0 for k in ("ours", "truth", "truth_se"))
    place = f"{plain(pixel['mesh'])} at {point(pixel['position'])} m"
    head = (
        f"{plain(name)}, camera {plain(pixel['camera'])}, pixel {pixel['x']},{pixel['y']}: {place}; ours {number(ours)}, "
        f"truth {number(truth)} ± {number(se)} W/m² (mean of the colours)"
    )
    rows = [["link", "W/m²", "± se"]]
    rows += [[row["label"], f"{row['mean']:+.4g}", number(row["se"])] for row in pixel["links"]]
    lines = [head, table(rows)]
    if not pixel["probes"]:
        return "\n".join([*lines, "no valid probe is near: the pixel is dark"])
    rows = [["probe", "kind", "at, m", "trilinear", "validity", "counts", "gives, W/m²", "in between"]]
    rows += [_probe(row) for row in pixel["probes"]]
    return "\n".join([*lines, f"voxel of {number(pixel['voxel_m'])} m, level {pixel['level']}:", table(rows)])


def _probe(row: Mapping[str, Any]) -> list[str]:
    named = "" if "probe" not in row else str(row["probe"])
    if named and row["light_from"] not in (-1, row["probe"]):
        named += f" (light of {row['light_from']})"
    between = row.get("blocked")
    return [
        named,
        row["kind"],
        point(row["position"]),
        f"{row['trilinear']:.3f}",
        f"{row['validity']:.3f}",
        f"{100.0 * row['weight']:.1f} %",
        number(row["mean"]),
        f"{plain(between['mesh'])} at {point(between['position'])}" if between else "",
    ]


def point(position: Sequence[float]) -> str:
    """A position in short."""
    return "(" + ", ".join(f"{x:.3f}" for x in position) + ")"
