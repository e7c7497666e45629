"""Processes of tests."""

import os
import signal
import subprocess
import sys
import time
import warnings


def python(*arguments, check=False, **options):
    """Run Python to its end; return its exit code and its output as text."""
    command = [sys.executable, *map(str, arguments)]
    return subprocess.run(command, check=check, capture_output=True, text=True, **options)


def forked(said=os.devnull):
    """Fork this process, which has imported all modules; return 0 in the child, as os.fork does.

    The child prints nothing; its errors go to the file `said`. It must end with os._exit.
    """
    with warnings.catch_warnings():
        # Later versions of Python warn if there are other threads; the child uses none of them
        warnings.simplefilter("ignore", DeprecationWarning)
        child = os.fork()
    if child == 0:
        warnings.resetwarnings()
        for number, name, file in ((1, "stdout", os.devnull), (2, "stderr", said)):
            stream = open(file, "w", buffering=1)  # noqa: PTH123, SIM115
            os.dup2(stream.fileno(), number)
            setattr(sys, name, stream)
    return child


class Command:
    """The command ``mcspectra`` in a fork of this process."""

    def __init__(self, *arguments, said=os.devnull):
        from mcspectra.cli.main import main

        self.returncode = None
        self.pid = forked(said)
        if self.pid == 0:
            code = 1
            try:
                sys.argv[1:] = map(str, arguments)
                code = main()
            finally:
                os._exit(code)

    def poll(self):
        """Return the exit code, or None while the process runs."""
        if self.returncode is None:
            done, status = os.waitpid(self.pid, os.WNOHANG)
            self.returncode = os.waitstatus_to_exitcode(status) if done else None
        return self.returncode

    def wait(self, seconds=60.0):
        """Wait for the end and return the exit code."""
        end = time.monotonic() + seconds
        while self.poll() is None:
            assert time.monotonic() < end, "the process does not end"
            time.sleep(0.01)
        return self.returncode

    def send_signal(self, number):
        """Send a signal, unless the process has ended."""
        if self.poll() is None:
            os.kill(self.pid, number)

    def kill(self):
        """Kill the process and wait for its end."""
        self.send_signal(signal.SIGKILL)
        self.wait()
