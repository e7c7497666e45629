"""Kernels: processes that start together compile each kernel once."""

import os
import subprocess
import sys

KERNELS = """
from mcspectra.core.jit import kernel

@kernel
def inner(x):
    return x + 1

@kernel
def outer(x):
    return inner(x) * inner(2 * x)
"""
PROGRAM = """
import numba.core.event as event

class Count(event.Listener):
    names = []
    def on_start(self, found):
        self.names.append(found.data["dispatcher"].py_func.__qualname__)
    def on_end(self, found):
        pass

event.register("numba:compile", Count())
import kernels_of_a_test
assert kernels_of_a_test.outer(3) == 28
print(*Count.names)
"""


def test_one_of_several_processes_compiles_a_kernel(tmp_path):
    """Kernels that call one another; those of the package take longer to compile."""
    (tmp_path / "kernels_of_a_test.py").write_text(KERNELS)
    paths = [str(tmp_path), *filter(None, [os.environ.get("PYTHONPATH")])]
    env = {**os.environ, "NUMBA_CACHE_DIR": str(tmp_path), "PYTHONPATH": os.pathsep.join(paths)}
    started = [
        subprocess.Popen(
            [sys.executable, "-c", PROGRAM], stdout=subprocess.PIPE, text=True, env=env
        )
        for _ in range(2)
    ]
    texts = [process.communicate()[0] for process in started]
    assert [process.returncode for process in started] == [0, 0]
    assert sorted(" ".join(texts).split()) == ["inner", "outer"]
