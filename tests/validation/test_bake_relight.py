"""`bake` and `relight` as a user types them: the same light as the pipeline, clear refusals, nothing half-written."""

from __future__ import annotations

import dataclasses
import json
import tracemalloc
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from lightgauge.fastpath.device import open_device
from lightgauge.reference import pipeline
from lightgauge.reference.bake_file import read_bake, write_bake
from lightgauge.reference.config import ConstantSky
from lightgauge.reference.scene import load_scene
from lightgauge.reference.scene.lights_file import load_lights
from lightgauge.validation.bake_store import load
from lightgauge.validation.cli import main
from lightgauge.validation.relight import Relighter, relit_scene

HOUSE = Path(__file__).parents[2] / "scenes" / "house" / "scene.toml"
EVENING = HOUSE.with_name("evening.toml")
COARSE = {
    "placement": {"min_voxel": 1.0, "probe_noise": 0.2},
    "radiosity": {"patch_size": 3.0, "noise": 0.1},
    "cubemaps": {"indoors": {"size": 4}},
}
SETTINGS = [
    f"--set={table}.{key}={value}"
    for table, pairs in COARSE.items()
    if table != "cubemaps"
    for key, value in pairs.items()
]


@pytest.fixture(scope="module")
def baked(tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("bake") / "h.bake"
    assert main(["bake", str(HOUSE), "--out", str(out), "--quiet", "--set=cubemaps.indoors.size=4", *SETTINGS]) == 0
    return out


def relight(capsys: pytest.CaptureFixture[str], *arguments: object) -> dict[str, Any]:
    assert main(["relight", *(str(a) for a in arguments), "--json"]) == 0
    return json.loads(capsys.readouterr().out)


def refused(capsys: pytest.CaptureFixture[str], *arguments: object) -> str:
    """What standard error says of a command that ends with exit code 2."""
    assert main([str(a) for a in arguments]) == 2
    captured = capsys.readouterr()
    assert captured.out == ""
    return captured.err


def test_the_scenes_own_lights_give_the_pipelines_light(baked: Path, tmp_path: Path, capsys: Any) -> None:
    """Relight on OpenCL against the Dr.Jit pipeline: both stop at the tolerance, a share of the source, so they
    differ by a few times that share of the light on patches, indoors too."""
    made = relight(capsys, baked, "--out", tmp_path / "v.npz")
    assert made["scene"] == "house" and made["lights"] is None and set(made["receivers"]) > {"patches", "probes"}
    scene = load_scene(HOUSE, COARSE)
    surfaces = pipeline.bake_surfaces(scene, 0)
    light = pipeline.light_patches(scene, surfaces, 0)
    probes = pipeline.bake_probes(scene, surfaces, pipeline.place(scene, surfaces, 0), 0)
    others = pipeline.bake_receivers(scene, surfaces, 0)
    with np.load(tmp_path / "v.npz", allow_pickle=False) as values:
        expected = {
            "patch_radiosity": light.radiosity.radiosity,
            "probe_radiance_sh": pipeline.update(scene, surfaces, probes, light).coefficients,
            "lumel_irradiance": others.lumel_rows.matrix() @ light.radiosity.light,
            "cubemap_radiance.indoors": (others.cubemap_rows["indoors"].matrix() @ light.radiosity.light).reshape(
                6, 4, 4, 3
            ),
        }
        for name, array in expected.items():
            assert np.abs(values[name] - array).max() < 1e-4 * light.radiosity.radiosity.mean(), name
        np.testing.assert_array_equal(values["probe_valid"], probes.valid)
        np.testing.assert_array_equal(values["probe_light_from"], probes.light_from)


def test_evening_is_darker_and_warmer(baked: Path, tmp_path: Path, capsys: Any) -> None:
    day = relight(capsys, baked, "--out", tmp_path / "d.npz")["receivers"]["patches"]["mean"]
    evening = relight(capsys, baked, "--out", tmp_path / "e.npz", "--lights", EVENING)["receivers"]["patches"]["mean"]
    assert all(e < 0.7 * d for e, d in zip(evening, day, strict=True))
    assert evening[0] / evening[2] > 1.3 * day[0] / day[2]


def test_light_is_linear(baked: Path) -> None:
    """Twice the sun and twice the sky give twice the light; no shadow ray is traced for a colour."""
    bake = load(baked)
    relighter = Relighter(bake, open_device())
    once = {name: a.copy() for name, a in relighter(bake.scene).items()}
    traced = relighter.direct.shadow_rays
    lights = {}
    for name, light in bake.scene.settings.lights.items():
        key = "radiance" if isinstance(light, ConstantSky) else "irradiance"
        lights[name] = light.model_copy(update={key: tuple(2.0 * x for x in getattr(light, key))})
    assert bake.scene.sky is not None
    sky = dataclasses.replace(bake.scene.sky, image=2.0 * bake.scene.sky.image)
    settings = bake.scene.settings.model_copy(update={"lights": lights})
    twice = relighter(dataclasses.replace(bake.scene, settings=settings, sky=sky))
    for name, array in once.items():
        np.testing.assert_allclose(twice[name], 2.0 * array, rtol=1e-5, atol=1e-6)
    assert relighter.direct.shadow_rays == traced


def test_frames_do_not_grow(baked: Path) -> None:
    """300 frames with a changing light keep under 100 kB: less than one array of patches a hundred times over."""
    bake = load(baked)
    lighting = load_lights(
        EVENING, "house", bake.scene.settings.lights, [m.name for m in bake.scene.meshes], bake.scene.sky
    )
    scenes = [bake.scene, relit_scene(bake, lighting, "evening")]
    relighter = Relighter(bake, open_device())
    for scene in scenes * 2:
        relighter(scene)
    tracemalloc.start()
    before = tracemalloc.get_traced_memory()[0]
    for _ in range(300):
        relighter(scenes[0])
    grown = tracemalloc.get_traced_memory()[0] - before
    tracemalloc.stop()
    assert grown < 100_000, grown


def test_what_is_refused(baked: Path, tmp_path: Path, capsys: Any) -> None:
    """A bake with a wrong checksum or of another kind, lights of another scene: exit 2, which file, and the way out."""
    damaged = tmp_path / "damaged.bake"
    raw = bytearray(baked.read_bytes())
    raw[len(raw) // 2] ^= 1
    damaged.write_bytes(raw)
    said = refused(capsys, "relight", damaged)
    assert str(damaged) in said and "checksum" in said and "bake it again" in said
    raw = bytearray(baked.read_bytes())
    raw[8] += 1
    damaged.write_bytes(raw)
    assert "version 2" in refused(capsys, "relight", damaged)
    other = tmp_path / "other.toml"
    other.write_text('scene = "cornell"\n')
    said = refused(capsys, "relight", baked, "--lights", other)
    assert "cornell" in said and "house" in said
    other.write_text('scene = "house"\n[lights.lamp]\ntype = "area"\nmesh = "house_roof"\nradiance = [1, 1, 1]\n')
    assert "baked without light of its own" in refused(capsys, "relight", baked, "--lights", other)
    other.write_text('scene = "house"\n[lights.sun]\nirradiance = [nan, 1, 1]\n')
    assert "irradiance" in refused(capsys, "relight", baked, "--lights", other)
    assert "the bake itself" in refused(capsys, "relight", baked, "--out", baked)
    assert str(tmp_path / "none.bake") in refused(capsys, "relight", tmp_path / "none.bake")
    assert not list(tmp_path.glob("*.npz"))


def test_forged_numbers_are_refused_before_any_kernel_runs(baked: Path, tmp_path: Path, capsys: Any) -> None:
    """The checksum is right, the numbers point outside their tables."""
    header, arrays = read_bake(baked)
    header.pop("version")
    forged = tmp_path / "forged.bake"
    for name, value in (
        ("rows.probes.columns", 1 << 30),
        ("mesh.0.faces", 1 << 30),
        ("patches.order", -2),
        ("patches.twin", 1 << 20),
    ):
        changed = dict(arrays)
        changed[name] = arrays[name].copy()
        changed[name].flat[0] = value
        write_bake(forged, header, changed)
        said = refused(capsys, "relight", forged)
        assert "points outside" in said and str(forged) in said, (name, said)
    write_bake(forged, header, {k: v for k, v in arrays.items() if k != "lumels.mesh"})
    assert "lumels.mesh" in refused(capsys, "relight", forged)


def test_bake_refuses_what_no_light_can_settle(tmp_path: Path, capsys: Any) -> None:
    out = tmp_path / "x.bake"
    said = refused(capsys, "bake", str(HOUSE), "--out", str(out), "--set", "radiosity.rays=1000")
    assert "power of two" in said and "1024" in said
    sphere = HOUSE.parents[1] / "sphere" / "scene.toml"
    bright = [f"--set=materials.{m}.albedo=[0.9995, 0.9995, 0.9995]" for m in ("glowing", "plain")]
    said = refused(capsys, "bake", str(sphere), "--out", str(out), "--quiet", "--set=radiosity.noise=0.1", *bright)
    assert "spectral radius" in said or "albedo" in said
    assert not out.exists() and not list(tmp_path.iterdir())


def test_probes_of_order_2(tmp_path: Path, capsys: Any) -> None:
    """Nine coefficients, in three parts on the device, against the plain product of the bake's rows with the patches' light."""
    cornell = HOUSE.parents[1] / "cornell" / "scene.toml"
    coarse = [
        "placement.min_voxel=0.14",
        "placement.probe_noise=0.2",
        "radiosity.patch_size=0.1",
        "radiosity.noise=0.1",
    ]
    out = tmp_path / "c.bake"
    options = [f"--set={s}" for s in ("sampling.reconstruction=l2", "placement.cull_error=10.0", *coarse)]
    assert main(["bake", str(cornell), "--out", str(out), "--quiet", *options]) == 0
    capsys.readouterr()
    made = relight(capsys, out, "--out", tmp_path / "v.npz")
    assert set(made["receivers"]) == {"probes", "patches"}
    rows = load(out).rows["probes"]
    with np.load(tmp_path / "v.npz", allow_pickle=False) as values:
        light = np.zeros((rows.matrix().shape[1], 3))
        light[: rows.patches] = values["patch_radiosity"]
        expected = np.stack([rows.matrix(k) @ light for k in range(9)], axis=1)
        assert expected[:, 4:].std() > 0.01 * expected[:, 0].mean()
        np.testing.assert_allclose(values["probe_radiance_sh"], expected, atol=1e-5 * expected.max())
