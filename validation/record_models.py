"""What `results.json` holds: one model a table. Reading, checking and writing it is record.py's."""

from __future__ import annotations

from typing import Annotated, Any, Literal

from pydantic import BaseModel, ConfigDict, Field

JsonObject = dict[str, Any]
Count = Annotated[int, Field(ge=0)]
NonNegative = Annotated[float, Field(ge=0.0)]
Triple = Annotated[list[float], Field(min_length=3, max_length=3)]


class Open(BaseModel):
    """Base of the record's models: strict types, no NaN or infinity, further keys allowed (readers ignore them)."""

    model_config = ConfigDict(strict=True, extra="allow", allow_inf_nan=False)


class Metric(Open):
    """One number. se: standard error, absent where none applies (a maximum). n: samples behind it. noise: what the reference's noise
    alone would read. interval: of 95 %, where it is not value ± 1.96 se."""

    value: float
    se: NonNegative | None = None
    n: Count
    unit: str = ""
    below_noise: bool = False
    noise: float | None = None
    interval: Annotated[list[float], Field(min_length=2, max_length=2)] | None = None


class LevelCount(Open):
    """Probes of one octree level (0 the coarsest). voxel_m: voxel size, m. culled: of the virtual ones, those that were real."""

    level: Count
    voxel_m: NonNegative | None = None
    voxels: Count = 0
    real: Count = 0
    virtual: Count = 0
    culled: Count = 0
    invalid: Count = 0
    tiles: Count = 0


class WorstPlace(Open):
    """A point with large error. position: m. ours, truth: irradiance, W·m⁻². relative: signed."""

    set: str
    position: Triple
    ours: Triple
    truth: Triple
    relative: float


class BiasedBlock(Open):
    """Neighbouring camera points whose mean light is wrong beyond chance. position: of one in the middle, m; size_m: diagonal of the
    block. ours, truth: mean irradiance, W·m⁻². relative: signed difference over the scene's mean; noise: its standard error. p: of
    Welch's test, before Holm's correction."""

    position: Triple
    size_m: NonNegative
    points: Count
    ours: Triple
    truth: Triple
    relative: float
    noise: NonNegative
    p: NonNegative


class PlaceProbe(Open):
    """A real probe that a place is lit by. position: m. weight: its share there."""

    position: Triple
    weight: NonNegative


class Place(Open):
    """Where a metric is worst. position: m. value: the metric there (of unlit_share and culled_raise: light missing or changed there,
    over the mean). level, voxel_m: of the voxel that answers there; level 0: none does. probes: the heaviest first, up to eight."""

    metric: str
    position: Triple
    value: float
    level: Count
    voxel_m: NonNegative | None = None
    probes: list[PlaceProbe] = []


class ImageSettings(Open):
    """How a camera's picture was scored (metrics `flip_camera_NAME` …): FLIP's exposures, base-2 exponents chosen from the truth alone,
    and paths a pixel of the truth."""

    camera: str
    exposure_start: float
    exposure_stop: float
    exposures: Count
    pixels_per_degree: NonNegative
    paths_per_pixel: Count


class VoxelMap(Open):
    """The finest voxel in each column of a placement, from above (x to the right, z down) or the side (x, y up), or in the
    section at z = at_m (x, y up). voxel_m, cells_by_level: a voxel's edge by level, m and cells. bitmap, octree: base64 of
    zlib of height × width bytes, 1 + level or 0. outline: the same of bits, eight a byte, scale × scale of them a cell:
    where the scene has edges."""

    view: Literal["above", "side", "section"]
    at_m: float | None = None
    voxel_m: list[NonNegative]
    cells_by_level: list[Count]
    width: Count
    height: Count
    scale: Count
    bitmap: str
    octree: str
    outline: str


class SweepRow(Open):
    """One value of one knob, all else as the scene has it; current: the scene's own value. set: points, or `camera NAME`. missed,
    false_alarms: shares of places in the solid that this tolerance calls valid, and of free ones that it calls invalid."""

    knob: Literal["normal_offset", "backface_tolerance", "copies"]
    value: float
    set: str
    current: bool
    relrmse: Metric
    unlit_share: NonNegative = 0.0
    invalid_share: NonNegative | None = None
    fallback_share: NonNegative | None = None
    missed: NonNegative | None = None
    false_alarms: NonNegative | None = None


class OffsetGain(Open):
    """The best of the offsets swept, finest voxels, and how much lower its relRMSE is than that of no offset."""

    set: str
    best: NonNegative
    gain: Metric | None = None


