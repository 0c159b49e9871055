"""The OpenCL rows against SciPy's CSR product and the Dr.Jit gather, and relighting against the plain iteration."""

from __future__ import annotations

import dataclasses
import gc
import tracemalloc
from pathlib import Path
from typing import Any

import numpy as np
import pyopencl as cl
import pytest
from lightgauge.fastpath.device import OpenDevice, open_device
from lightgauge.fastpath.rows import Relight, Rows
from lightgauge.reference.datatypes import F32, F64, I32, I64
from lightgauge.reference.errors import EnvironmentLacks
from lightgauge.reference.transport.gather import gather, upload
from scipy import sparse

RELATIVE = 1e-5
LANES = (1, 2, 32)  # one per row on CPUs, 32 on GPUs: the same source must be right for both


@pytest.fixture(scope="module")
def device() -> OpenDevice:
    return open_device()


@dataclasses.dataclass(frozen=True, eq=False)
class Made:
    """Rows made for a test: of FormFactors, what a product reads."""

    indptr: I64
    columns: I32
    values: F32
    columns_count: int

    @property
    def rows(self) -> int:
        return len(self.indptr) - 1

    def matrix(self, k: int) -> sparse.csr_array:
        values = self.values[:, k].astype(np.float64)
        return sparse.csr_array((values, self.columns, self.indptr), shape=(self.rows, self.columns_count))


def lengths(count: int, columns: int, rng: np.random.Generator) -> np.ndarray:
    """Every length from 0 to 40, so each remainder of the kernel's strides, then random ones, then a full row."""
    made = np.concatenate([np.arange(41), rng.integers(0, min(columns, 400) + 1, max(count - 41, 0))])[:count]
    made[-1] = columns
    return np.minimum(made, columns)


def random_rows(count: int, columns_count: int, k: int, seed: int) -> Made:
    """Positive values, so that relative differences mean something; rows of patches sum to less than one."""
    rng = np.random.default_rng(seed)
    n = lengths(count, columns_count, rng)
    columns = [np.sort(rng.choice(columns_count, m, replace=False)) for m in n]
    indptr = np.concatenate([[0], np.cumsum(n)]).astype(np.int64)
    values = rng.random((indptr[-1], k)).astype(np.float32) / np.repeat(np.maximum(n, 1), n)[:, None]
    flat = np.concatenate(columns).astype(np.int32) if len(columns) else np.zeros(0, np.int32)
    return Made(indptr, flat, values.astype(np.float32), columns_count)


def on_device(device: OpenDevice, made: Made, lanes: int | None = None) -> Rows:
    return Rows(device, made.indptr, made.columns, made.values, made.columns_count, lanes)


def light_of(columns: int, seed: int) -> F32:
    return np.random.default_rng(seed).random((columns, 3), dtype=np.float32)


def product(made: Made, light: F32 | F64) -> F64:
    """The plain twin, (R, K, 3) in float64."""
    parts = [made.matrix(n) @ light.astype(np.float64) for n in range(made.values.shape[1])]
    return np.stack(parts, axis=1)


@pytest.mark.parametrize("lanes", LANES)
@pytest.mark.parametrize("k", [1, 4])
@pytest.mark.parametrize("count", [1, 2, 41, 2000])
def test_equals_scipy_and_the_twin(device: OpenDevice, count: int, k: int, lanes: int) -> None:
    made = random_rows(count, 300, k, count + k)
    light = light_of(300, 3)
    got = on_device(device, made, lanes)(light)
    assert got.shape == (count, k, 3) and got.dtype == np.float32
    np.testing.assert_allclose(got, product(made, light), rtol=RELATIVE, atol=0)
    np.testing.assert_allclose(got, gather(upload(made), light), rtol=RELATIVE, atol=0)


@pytest.mark.parametrize("lanes", LANES)
def test_signed_values(device: OpenDevice, lanes: int) -> None:
    """Probe rows change sign: the error is then relative to the sum of magnitudes."""
    made = random_rows(500, 200, 4, 5)
    signed = dataclasses.replace(made, values=made.values * np.where(np.arange(4) > 0, -1, 1).astype(np.float32))
    signed.values[::3] *= -1
    light = light_of(200, 4)
    got = on_device(device, signed, lanes)(light)
    assert (np.abs(got - product(signed, light)) <= RELATIVE * product(made, light)).all()


