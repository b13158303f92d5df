"""What some tests need of the operating system; where it lacks that, they are skipped."""

import os
from pathlib import Path
from tempfile import TemporaryDirectory

import pytest


def needs(*names):
    """A mark: functions of ``os`` that not every system has."""
    missing = [name for name in names if not hasattr(os, name)]
    return pytest.mark.skipif(bool(missing), reason=f"no {', '.join(missing)} in os here")


def needs_path(name):
    """A mark: a device, or a folder of the system."""
    is_there = os.name == "posix" and Path(name).exists()
    return pytest.mark.skipif(not is_there, reason=f"no {name} here")


def _makes_links():
    """Windows asks for a right to make symbolic links."""
    with TemporaryDirectory() as folder:
        link = Path(folder, "link")
        try:
            link.symlink_to(folder, target_is_directory=True)
            return link.samefile(folder)
        except OSError:
            return False


needs_posix = pytest.mark.skipif(os.name != "posix", reason="POSIX alone")
needs_links = pytest.mark.skipif(not _makes_links(), reason="no symbolic links here")
