"""What a scene file may say: frozen settings, one model a table of `scene.toml`.

The same models describe scenes that come from other formats (their loader fills them in), so `--set` works on all.
Lengths are metres, radiometric values linear RGB. Unknown keys are errors that name their path.
"""

from __future__ import annotations

import json
import math
from typing import Annotated, Any, Literal

from pydantic import AfterValidator, Field, model_validator

from .config_base import Albedo, Colour, Frozen, NonNegative, Positive, Reconstruction, Tag, Vec3, power_of_two
from .config_placement import BoxSettings, LimitSettings, MarkSettings, PlacementSettings, VolumeSettings

BLACK: Colour = (0.0, 0.0, 0.0)


class MaterialSettings(Frozen):
    """Diffuse material. `texture` replaces `albedo`; `emission` is radiance, W·m⁻²·sr⁻¹, always input to the radiosity.

    emission_texture: picture whose linear RGB × `emission` is the emitted radiance; with `emission` 0 it is off.
    """

    albedo: Albedo = (0.5, 0.5, 0.5)
    texture: str | None = None
    emission: Colour = BLACK
    emission_texture: str | None = None
    two_sided: bool = False


class MeshSettings(Frozen):
    """One mesh. `probe_size` is the voxel size, m, its surface asks for; without it `placement.min_voxel` holds.
    `lumel_size`: edge, m, of the lumels that a bake keeps for it; without it there are none."""

    file: str | None = None
    material: str
    role: Literal["static", "moving"] = "static"
    lit_by: Literal["probes", "lightmap"] = "probes"
    probe_size: Positive | None = None
    lumel_size: Positive | None = None


def _non_zero(name: str, v: Vec3) -> None:
    if math.hypot(*v) == 0.0:
        raise ValueError(f"{name} has zero length")


class PointLight(Frozen):
    """Isotropic point light. `intensity` in W·sr⁻¹."""

    type: Literal["point"]
    position: Vec3
    intensity: Colour
    tag: Tag = "engine"


class SpotLight(Frozen):
    """Spot light: full `intensity`, W·sr⁻¹, inside `beam_deg`, falling linearly in angle to zero at `cutoff_deg` (half angles)."""

    type: Literal["spot"]
    position: Vec3
    direction: Vec3
    intensity: Colour
    cutoff_deg: Annotated[float, Field(gt=0.0, lt=90.0)] = 30.0
    beam_deg: Annotated[float, Field(ge=0.0, lt=90.0)] = 20.0
    tag: Tag = "engine"

    @model_validator(mode="after")
    def _check(self) -> SpotLight:
        _non_zero("direction", self.direction)
        if self.beam_deg >= self.cutoff_deg:
            raise ValueError(f"beam_deg must be under cutoff_deg ({self.cutoff_deg}), got {self.beam_deg}")
        return self


class DirectionalLight(Frozen):
    """Parallel light travelling along `direction`. `irradiance`, W·m⁻², is what a surface facing it receives."""

    type: Literal["directional"]
    direction: Vec3
    irradiance: Colour
    tag: Tag = "engine"

    @model_validator(mode="after")
    def _check(self) -> DirectionalLight:
        _non_zero("direction", self.direction)
        return self


class AreaLight(Frozen):
    """All faces of mesh `mesh` emit `radiance`, W·m⁻²·sr⁻¹, from their front."""

    type: Literal["area"]
    mesh: str
    radiance: Colour
    tag: Tag = "engine"


class ConstantSky(Frozen):
    """The same `radiance`, W·m⁻²·sr⁻¹, from every direction that leaves the scene."""

    type: Literal["sky"]
    radiance: Colour
    tag: Tag = "input"


class ImageSky(Frozen):
    """Latitude-longitude picture, y up, linear radiance × `scale`; `rotation_deg` turns it about y."""

    type: Literal["image_sky"]
    file: str
    scale: NonNegative = 1.0
    rotation_deg: float = 0.0
    tag: Tag = "input"


Light = Annotated[
    PointLight | SpotLight | DirectionalLight | AreaLight | ConstantSky | ImageSky, Field(discriminator="type")
]
Punctual = PointLight | SpotLight | DirectionalLight


class CubemapSettings(Frozen):
    """Cubemap of indirect radiance that a bake keeps: `size` texels an edge, `rays` per texel (a power of two)."""

    position: Vec3
    size: Annotated[int, Field(ge=1, le=256)] = 16
    rays: Annotated[int, Field(ge=64, le=4096), AfterValidator(power_of_two)] = 64