class LodRow(Open):
    """A level's complete set of probes, and the error where everything is sampled at that level."""

    level: Count
    voxel_m: NonNegative
    probes: Count
    set: str
    relrmse: Metric | None = None
    unlit_share: NonNegative = 0.0


class GridError(Open):
    """A uniform grid measured beside the placement: means over random shifts of its lattice at the best sample offset."""

    voxel_m: NonNegative
    probes: Count
    valid_probes: Count
    relrmse: NonNegative
    placement_error: NonNegative


class FlightLevel(Open):
    """A level during a flight (0: no light). points: that it answered. relrmse, relrmse_finest: against truth there, in flight
    and with the finest level everywhere; off_finest: the one against the other."""

    level: Count
    voxel_m: NonNegative | None = None
    points: Count
    relrmse: Metric | None = None
    relrmse_finest: Metric | None = None
    off_finest: Metric | None = None


class Flight(Open):
    """A flight through streamed tiles (validation/flight). budget: tiles in the cache; tiles: of the world. blend: share of each
    level's reach over which the columns and figures with `_blend` mix two. summary: figures by name. per_frame: columns of
    `frames` numbers, among them wanted, resident, loaded, evicted, missing, hits, bytes, shifted_lods, host_ms, device_ms,
    sample_ns, wrong_reads, fell, unexplained, pop. viewer: positions, m, by frame. places: x, y, z, m, of the watched points and
    the worst pop of each, ascending."""

    path: str
    frames: Count
    budget: Count
    tiles: Count
    levels: Count
    lod_distance_m: NonNegative
    blend: NonNegative
    storage: str
    points: Count
    cache_bytes: Count
    summary: dict[str, Metric]
    per_frame: dict[str, list[float]]
    viewer: list[Triple]
    places: list[Annotated[list[float], Field(min_length=4, max_length=4)]]
    levels_used: list[FlightLevel] = []
    notes: list[str] = []


class SceneResult(Open):
    """What was found out about one scene; `error` says why where `status` is failed. leaks: walls, leaking places and the edit
    that stops them (validation/leaks/explain.py). fly: a flight, None where none was asked for. sampling: storage, layout and device
    that it was sampled with. waterfall: the error taken apart, link by link (validation/waterfall/record.py); pixel: one pixel
    explained (validation/explain/pixel.py); both empty where not asked for."""

    name: str
    status: Literal["ok", "failed"]
    error: str = ""
    metrics: dict[str, Metric] = {}
    cost: dict[str, float | str | bool | None] = {}
    sampling: dict[Literal["storage", "layout", "device"], str] = {}
    counts_by_level: list[LevelCount] = []
    maps: list[VoxelMap] = []
    lods: list[LodRow] = []
    sweeps: list[SweepRow] = []
    offset_gains: list[OffsetGain] = []
    grids: list[GridError] = []
    worst: list[WorstPlace] = []
    biased: list[BiasedBlock] = []
    places: list[Place] = []
    images: list[ImageSettings] = []
    leaks: JsonObject = {}
    waterfall: JsonObject = {}
    pixel: JsonObject = {}
    fly: Flight | None = None
    verdicts: list[Any] = []
    files: JsonObject = {}
    notes: list[str] = []


class ChartValue(Open):
    """A charted error, relative, with its standard error where it has one."""

    value: float
    se: NonNegative | None = None
    n: Count = 0


class ChartRow(Open):
    """One setting of one method. bytes: bake. sample_ns: device time of a sample. leak, overdark: at the points of cameras
    and surfaces, for a scene with dark boxes. remark: what else there is to know. pareto: on the front of this cost."""

    method: str
    setting: str
    probes: Count
    bytes: Count
    update_ms: NonNegative
    sample_ns: NonNegative | None = None
    relrmse: ChartValue
    leak: ChartValue | None = None
    overdark: ChartValue | None = None
    remark: str = ""
    pareto: dict[Literal["probes", "bytes", "update_ms", "sample_ns"], bool] = {}


class Chart(Open):
    """Speed against accuracy for one scene. floor: error of exact SH at the point. noise: that of the reference."""

    scene: str
    rows: list[ChartRow]
    floor: ChartValue | None = None
    noise: ChartValue | None = None


class Results(Open):
    """`results.json`: what a verb that measures writes."""

    schema_: Literal[1] = Field(alias="schema")
    provenance: JsonObject
    scenes: list[SceneResult]
    charts: list[Chart] = []
