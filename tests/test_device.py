"""OpenCL devices: choice, and the probe on what this machine has."""

from __future__ import annotations

import pytest
from lightgauge.fastpath import device
from lightgauge.reference.errors import EnvironmentLacks


def info(index: int, name: str, kind: device.Kind) -> device.DeviceInfo:
    return device.DeviceInfo(index, "Some Platform", name, "3.0", "1", kind, 1, 1 << 30, (64, 64, 64), False)


DEVICES = (info(0, "cpu 1", "cpu"), info(1, "gpu A", "gpu"), info(2, "gpu B", "gpu"))


@pytest.mark.parametrize(("wanted", "index"), [(None, 1), ("", 1), ("0", 0), ("1", 1), ("GPU b", 2), ("some plat", 0)])
def test_choose(wanted: str | None, index: int) -> None:
    assert device.choose(DEVICES, wanted).index == index


def test_choose_falls_back_to_the_cpu() -> None:
    assert device.choose(DEVICES[:1], None).index == 0


def test_no_device_names_the_mending_line() -> None:
    with pytest.raises(EnvironmentLacks, match=r"pip install 'pyopencl\[pocl\]'$"):
        device.choose((), None)


def test_unknown_wish_lists_what_there_is() -> None:
    with pytest.raises(EnvironmentLacks, match="0: cpu 1, 1: gpu A, 2: gpu B"):
        device.choose(DEVICES, "abacus")


def test_environment_variable(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(device.VARIABLE, "no such device")
    with pytest.raises(EnvironmentLacks, match="LIGHTGAUGE_OPENCL_DEVICE"):
        device.open_device()


def test_no_linker_is_told_before_pocl_aborts(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(device.shutil, "which", lambda _: None)
    with pytest.raises(EnvironmentLacks, match=r"with ld, missing here.*apt-get install -y gcc libc6-dev$"):
        device.require_linker()
    monkeypatch.setattr(device, "glob", lambda _: [])
    with pytest.raises(EnvironmentLacks, match="ld, libgcc, libc"):
        device.require_linker()


@pytest.mark.parametrize(
    ("mine", "chosen", "left"),
    [
        ({0, 1}, {}, "1"),
        ({0, 1}, {device.POCL_PINNED: "0"}, "0"),
        ({0, 1}, {device.POCL_THREADS[1]: "4"}, None),
        ({1}, {}, None),
        ({2, 3}, {}, None),
    ],
    ids=["all cores", "user's choice", "user's threads", "held to one core", "cores that are numbered otherwise"],
)
def test_threads_are_pinned_where_all_cores_are_ours(
    monkeypatch: pytest.MonkeyPatch, mine: set[int], chosen: dict[str, str], left: str | None
) -> None:
    monkeypatch.setattr(device.sys, "platform", "linux")
    monkeypatch.setattr(device.os, "cpu_count", lambda: 2)
    monkeypatch.setattr(device.os, "sched_getaffinity", lambda _: mine, raising=False)
    monkeypatch.setattr(device.os, "environ", chosen)
    device.pin_threads()
    assert device.os.environ.get(device.POCL_PINNED) == left


def test_listing_devices_pins_first(monkeypatch: pytest.MonkeyPatch) -> None:
    called: list[bool] = []
    monkeypatch.setattr(device, "pin_threads", lambda: called.append(True))
    device.list_devices()
    assert called