class CameraSettings(Frozen):
    """Pinhole camera. `fov_deg` is the full horizontal angle."""

    origin: Vec3
    target: Vec3
    up: Vec3 = (0.0, 1.0, 0.0)
    fov_deg: Annotated[float, Field(gt=1.0, lt=170.0)] = 60.0
    width: Annotated[int, Field(ge=8, le=4096)] = 256
    height: Annotated[int, Field(ge=8, le=4096)] = 192

    @model_validator(mode="after")
    def _check(self) -> CameraSettings:
        view = tuple(t - o for t, o in zip(self.target, self.origin, strict=True))
        _non_zero("target - origin", (view[0], view[1], view[2]))
        cross = (
            view[1] * self.up[2] - view[2] * self.up[1],
            view[2] * self.up[0] - view[0] * self.up[2],
            view[0] * self.up[1] - view[1] * self.up[0],
        )
        _non_zero("(target - origin) × up", cross)
        return self


class RadiositySettings(Frozen):
    """Patches and radiosity.

    patch_size: target edge of a patch, m; without it chosen so that the scene has about 2,500 patches.
    patch_error: patches within which the light varies by more than this share of the mean light are cut in four, up to
    three times; without it none is.
    rays: cosine-distributed rays per patch at most, a power of two. noise: relative standard error of the light that patches
    gather, root mean square, at which they need no more of them; under 1e-3 closed forms replace rays where provably
    nothing is in the way.
    shadow_rays: samples per patch for direct light.
    tolerance: share of the source that may be left unpassed when the iteration stops. solver: how it iterates.
    """

    patch_size: Positive | None = None
    patch_error: Positive | None = None
    rays: Annotated[int, Field(ge=64, le=1_048_576), AfterValidator(power_of_two)] = 4096
    noise: Positive = 0.02
    shadow_rays: Annotated[int, Field(ge=1, le=4096)] = 64
    tolerance: Annotated[float, Field(gt=0.0, lt=1.0)] = 1e-5
    solver: Literal["jacobi", "gauss-seidel", "southwell", "one-bounce"] = "jacobi"


class SamplingSettings(Frozen):
    """`normal_offset`: sample this many finest voxels off the surface along its normal. `lod_distance`: the finest level of
    detail serves up to this far from the viewer, m, the next one up to twice as far, and so on; without it everywhere.
    `reconstruction`: of irradiance from probes; "l2" bakes five more coefficients a colour (twice the bytes), the others change
    sampling alone."""

    reconstruction: Reconstruction = "linear"
    normal_offset: Annotated[float, Field(ge=0.0, le=4.0)] = 0.5
    lod_distance: Positive | None = None


class TruthSettings(Frozen):
    """Path-traced ground truth.

    noise: requested relative noise (RMS standard error over mean) at the cameras' metric points; the surface and volume
    sets stop at twice that. max_spp: paths per point at most. points: metric points of the cameras together; the other
    two sets have half as many. picture_spp: paths per pixel of the pictures.
    tolerance: share of the indirect light the path depth may lose (depth from ρ^D < tolerance).
    """

    noise: Positive = 0.04
    max_spp: Annotated[int, Field(ge=512, le=1 << 20)] = 1 << 14
    points: Annotated[int, Field(ge=16, le=1_000_000)] = 1000
    picture_spp: Annotated[int, Field(ge=1, le=1 << 16)] = 32
    tolerance: Annotated[float, Field(gt=0.0, lt=1.0)] = 1e-3


class ExpectSettings(Frozen):
    """What is known of the right answer. dark: boxes in which the indirect light is exactly 0. closed_sphere: the
    scene is the inside of a sphere, whose radiosity has a closed form."""

    dark: dict[str, BoxSettings] = Field(default_factory=dict)
    closed_sphere: bool = False


class WorldSettings(Frozen):
    """`rotation`, degrees, turns all of the scene (not the probe lattice) before anything else: about y, or about x, then y,
    then z through the world's origin."""

    rotation: float | Vec3 = 0.0


class SceneSettings(Frozen):
    """A whole scene file."""

    description: str = ""
    unit_m: Positive = 1.0
    scene: WorldSettings = WorldSettings()
    materials: dict[str, MaterialSettings]
    meshes: dict[str, MeshSettings]
    lights: dict[str, Light] = Field(default_factory=dict)
    volumes: dict[str, VolumeSettings] = Field(default_factory=dict)
    marks: dict[str, MarkSettings] = Field(default_factory=dict)
    limits: dict[str, LimitSettings] = Field(default_factory=dict)
    cubemaps: dict[str, CubemapSettings] = Field(default_factory=dict)
    cameras: dict[str, CameraSettings] = Field(default_factory=dict)
    placement: PlacementSettings = PlacementSettings()
    radiosity: RadiositySettings = RadiositySettings()
    sampling: SamplingSettings = SamplingSettings()
    truth: TruthSettings = TruthSettings()
    expect: ExpectSettings = ExpectSettings()


def scene_json_schema() -> dict[str, Any]:
    """JSON Schema of `scene.toml`."""
    return SceneSettings.model_json_schema()


def main() -> None:
    """Print the JSON Schema of `scene.toml`."""
    print(json.dumps(scene_json_schema(), indent=1, sort_keys=True, ensure_ascii=False))


if __name__ == "__main__":
    main()
