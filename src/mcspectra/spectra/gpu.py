"""Transforms of point sets on an NVIDIA GPU: cuFINUFFT's type 1 [Shih2021]_, with arrays of CuPy.

Spreading adds with atomic operations in no fixed order, so that two runs agree to rounding, about
1e-15 of the peak, and not bit for bit.
"""

from __future__ import annotations

import importlib
import importlib.util
import threading
from collections.abc import Iterator
from typing import Any

import numpy as np

from mcspectra.core.checks import Array
from mcspectra.core.errors import MissingDependency, ParameterError

__all__ = ["GpuTransform", "gpu_description"]

_DEVICE = 0  # CUDA_VISIBLE_DEVICES decides which one that is
_BLOCK_BYTES = 2**26
"""Most bytes of results that wait on the device to be copied back together, if more than one fits."""


class GpuTransform:
    """Transforms on one frequency grid, with one plan and one set of device arrays.

    Parameters
    ----------
    shape
        Frequencies along each axis, odd numbers, for one to three axes.
    step
        Distance of frequencies.
    eps
        Relative l2 accuracy.

    Raises
    ------
    ParameterError
        There are more than three axes, or the plan does not fit on the device.
    MissingDependency
        cufinufft or CuPy is not installed or cannot be loaded, or there is no CUDA device.

    Notes
    -----
    Threads take turns: one transform keeps the device busy.
    """

    def __init__(self, shape: tuple[int, ...], step: float, eps: float) -> None:
        if len(shape) > 3:
            raise ParameterError(
                f"The gpu engine works in 1 to 3 dims, not {len(shape)}; use engine='auto'."
            )
        self.shape = shape
        self.step = step
        self._cupy, cufinufft = _modules()
        self._lock = threading.Lock()
        self._inputs: tuple[tuple[Any, ...], Any] | None = None
        try:
            with self._cupy.cuda.Device(_DEVICE):
                self._plan = cufinufft.Plan(
                    1, shape, 1, eps, -1, "complex128", gpu_device_id=_DEVICE
                )
        except RuntimeError as error:
            raise ParameterError(_no_room(shape, error)) from error

    def transforms(self, points: Array, strengths: Array) -> Iterator[Array]:
        """Transform sets one by one, results copied back in blocks.

        Parameters
        ----------
        points
            (T, n, d) in [0,1).
        strengths
            complex128 (T, n).

        Yields
        ------
        ndarray
            complex128 (M,), the full grid in C order, on the host.

        Raises
        ------
        ParameterError
            The device has not memory enough.
        """
        block = max(1, _BLOCK_BYTES // (16 * int(np.prod(self.shape))))
        for low in range(0, len(points), block):
            with self._lock:
                found = self._block(points[low : low + block], strengths[low : low + block])
            yield from found

    def _block(self, points: Array, strengths: Array) -> Array:
        """Transforms of a few sets, copied back in one piece: (T, M)."""
        cupy = self._cupy
        with cupy.cuda.Device(_DEVICE):
            try:
                out = cupy.empty((len(points), *self.shape), np.complex128)
                for k in range(len(points)):
                    self._one(points[k], strengths[k], out[k])
            except (RuntimeError, MemoryError) as error:  # of cufinufft, and of CuPy's allocator
                raise ParameterError(_no_room(self.shape, error)) from error
            return np.asarray(cupy.asnumpy(out)).reshape(len(points), -1)

    def _one(self, points: Array, strengths: Array, out: Any) -> None:
        """Transform one set (n, d) into `out` on the device."""
        coordinates, device_strengths = self._arrays(*points.shape)
        for target, axis in zip(coordinates, points.T, strict=True):
            target.set(2.0 * np.pi * self.step * axis)
        device_strengths.set(strengths)
        self._plan.setpts(*coordinates)
        self._plan.execute(device_strengths, out=out)

    def _arrays(self, count: int, dims: int) -> tuple[tuple[Any, ...], Any]:
        """Device arrays of points and strengths: always the same, as plans keep what they are given."""
        if self._inputs is None or self._inputs[1].size != count:
            coordinates = tuple(self._cupy.empty(count, np.float64) for _ in range(dims))
            self._inputs = coordinates, self._cupy.empty(count, np.complex128)
        return self._inputs


def gpu_description() -> tuple[bool, str]:
    """Whether the engine can be used, and the device's name or why not."""
    try:
        cupy, cufinufft = _modules()
    except MissingDependency as error:
        return False, str(error)
    name = cupy.cuda.runtime.getDeviceProperties(_DEVICE)["name"].decode()
    return True, f"{name}; cupy {cupy.__version__}, cufinufft {cufinufft.__version__}"


def _modules() -> tuple[Any, Any]:
    """CuPy and cufinufft, once they and a device are known to work."""
    cupy = _load("cupy")
    _load_cuda()
    cufinufft = _load("cufinufft")
    runtime = cupy.cuda.runtime
    try:
        devices = runtime.getDeviceCount()
    except runtime.CUDARuntimeError as error:
        raise MissingDependency(
            f"engine='gpu' finds no CUDA device: {_sentence(error)}; use engine='nufft'."
        ) from error
    if not devices:
        raise MissingDependency("engine='gpu' finds no CUDA device; use engine='nufft'.")
    return cupy, cufinufft


def _load_cuda() -> None:
    """Load the CUDA libraries that pip installs, where cufinufft does not look for them."""
    try:
        from cuda.pathfinder import load_nvidia_dynamic_lib

        for library in ("cudart", "cufft"):
            load_nvidia_dynamic_lib(library)
    except (ImportError, RuntimeError):
        return  # no such package, or no such library: cufinufft may find them all the same


def _load(name: str) -> Any:
    try:
        return importlib.import_module(name)
    except (ImportError, OSError) as error:
        if isinstance(error, ModuleNotFoundError) and error.name == name:
            raise MissingDependency(
                f"engine='gpu' needs the package {name}; install it with: "
                "pip install 'mcspectra[gpu]'"
            ) from error
        raise MissingDependency(
            f"engine='gpu' cannot load the package {name}: {_sentence(error)}; use engine='nufft'."
        ) from error


def _no_room(shape: tuple[int, ...], error: Exception) -> str:
    size = " × ".join(map(str, shape))
    return (
        f"The GPU cannot transform to {size} frequencies: {_sentence(error)}; "
        "use a smaller half_width or engine='nufft'."
    )


def _sentence(error: Exception) -> str:
    """Text of an error on one line, without a full stop."""
    return " ".join(str(error).split()).rstrip(".") or type(error).__name__
