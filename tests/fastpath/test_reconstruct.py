"""The kernels' reconstruction against its plain twin, in a kernel that does nothing else."""

from __future__ import annotations

import functools
from typing import Any

import numpy as np
import numpy.typing as npt
import pyopencl as cl
import pytest
from lightgauge.fastpath.device import OpenDevice, open_device
from lightgauge.fastpath.programs import source
from lightgauge.reference.config_base import Reconstruction
from lightgauge.reference.reconstruction import RECONSTRUCTIONS, irradiance
from lightgauge.reference.sh import basis
from small_scenes import random_units

Array = npt.NDArray[Any]
OF_MEAN = 1e-5
COUNT = 20_000
KERNEL = """
kernel void reconstruct(global const float *lights, global const float *bands, global const float *weights,
                        global const float *normals, global float *out) {
    const size_t i = get_global_id(0);
    const float4 none = (float4)(0.0f);
    global const float *l = lights + 12 * i, *b = bands + 15 * i;
    const float16 light = (float16)(vload8(0, l), vload4(2, l), weights[i], none.xyz);
    const float16 band2 = (float16)(vload8(0, b), vload4(2, b), vload3(4, b), 0.0f);
    const float3 e = reconstructed(light, band2, 1.0f / weights[i], normals[3 * i], normals[3 * i + 1], normals[3 * i + 2]);
    out[3 * i] = e.x;
    out[3 * i + 1] = e.y;
    out[3 * i + 2] = e.z;
}
"""


@pytest.fixture(scope="module")
def device() -> OpenDevice:
    return open_device()


@functools.cache
def kernel(device: OpenDevice, method: Reconstruction) -> Any:
    options = [f"-DRECONSTRUCTION={RECONSTRUCTIONS.index(method)}"]
    program = cl.Program(device.context, source("reconstruct.clh") + KERNEL).build(options=options)
    return cl.Kernel(program, "reconstruct")


def on_device(device: OpenDevice, method: Reconstruction, light: Array, weight: Array, normals: Array) -> Array:
    """Irradiance (N, 3) f32 of radiance SH (N, 9, 3), premultiplied by `weight` (N,) as a texel holds it."""
    held = (light * weight[:, None, None]).astype(np.float32)
    given = [held[:, :4].transpose(0, 2, 1), held[:, 4:].transpose(0, 2, 1), weight, normals]
    flags = cl.mem_flags.READ_ONLY | cl.mem_flags.COPY_HOST_PTR
    buffers = [
        cl.Buffer(device.context, flags, hostbuf=np.ascontiguousarray(a, dtype=np.float32).reshape(-1)) for a in given
    ]
    out = np.full((len(light), 3), np.nan, dtype=np.float32)
    target = cl.Buffer(device.context, cl.mem_flags.WRITE_ONLY, out.nbytes)
    kernel(device, method)(device.queue, (len(light),), None, *buffers, target)
    cl.enqueue_copy(device.queue, out, target)
    return out


def lights(count: int, seed: int) -> Array:
    """Radiance SH (N, 9, 3) f32 of one to four small lights of random colours and an even surround: what probes hold."""
    rng = np.random.default_rng(seed)
    directions = random_units(4 * count, seed).reshape(count, 4, 3)
    power = rng.exponential(1.0, (count, 4, 3)) * (np.arange(4) < rng.integers(1, 5, (count, 1)))[..., None]
    light = np.einsum("nik,nic->nkc", basis(directions, 2), power)
    light[:, 0] += rng.choice([0.0, 0.0, 0.3, 5.0], (count, 1)) * 0.2
    light[: count // 50] *= np.array([1.0, 0.0, 1.0])  # a colour without light
    return light.astype(np.float32)


@pytest.mark.parametrize("method", RECONSTRUCTIONS)
@pytest.mark.parametrize("scale", [1.0, 3e-18, 2e15])
def test_matches_the_twin(device: OpenDevice, method: Reconstruction, scale: float) -> None:
    light, normals = lights(COUNT, 3) * np.float32(scale), random_units(COUNT, 4)
    normals[:1000] = light[:1000, [3, 1, 2], 0] / np.linalg.norm(light[:1000, [3, 1, 2], 0], axis=1, keepdims=True)
    normals[500:1000] *= -1.0  # away from all light: q = 0
    normals = normals.astype(np.float32)
    weight = np.random.default_rng(5).uniform(0.01, 1.0, COUNT).astype(np.float32)
    expected = irradiance(method, light, normals)
    mean = 0.886227 * light[:, 0].max(axis=1, keepdims=True)
    got = on_device(device, method, light, weight, normals)
    error = np.abs(got - expected) / mean
    print(method, scale, error.max())
    assert error.max() < OF_MEAN
    assert expected.std() > 0.1 * mean.mean()


@pytest.mark.parametrize("method", RECONSTRUCTIONS)
def test_no_light(device: OpenDevice, method: Reconstruction) -> None:
    """Nothing, less than nothing, and light without a direction."""
    light = np.zeros((4, 9, 3), dtype=np.float32)
    light[1, 0], light[1, 3] = -1.0, 0.5
    light[2, 0] = 1.0
    light[3, 1] = 1.0
    normals = np.tile(np.array([1.0, 0.0, 0.0], dtype=np.float32), (4, 1))
    expected = irradiance(method, light, normals)
    got = on_device(device, method, light, np.ones(4, dtype=np.float32), normals)
    np.testing.assert_allclose(got, expected, atol=1e-6)
    np.testing.assert_array_equal(got[0], 0.0)
    np.testing.assert_allclose(got[2], 0.8862269, rtol=1e-6)
    if method in ("clamped", "nonlinear", "zh3"):
        np.testing.assert_array_equal(got[1], 0.0)


def test_bad_method_does_not_build(device: OpenDevice) -> None:
    with pytest.raises(cl.RuntimeError):
        cl.Program(device.context, source("reconstruct.clh") + KERNEL).build(options=["-DRECONSTRUCTION=5"])
