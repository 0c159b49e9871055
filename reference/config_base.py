"""What all settings are made of: the frozen base, and the types of their values."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import BaseModel, ConfigDict, Field

Vec3 = tuple[float, float, float]
Unit = Annotated[float, Field(ge=0.0, lt=1.0)]
Albedo = tuple[Unit, Unit, Unit]
NonNegative = Annotated[float, Field(ge=0.0)]
Colour = tuple[NonNegative, NonNegative, NonNegative]
Positive = Annotated[float, Field(gt=0.0)]
Tag = Literal["engine", "input"]
Reconstruction = Literal[
    "linear", "clamped", "nonlinear", "zh3", "l2"
]  # of irradiance from SH: reference/reconstruction.py


def power_of_two(value: int) -> int:
    """`value`. Raises ValueError unless it is a power of two."""
    if value & (value - 1):
        raise ValueError(
            f"must be a power of two, as {1 << (value.bit_length() - 1)} or {1 << value.bit_length()}, got {value}"
        )
    return value


class Frozen(BaseModel):
    """Base of all settings: immutable, no unknown keys, no NaN or infinity."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)