@pytest.mark.parametrize("k", [1, 4])
def test_a_long_row(device: OpenDevice, k: int) -> None:
    """100,000 non-zeros of one row lose nothing to rounding that partial sums would not forgive."""
    rng = np.random.default_rng(6)
    values = rng.random((100_000, k), dtype=np.float32)
    rows = Rows(device, np.int64([0, 100_000]), np.arange(100_000, dtype=np.int32), values, 100_000)
    light = light_of(100_000, 7)
    expected = np.einsum("jk,jc->kc", values.astype(np.float64), light.astype(np.float64))
    np.testing.assert_allclose(rows(light)[0], expected, rtol=RELATIVE)


@pytest.mark.parametrize("k", [1, 4])
def test_empty_rows_and_no_rows(device: OpenDevice, k: int) -> None:
    none, values = np.zeros(0, np.int32), np.zeros((0, k), np.float32)
    assert Rows(device, np.zeros(1, np.int64), none, values, 7)(light_of(7, 0)).shape == (0, k, 3)
    np.testing.assert_array_equal(
        Rows(device, np.zeros(4, np.int64), none, values, 7)(light_of(7, 0)), np.zeros((3, k, 3))
    )
    one = Rows(device, np.int64([0, 0, 1, 1]), np.int32([4]), np.full((1, k), 2.0, np.float32), 7)
    expected = np.zeros((3, k, 3), np.float32)
    expected[1] = 2.0 * light_of(7, 0)[4]
    np.testing.assert_array_equal(one(light_of(7, 0)), expected)


@pytest.mark.parametrize("k", [1, 4])
def test_one_column(device: OpenDevice, k: int) -> None:
    values = np.arange(1, 3 * k + 1, dtype=np.float32).reshape(3, k)
    rows = Rows(device, np.arange(4, dtype=np.int64), np.zeros(3, np.int32), values, 1)
    light = np.float32([[1.0, 0.5, 0.25]])
    np.testing.assert_array_equal(rows(light), values[:, :, None] * light[None])


def test_repeats_bit_for_bit(device: OpenDevice) -> None:
    for k in (1, 4):
        made = random_rows(3000, 400, k, 8)
        light = light_of(400, 9)
        rows = on_device(device, made)
        first = rows(light)
        for _ in range(20):
            np.testing.assert_array_equal(rows(light), first)
        np.testing.assert_array_equal(on_device(open_device(), made)(light), first)


def test_a_row_does_not_depend_on_its_neighbours(device: OpenDevice) -> None:
    """So neither on how rows are shared out to threads: each alone gives the bits it gives among 300."""
    made = random_rows(300, 100, 1, 10)
    light = light_of(100, 11)
    together = on_device(device, made)(light)
    for row in (0, 7, 40, 299):
        a, b = made.indptr[row : row + 2]
        alone = Rows(device, np.int64([0, b - a]), made.columns[a:b], made.values[a:b], 100)
        np.testing.assert_array_equal(alone(light)[0], together[row])


def wrong(**changes: Any) -> dict[str, Any]:
    good = {
        "indptr": np.int64([0, 1, 2]),
        "columns": np.int32([0, 2]),
        "values": np.ones((2, 1), np.float32),
        "columns_count": 3,
    }
    return good | changes


@pytest.mark.parametrize(
    ("given", "match"),
    [
        (wrong(indptr=np.int32([0, 1, 2])), "indptr"),
        (wrong(indptr=np.int64([[0, 1, 2]])), "indptr"),
        (wrong(indptr=np.zeros(0, np.int64)), "indptr"),
        (wrong(indptr=np.int64([0, 1, 3])), "indptr must rise"),
        (wrong(indptr=np.int64([1, 1, 2])), "indptr must rise"),
        (wrong(indptr=np.int64([0, 2, 1, 2])), "indptr must rise"),
        (wrong(indptr=np.int64([0, -1, 2])), "indptr must rise"),
        (wrong(columns=np.int64([0, 2])), "columns"),
        (wrong(columns=np.int32([[0, 2]])), "columns"),
        (wrong(columns=np.int32([0, 3])), r"columns must lie in 0 … 2, got 0 … 3"),
        (wrong(columns=np.int32([-1, 2])), "columns must lie in"),
        (wrong(columns_count=0), "columns must lie in"),
        (wrong(values=np.ones((2, 1))), "values"),
        (wrong(values=np.ones(2, np.float32)), "values"),
        (wrong(values=np.ones((2, 3), np.float32)), "values"),
        (wrong(values=np.ones((3, 1), np.float32)), "values"),
        (wrong(lanes=0), "lanes"),
        (wrong(lanes=3), "lanes"),
    ],
)
def test_what_rows_refuse(device: OpenDevice, given: dict[str, Any], match: str) -> None:
    with pytest.raises(ValueError, match=match):
        Rows(device, **given)


