"""What OpenCL devices can do, on what this machine has."""

from __future__ import annotations

import os
import subprocess
import sys
from typing import Any

import numpy as np
import pytest
from lightgauge.fastpath import device, probe
from lightgauge.reference.errors import EnvironmentLacks


def test_every_device_here_passes() -> None:
    devices = device.list_devices()
    assert devices, "no OpenCL device on this machine"
    for found in devices:
        for _ in range(5):  # a sampler released too early fails now and then, not always
            probed = probe.probe(found)
            assert probed.ok, probed
        np.testing.assert_allclose(probed.expected, [1.25, 1.75, 1.0, 1.1875])


def test_isolated_says_the_same() -> None:
    found = device.list_devices()[0]
    assert probe.probe_isolated(found) == probe.probe(found)


def test_a_wrong_read_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(probe, "_read", lambda _: np.zeros(4, np.float32))
    probed = probe.probe(device.list_devices()[0])
    assert not probed.ok and "wrong" in probed.reason


def test_a_device_without_images_is_told() -> None:
    plain = device.DeviceInfo(0, "p", "n", "1", "1", "cpu", 1, 1, (0, 0, 0), False)
    assert probe.probe(plain).reason == "no 3D images"


def test_an_abort_of_the_driver_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    real = subprocess.run

    def aborting(_: list[str], **options: Any) -> subprocess.CompletedProcess[str]:
        code = "import os, sys; print('linker failed', file=sys.stderr); sys.stderr.flush(); os.abort()"
        return real([sys.executable, "-c", code], **options)

    monkeypatch.setattr(probe.subprocess, "run", aborting)
    probed = probe.probe_isolated(device.list_devices()[0])
    assert not probed.ok and "linker failed" in probed.reason


def test_what_the_child_lacks_is_raised(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PATH", os.devnull)  # no linker there
    found = device.list_devices()[0]
    if "Portable" not in found.platform:
        pytest.skip("needs PoCL")
    with pytest.raises(EnvironmentLacks, match="apt-get install -y gcc libc6-dev"):
        probe.probe_isolated(found)
