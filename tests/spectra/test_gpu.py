"""The gpu engine: on a GPU against the direct sum, elsewhere on arrays that stand in for a device's."""

import builtins
import importlib
import sys
import threading
from types import ModuleType, SimpleNamespace
from typing import ClassVar

import numpy as np
import pytest

import mcspectra as mcs
from mcspectra.core.errors import MissingDependency, ParameterError
from mcspectra.spectra import transforms
from mcspectra.spectra.transforms import FrequencyGrid, Transform, direct_sum

SHAPES = {1: 20, 2: 9, 3: 4}  # dims: half width


class DeviceArray(np.ndarray):
    """Stands in for a CuPy array; cuFINUFFT's stand-in takes nothing else."""

    def set(self, array):
        assert type(array) is np.ndarray
        assert array.flags.c_contiguous
        assert (array.dtype, array.shape) == (self.dtype, self.shape)
        self[...] = array


class CudaError(RuntimeError):
    """Stands in for CuPy's CUDARuntimeError."""


class DirectPlan:
    """The interface of `cufinufft.Plan`, by direct summation, as strict as the original."""

    made: ClassVar = []

    def __init__(self, nufft_type, n_modes, n_trans, eps, isign, dtype, *, gpu_device_id):
        assert (nufft_type, n_trans, dtype, gpu_device_id) == (1, 1, "complex128", 0)
        self.n_modes, self.eps, self.isign = n_modes, eps, isign
        self.kept = []  # the original keeps all arrays it is given
        DirectPlan.made.append(self)

    def setpts(self, *axes):
        assert len(axes) == len(self.n_modes)
        for axis in axes:
            assert isinstance(axis, DeviceArray)
            assert axis.dtype == np.float64
            assert axis.flags.c_contiguous
        self.axes = axes
        self.kept.extend(axes)

    def execute(self, data, out):
        assert isinstance(data, DeviceArray)
        assert isinstance(out, DeviceArray)
        assert data.shape == self.axes[0].shape
        assert out.shape == self.n_modes
        assert out.flags.c_contiguous
        assert data.dtype == out.dtype == np.complex128
        waves = [np.arange(size) - size // 2 for size in self.n_modes]
        letters = "abc"[: len(waves)]
        phases = [
            np.exp(1j * self.isign * np.outer(x, m)) for x, m in zip(self.axes, waves, strict=True)
        ]
        operands = ",".join(f"k{letter}" for letter in letters)
        out[...] = np.einsum(f"k,{operands}->{letters}", data, *phases)


def _fake_cupy(devices=1):
    def count():
        if isinstance(devices, Exception):
            raise devices
        return devices

    class Device:
        def __init__(self, number):
            assert number == 0

        def __enter__(self):
            return self

        def __exit__(self, *_):
            return None

    cupy = ModuleType("cupy")
    cupy.__version__ = "13"
    cupy.copies = 0
    cupy.empty = lambda shape, dtype: np.full(shape, np.nan, dtype).view(DeviceArray)

    def asnumpy(array):
        assert isinstance(array, DeviceArray)
        cupy.copies += 1
        return np.array(array)

    cupy.asnumpy = asnumpy
    runtime = SimpleNamespace(
        CUDARuntimeError=CudaError,
        getDeviceCount=count,
        getDeviceProperties=lambda _: {"name": b"Stand-in"},
    )
    cupy.cuda = SimpleNamespace(Device=Device, runtime=runtime)
    return cupy


@pytest.fixture
def device(monkeypatch):
    """Install the stand-ins for cupy and cufinufft."""
    cufinufft = ModuleType("cufinufft")
    cufinufft.__version__, cufinufft.Plan = "2.3", DirectPlan
    cupy = _fake_cupy()
    monkeypatch.setitem(sys.modules, "cupy", cupy)
    monkeypatch.setitem(sys.modules, "cufinufft", cufinufft)
    monkeypatch.setattr(DirectPlan, "made", [])
    return cupy


@pytest.fixture
def real_gpu():
    """Skip where there is no GPU: nothing else may skip."""
    works, why = transforms.gpu_description()
    if not works:
        pytest.skip(why)


def _sets(sets, n, dims, weighted):
    generator = np.random.default_rng(5)
    x = generator.random((sets, n, dims))
    return x, generator.random((sets, n)) - 0.3 if weighted else None


def _compare(dims, sets, weighted, step, tolerance):
    grid = FrequencyGrid(dims, SHAPES[dims], step)
    x, weights = _sets(sets, 31, dims, weighted)
    transform = Transform(grid, 31, engine="gpu")
    assert transform.engine == "gpu"
    expected = direct_sum(x, grid.indices() * step, weights)
    scale = 1.0 if weights is None else np.abs(weights).sum(axis=1).max()
    assert np.abs(transform.coefficients(x, weights) - expected).max() < tolerance * scale
    total, squares = np.zeros(grid.stored), np.zeros(grid.stored)
    mean = np.zeros(grid.stored, np.complex128)
    transform.add_power(x, weights, total, squares, mean)
    power = np.abs(expected) ** 2
    assert np.abs(total - power.sum(axis=0)).max() < 2 * sets * tolerance * scale**2
    assert np.abs(squares - (power**2).sum(axis=0)).max() < 4 * sets * tolerance * scale**4
    assert np.abs(mean - expected.sum(axis=0)).max() < sets * tolerance * scale


@pytest.mark.parametrize("dims", [1, 2, 3])
@pytest.mark.parametrize("sets", [1, 2, 5])
@pytest.mark.parametrize("weighted", [False, True])
def test_packed_and_single_sets_agree_with_the_definition(device, dims, sets, weighted):
    _compare(dims, sets, weighted, step=1.0, tolerance=1e-12)


@pytest.mark.gpu
@pytest.mark.parametrize("dims", [1, 2, 3])
@pytest.mark.parametrize("sets", [1, 2, 5])
@pytest.mark.parametrize("weighted", [False, True])
def test_a_real_gpu_agrees_with_the_definition(real_gpu, dims, sets, weighted):
    _compare(dims, sets, weighted, step=1.0, tolerance=1e-8)


@pytest.mark.parametrize("step", [0.25, 3.0])
def test_real_frequencies_are_scaled_coordinates(device, step):
    _compare(2, 3, False, step, tolerance=1e-12)


def test_one_plan_and_one_set_of_arrays_serve_all_sets(device):
    grid = FrequencyGrid(2, 3)
    transform = Transform(grid, 16, engine="gpu", eps=1e-7)
    for seed in range(4):
        transform.coefficients(np.random.default_rng(seed).random((6, 16, 2)))
    (plan,) = DirectPlan.made
    assert plan.eps == 1e-7
    assert len({id(array) for array in plan.kept}) == 2


def test_results_come_back_in_blocks(device, monkeypatch):
    grid = FrequencyGrid(1, 10)
    x, _ = _sets(14, 8, 1, False)
    transform = Transform(grid, 8, engine="gpu")
    whole = transform.coefficients(x)
    assert device.copies == 1
    monkeypatch.setattr(transforms, "_BLOCK_BYTES", 3 * 16 * grid.size)  # three pairs, three, one
    assert np.array_equal(transform.coefficients(x), whole)
    assert device.copies == 1 + 3
    monkeypatch.setattr(transforms, "_BLOCK_BYTES", 1)  # never less than one
    assert np.array_equal(transform.coefficients(x), whole)


def test_threads_take_turns(device):
    grid = FrequencyGrid(2, 6)
    transform = Transform(grid, 40, engine="gpu")
    sets = [np.random.default_rng(k).random((4, 40, 2)) for k in range(4)]
    found = {}

    def work(k):
        found[k] = transform.coefficients(sets[k])

    threads = [threading.Thread(target=work, args=(k,)) for k in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    for k, x in enumerate(sets):
        assert np.abs(found[k] - direct_sum(x, grid.indices())).max() < 1e-12


def test_analyses_take_the_engine_and_say_so(device):
    settings = {"half_width": 4, "realizations": 6, "rng": 3}
    power = [mcs.power_spectrum("jittered", 16, engine=e, **settings) for e in ("gpu", "direct")]
    assert power[0].attrs["engine"] == "gpu"
    assert np.allclose(power[0]["power"], power[1]["power"], rtol=0, atol=1e-13)
    estimator = mcs.Estimator("gaussian(width=0.25)", dims=2)
    terms = [
        mcs.variance_terms(estimator, "jittered", 16, engine=engine, **settings)
        for engine in ("gpu", "direct")
    ]
    assert terms[0].attrs["engine"] == "gpu"
    assert np.allclose(terms[0]["contribution"], terms[1]["contribution"], rtol=1e-9, atol=1e-15)


def test_auto_never_means_gpu(device):
    for dims, half_width in ((1, 10**6), (2, 256), (3, 64)):
        assert Transform(FrequencyGrid(dims, half_width), 10**6).engine == "nufft"


def test_cuda_libraries_that_pip_installed_are_loaded(device, monkeypatch):
    loaded = []
    pathfinder = ModuleType("cuda.pathfinder")
    pathfinder.load_nvidia_dynamic_lib = loaded.append
    monkeypatch.setitem(sys.modules, "cuda", ModuleType("cuda"))
    monkeypatch.setitem(sys.modules, "cuda.pathfinder", pathfinder)
    assert transforms.gpu_description()[0]
    assert loaded == ["cudart", "cufft"]

    def absent(name):
        raise RuntimeError(name)

    pathfinder.load_nvidia_dynamic_lib = absent
    assert transforms.gpu_description()[0]


def _refusal():
    with pytest.raises(MissingDependency) as caught:
        Transform(FrequencyGrid(2, 4), 16, engine="gpu")
    assert transforms.gpu_description() == (False, str(caught.value))
    assert "\n" not in str(caught.value)
    return str(caught.value)


@pytest.mark.parametrize("name", ["cupy", "cufinufft"])
def test_a_missing_package_is_named_with_what_to_install(device, monkeypatch, name):
    monkeypatch.setitem(sys.modules, name, None)
    assert _refusal() == (
        f"engine='gpu' needs the package {name}; install it with: pip install 'mcspectra[gpu]'"
    )


@pytest.mark.parametrize("error", [OSError("libcufft.so.11: cannot\nopen."), ImportError("broken")])
def test_a_package_that_does_not_load_gives_its_reason(device, monkeypatch, error):
    load = importlib.import_module

    def fail(name):
        if name == "cufinufft":
            raise error
        return load(name)

    monkeypatch.setattr(importlib, "import_module", fail)
    reason = " ".join(str(error).split()).rstrip(".")
    assert _refusal() == (
        f"engine='gpu' needs the package cufinufft; it cannot be loaded: {reason}; "
        "mend its installation."
    )


@pytest.mark.parametrize(
    ("devices", "words"),
    [
        (0, "finds no CUDA device; use engine='nufft'."),
        (CudaError("cudaErrorNoDevice: no device."), "device: cudaErrorNoDevice: no device; use"),
    ],
)
def test_no_device_is_one_sentence(device, monkeypatch, devices, words):
    monkeypatch.setitem(sys.modules, "cupy", _fake_cupy(devices))
    assert words in _refusal()


def test_a_full_device_is_one_sentence(device, monkeypatch):
    transform = Transform(FrequencyGrid(2, 4), 16, engine="gpu")
    x, _ = _sets(2, 16, 2, False)

    def full(*_):
        raise MemoryError("Out of memory allocating 1,296 bytes")

    monkeypatch.setattr(device, "empty", full)
    with pytest.raises(ParameterError, match="9 × 9 frequencies: Out of memory.* smaller half_"):
        transform.coefficients(x)

    def no_plan(*_, **__):
        raise RuntimeError("Error creating plan.")

    monkeypatch.setattr(sys.modules["cufinufft"], "Plan", no_plan)
    with pytest.raises(ParameterError, match="9 × 9 frequencies: Error creating plan; use"):
        Transform(FrequencyGrid(2, 4), 16, engine="gpu")


def test_the_device_is_named(device):
    assert transforms.gpu_description() == (True, "Stand-in; cupy 13, cufinufft 2.3")


def test_other_engines_never_load_the_packages(monkeypatch):
    load = builtins.__import__

    def watch(name, *rest):
        assert name.partition(".")[0] not in ("cupy", "cufinufft")
        return load(name, *rest)

    monkeypatch.setattr(builtins, "__import__", watch)
    monkeypatch.setattr(transforms, "optional_package", None)
    Transform(FrequencyGrid(2, 16), 256).coefficients(np.zeros((2, 256, 2)))
