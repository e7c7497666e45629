"""Kernels: processes that start together compile each kernel once."""

import os
import subprocess
import sys

PROGRAM = """
import numba.core.event as event

class Count(event.Listener):
    names = []
    def on_start(self, found):
        self.names.append(found.data["dispatcher"].py_func.__qualname__)
    def on_end(self, found):
        pass

event.register("numba:compile", Count())
from mcspectra.core.streams import Stream
Stream.from_rng(0).child(1)
print(*Count.names)
"""


def test_one_of_several_processes_compiles_a_kernel(tmp_path):
    env = {**os.environ, "NUMBA_CACHE_DIR": str(tmp_path)}
    started = [
        subprocess.Popen(
            [sys.executable, "-c", PROGRAM], stdout=subprocess.PIPE, text=True, env=env
        )
        for _ in range(2)
    ]
    texts = [process.communicate()[0] for process in started]
    assert [process.returncode for process in started] == [0, 0]
    compiled = " ".join(texts).split()
    assert compiled, "no kernel was compiled, so nothing was tested"
    assert len(set(compiled)) == len(compiled)