def test_wrong_light_and_small_buffers(device: OpenDevice) -> None:
    rows = Rows(device, **wrong())
    for light in (
        np.zeros((3, 3)),
        np.zeros((2, 3), np.float32),
        np.zeros((3, 4), np.float32),
        np.zeros(9, np.float32),
    ):
        with pytest.raises(ValueError, match=r"expected light \(3, 3\) float32"):
            rows(light)
    flags = cl.mem_flags.READ_WRITE
    small, large = cl.Buffer(device.context, flags, 16), cl.Buffer(device.context, flags, 64)
    with pytest.raises(ValueError, match="light must hold 48 bytes"):
        rows.gather(small, large)
    with pytest.raises(ValueError, match="out must hold 24 bytes"):
        rows.gather(large, small)
    with pytest.raises(ValueError, match="must hold 32 bytes"):
        rows.bounce(large, large, small, large, large)
    with pytest.raises(ValueError, match="1 component"):
        Rows(device, **wrong(values=np.ones((2, 4), np.float32))).bounce(large, large, large, large, large)


def test_a_matrix_that_does_not_fit_names_the_way_out(device: OpenDevice, monkeypatch: pytest.MonkeyPatch) -> None:
    class Small:
        max_mem_alloc_size = 8

    class Context:
        devices = (Small(),)

    with pytest.raises(EnvironmentLacks, match=r"8 bytes in one array, 24 are needed.*radiosity\.patch_size"):
        Rows(dataclasses.replace(device, context=Context()), **wrong())


P, S = 400, 24


@dataclasses.dataclass(frozen=True, eq=False)
class Bake:
    """A random bake that converges, with its plain matrices."""

    patch: Made
    receivers: dict[str, Made]
    albedo: F32
    exitance: F32
    direct: F32
    sky: F32

    def relight(self, device: OpenDevice, lanes: int | None = None) -> Relight:
        rows = {name: on_device(device, made, lanes) for name, made in self.receivers.items()}
        return Relight(device, on_device(device, self.patch, lanes), rows, self.albedo, self.exitance)

    def light(self, b: F64, sky: F64) -> F64:
        return np.concatenate([b, sky, np.zeros((1, 3))])

    def bounced(self, b: F64) -> F64:
        incident = self.direct.astype(np.float64) + self.patch.matrix(0) @ self.light(b, self.sky.astype(np.float64))
        return self.exitance + self.albedo.astype(np.float64) * incident


