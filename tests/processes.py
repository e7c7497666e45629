"""Processes of tests."""

import os
import signal
import subprocess
import sys
import time
import traceback
import warnings


def python(*arguments, check=False, **options):
    """Run Python to its end; return its exit code and its output as text."""
    command = [sys.executable, *map(str, arguments)]
    return subprocess.run(command, check=check, capture_output=True, text=True, **options)


class Fork:
    """A function in a fork of this process, which has imported all modules.

    The function returns the exit code. It prints nothing; its errors are added to the file `said`.
    """

    def __init__(self, function, *arguments, said=os.devnull):
        self.returncode = None
        with warnings.catch_warnings():
            # Later versions of Python warn if there are other threads; the child uses none of them
            warnings.simplefilter("ignore", DeprecationWarning)
            self.pid = os.fork()
        if self.pid == 0:
            code = 1
            try:
                warnings.resetwarnings()
                for number, name, file in ((1, "stdout", os.devnull), (2, "stderr", said)):
                    stream = open(file, "a", buffering=1)  # noqa: PTH123, SIM115
                    os.dup2(stream.fileno(), number)
                    setattr(sys, name, stream)
                code = function(*arguments)
            except BaseException:
                traceback.print_exc()
                raise
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


def command(*arguments):
    """Run the command as a program does; return its exit code. For forks only."""
    from mcspectra.cli.main import main

    sys.argv[1:] = map(str, arguments)
    return main()
