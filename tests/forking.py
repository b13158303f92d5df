"""Work in a forked process, which has one thread and copies of everything else."""

import os
import threading

import pytest


def exit_code_of_child(work):
    """0 if ``work`` returns true in a forked process."""
    if not hasattr(os, "fork"):
        pytest.skip("no fork in os here")
    child = os.fork()
    if child == 0:
        try:
            os._exit(0 if work() else 1)
        finally:
            os._exit(2)
    stuck = threading.Timer(60.0, os.kill, (child, 9))
    stuck.start()
    _, status = os.waitpid(child, 0)
    stuck.cancel()
    return os.waitstatus_to_exitcode(status)