@pytest.fixture(scope="module")
def bake() -> Bake:
    rng = np.random.default_rng(20)
    names = {"probes": (300, 4), "lumels": (500, 1), "texels": (60, 1), "nobody": (0, 4)}
    receivers = {n: random_rows(r, P + S + 1, k, 21 + i) for i, (n, (r, k)) in enumerate(names.items()) if r}
    receivers["nobody"] = Made(np.zeros(1, np.int64), np.zeros(0, np.int32), np.zeros((0, 4), np.float32), P + S + 1)
    albedo, exitance, direct = (rng.random((P, 3), dtype=np.float32) for _ in range(3))
    exitance[: P // 2] = 0
    return Bake(
        random_rows(P, P + S + 1, 1, 30), receivers, albedo * np.float32(0.9), exitance, direct, light_of(S, 31) + 1
    )


def close(got: F32, expected: F64) -> None:
    np.testing.assert_allclose(got, expected, rtol=RELATIVE, atol=0)


@pytest.mark.parametrize("lanes", LANES)
@pytest.mark.parametrize("sky_seen", [True, False])
def test_a_frame_is_bounces_and_products(device: OpenDevice, bake: Bake, sky_seen: bool, lanes: int) -> None:
    """One bounce, then three more with the radiosity carried over; receivers see a sky of their own."""
    relight, b = bake.relight(device, lanes), np.zeros((P, 3))
    seen = bake.sky + np.float32(2) if sky_seen else np.zeros_like(bake.sky)
    for bounces in (1, 3, 1):
        found = relight.frame(bake.direct, bake.sky, seen, bounces)
        for _ in range(bounces):
            b = bake.bounced(b)
        close(found["patches"], b)
        light = bake.light(b, seen.astype(np.float64))
        assert set(found) == {"patches", *bake.receivers}
        for name, made in bake.receivers.items():
            assert found[name].shape == (made.rows, made.values.shape[1], 3)
            for k in range(made.values.shape[1]):
                close(found[name][:, k], made.matrix(k) @ light)


def test_temporal_feedback_reaches_the_closed_form(device: OpenDevice, bake: Bake) -> None:
    """One bounce per frame under fixed light ends at (I - ρF)⁻¹ (M + ρ (E + F_sky L))."""
    relight = bake.relight(device)
    form = bake.patch.matrix(0).toarray()
    source = bake.exitance + bake.albedo * (bake.direct + form[:, P : P + S] @ bake.sky.astype(np.float64))
    expected = np.stack(
        [
            np.linalg.solve(np.eye(P) - bake.albedo[:, c, None].astype(np.float64) * form[:, :P], source[:, c])
            for c in range(3)
        ],
        axis=1,
    )
    for _ in range(80):
        found = relight.frame(bake.direct, bake.sky, bake.sky)
    close(found["patches"], expected)
    relight.reset()
    once = bake.bounced(np.zeros((P, 3)))
    close(relight.frame(bake.direct, bake.sky, bake.sky)["patches"], once)
    relight.reset()
    close(relight.frame(bake.direct, bake.sky, bake.sky, 80)["patches"], expected)


def test_new_light_replaces_the_old(device: OpenDevice, bake: Bake) -> None:
    relight = bake.relight(device)
    relight.frame(bake.direct, bake.sky, bake.sky, 3)
    black = np.zeros_like(bake.direct), np.zeros_like(bake.sky), np.zeros_like(bake.sky)
    unlit = relight.frame(*black, 200)["patches"].copy()
    relight.reset()
    np.testing.assert_allclose(relight.frame(*black, 200)["patches"], unlit, rtol=RELATIVE)
    dark = dataclasses.replace(bake, exitance=np.zeros_like(bake.exitance)).relight(device)
    dark.frame(bake.direct, bake.sky, bake.sky, 3)
    assert not any(a.any() for a in dark.frame(*black, 500).values())


def test_frames_repeat_bit_for_bit(device: OpenDevice, bake: Bake) -> None:
    relight = bake.relight(device)
    first = {name: a.copy() for name, a in relight.frame(bake.direct, bake.sky, bake.sky, 5).items()}
    for _ in range(10):
        relight.reset()
        for name, a in relight.frame(bake.direct, bake.sky, bake.sky, 5).items():
            np.testing.assert_array_equal(a, first[name])


def resident() -> int:
    """Bytes of this process in memory."""
    return int(Path("/proc/self/statm").read_text(encoding="utf-8").split()[1]) * 4096


def test_a_thousand_frames_allocate_nothing(device: OpenDevice, bake: Bake, monkeypatch: pytest.MonkeyPatch) -> None:
    relight = bake.relight(device)
    kept = dict(relight.frame(bake.direct, bake.sky, bake.sky))
    made: list[int] = []
    real = cl.Buffer
    monkeypatch.setattr(cl, "Buffer", lambda *a, **k: made.append(1) or real(*a, **k))
    direct = bake.direct.copy()

    def frames(count: int) -> None:
        for i in range(count):
            direct[i % P] *= 0.99
            found = relight.frame(direct, bake.sky, bake.sky, 1 + i % 2)
        assert all(found[name] is a for name, a in kept.items())

    frames(300)
    gc.collect()
    before = resident()
    frames(1000)
    gc.collect()
    assert resident() - before < 1 << 20  # a leak of one event per frame is more
    tracemalloc.start()
    try:
        frames(20)
        tracemalloc.reset_peak()
        start = tracemalloc.get_traced_memory()[0]
        frames(1000)
        current, peak = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert current - start < 1024 and peak - start < 4096, (current, peak, start)  # the light of one frame is 4.8 kB
    assert not made


def test_a_frame_waits_once(device: OpenDevice, bake: Bake, monkeypatch: pytest.MonkeyPatch) -> None:
    """Each wait lets the device's threads fall asleep: five more took a quarter of a frame of the house."""
    relight = bake.relight(device)
    relight.frame(bake.direct, bake.sky, bake.sky)
    waits: list[bool] = []
    real = cl.enqueue_copy

    def enqueue_copy(queue: Any, target: Any, source: Any, **options: Any) -> Any:
        waits.append(options.get("is_blocking", True))
        return real(queue, target, source, **options)

    monkeypatch.setattr(cl, "enqueue_copy", enqueue_copy)
    relight.frame(bake.direct, bake.sky, bake.sky, 3)
    assert waits.count(True) == 1 and waits[-1] and len(waits) == 5 + sum(m.rows > 0 for m in bake.receivers.values())


def test_a_frame_broken_off_leaves_no_trace(device: OpenDevice, bake: Bake, monkeypatch: pytest.MonkeyPatch) -> None:
    """A launch fails after copies were enqueued: they still read what the next frame stages, which must wait for them."""
    relight = bake.relight(device)

    def failing(*_: Any) -> None:
        raise cl.MemoryError("no memory")

    with monkeypatch.context() as patch:
        patch.setattr(relight._receivers["probes"], "gather", failing)
        with pytest.raises(cl.MemoryError):
            relight.frame(bake.direct * np.float32(2), bake.sky, bake.sky)
    relight.reset()
    close(relight.frame(bake.direct, bake.sky, bake.sky)["patches"], bake.bounced(np.zeros((P, 3))))


def test_results_are_read_only(device: OpenDevice, bake: Bake) -> None:
    found = bake.relight(device).frame(bake.direct, bake.sky, bake.sky)
    for array in found.values():
        assert not array.flags.writeable
    with pytest.raises(TypeError):
        found["probes"] = np.zeros(3)  # type: ignore[index]


def test_what_relight_refuses(device: OpenDevice, bake: Bake) -> None:
    patch = on_device(device, bake.patch)
    probes = on_device(device, bake.receivers["probes"])
    other = Rows(device, **wrong())
    albedo, exitance = bake.albedo, bake.exitance
    nan = np.where(np.arange(P)[:, None] == 3, np.float32(np.nan), exitance)
    none = Rows(device, np.zeros(1, np.int64), np.zeros(0, np.int32), np.zeros((0, 1), np.float32), 5)
    for arguments, match in (
        ((probes, {}, albedo, exitance), "1 component"),
        ((none, {}, np.zeros((0, 3), np.float32), np.zeros((0, 3), np.float32)), "1 or more"),
        ((patch, {"patches": probes}, albedo, exitance), "another name"),
        ((patch, {"probes": other}, albedo, exitance), f"{P + S + 1} columns"),
        ((patch, {}, albedo[1:], exitance), "albedo"),
        ((patch, {}, albedo, exitance.astype(np.float64)), "exitance"),
        ((patch, {}, albedo + np.float32(1), exitance), "albedo must be at least 0 and below 1"),
        ((patch, {}, -albedo, exitance), "albedo must be"),
        ((patch, {}, albedo, nan), "exitance must be"),
    ):
        with pytest.raises(ValueError, match=match):
            Relight(device, *arguments)
    with pytest.raises(ValueError, match="on the device"):
        Relight(open_device(), patch, {}, albedo, exitance)


@pytest.mark.parametrize("value", [np.nan, np.inf])
def test_what_a_frame_refuses_leaves_it_usable(device: OpenDevice, bake: Bake, value: float) -> None:
    relight, expected = bake.relight(device), bake.bounced(np.zeros((P, 3)))
    bad = bake.direct.copy()
    bad[17, 1] = value
    bad_sky = bake.sky.copy()
    bad_sky[-1, 2] = value
    for direct, sky, bounces, match in (
        (bad, bake.sky, 1, "direct must be finite"),
        (bake.direct, bad_sky, 1, "sky must be finite"),
        (bake.direct[1:], bake.sky, 1, "direct"),
        (bake.direct.astype(np.float64), bake.sky, 1, "direct"),
        (bake.direct, bake.sky[:-1], 1, "sky"),
        (bake.direct, bake.sky, 0, "bounces"),
    ):
        with pytest.raises(ValueError, match=match):
            relight.frame(direct, sky, bake.sky, bounces)
    close(relight.frame(bake.direct, bake.sky, bake.sky)["patches"], expected)


def test_no_sky_bins(device: OpenDevice) -> None:
    """Patches and the absorbing column only: a closed box without a sky."""
    rows = Rows(device, np.int64([0, 1, 2]), np.int32([1, 0]), np.full((2, 1), 0.5, np.float32), 3)
    half, one = np.full((2, 3), 0.5, np.float32), np.ones((2, 3), np.float32)
    found = Relight(device, rows, {"again": rows}, half, np.zeros_like(one)).frame(
        one, np.zeros((0, 3), np.float32), np.zeros((0, 3), np.float32), 60
    )
    np.testing.assert_allclose(found["patches"], np.full((2, 3), 0.5 / 0.75), rtol=1e-6)
    np.testing.assert_allclose(found["again"], np.full((2, 1, 3), 0.25 / 0.75), rtol=1e-6)
