"""What an edit is searched for, and what is found."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from ...reference.datatypes import F64, I64, BitmapLayer, Bool
from ...reference.lattice import Grid
from .attribution import Leaks, blamed, find_leaks
from .descent import Wanted
from .field import LightField, Places


@dataclass(frozen=True, eq=False)
class Search:
    """What an edit is searched for. field: before. at: the places that must not leak. dark: which positions are to be without
    light, None where the scene does not say. mean_light, W·m⁻². rebake: the field with layers laid over the scene."""

    field: LightField
    at: Places
    dark: Wanted | None
    mean_light: float
    rebake: Callable[[Sequence[BitmapLayer]], LightField]

    def leaks(self, field: LightField, at: Places) -> Leaks:
        """Leaks of a field at places."""
        return find_leaks(field, at, None if self.dark is None else self.dark(at.positions), self.mean_light)

    def wanted(self, positions: F64) -> Bool:
        """Which positions (N, 3) m an edit is for."""
        return np.ones(len(positions), dtype=np.bool_) if self.dark is None else self.dark(positions)


@dataclass(frozen=True, eq=False)
class Edit:
    """layers: none where nothing leaks. places: all that were looked at, the search's first. before, after: leaks there.
    field: with the edit. rounds: bakes it took. sheets: places that leak through sheets, which no voxel stops. refused: why the
    octree would not bear finer cells, empty where it did. grown: most cells before those were taken out that nothing needs; minimal:
    none of the rest can be taken out any more. checked: of `places`, how many the edit was looked at in at last, chosen without it."""

    layers: tuple[BitmapLayer, ...]
    places: Places
    before: Leaks
    after: Leaks
    field: LightField
    rounds: int
    sheets: int
    refused: str
    grown: int
    minimal: bool
    checked: int = 0

    @property
    def cells(self) -> int:
        """Cells of all layers."""
        return sum(len(layer.cells) for layer in self.layers)

    @property
    def in_sight(self) -> int:
        """Places that are still lit by probes that they see: no wall lies between, those probes themselves hold the light."""
        lit = np.unique(self.after.pairs.weights.sample[blamed(self.after)])
        return int(self.after.leaks.sum()) - len(lit)

    @property
    def stops(self) -> bool:
        """Whether no light comes through a wall any more."""
        return int(self.after.leaks.sum()) == self.in_sight


def layers_of(grid: Grid, by_level: dict[int, I64]) -> tuple[BitmapLayer, ...]:
    """Cells (N, 3) by level as layers on the octree's own lattice, coarse to fine."""
    return tuple(
        BitmapLayer(grid.origin, float(grid.finest * 2.0 ** (grid.level - level)), by_level[level], "place")
        for level in sorted(by_level)
    )
