"""Kernel sources and built programs."""

from __future__ import annotations

import pytest
from lightgauge.fastpath import programs
from lightgauge.fastpath.device import OpenDevice, open_device
from lightgauge.fastpath.layout import build_options
from lightgauge.reference.errors import EnvironmentLacks


@pytest.fixture(scope="module")
def device() -> OpenDevice:
    return open_device()


def test_headers_are_put_in_place() -> None:
    text = programs.source("sampler.cl")
    assert '#include "' not in text and "COMMON_CLH" in text and "reconstructed" in text


def test_built_once_per_device_and_options(device: OpenDevice) -> None:
    options = [*build_options("half", "packed"), "-DCOMPONENTS=4"]
    first = programs.program(device, "tile_cache.cl", options)
    assert programs.program(device, "tile_cache.cl", options) is first
    assert (
        programs.program(device, "tile_cache.cl", [*build_options("float32", "packed"), "-DCOMPONENTS=4"]) is not first
    )
    assert programs.program(open_device(), "tile_cache.cl", options) is not first


def test_a_device_that_cannot_build_is_an_environment_that_lacks(device: OpenDevice) -> None:
    with pytest.raises(EnvironmentLacks, match=r"cannot build sampler\.cl"):
        programs.program(device, "sampler.cl", ["-DRECONSTRUCTION=17"])
