"""Compiles a kernel where there seems to be a GPU; says whether it was kept, and its code."""

import hashlib
import sys
from importlib import import_module
from types import SimpleNamespace
from unittest.mock import MagicMock

from numba import types
from numba.cuda import dispatcher
from numba.cuda.cudadrv import devices


def main(capability, place, kind):
    """The GPU's capability is such as 9.0; the kernel, of an array, is at the place module:name."""
    device = SimpleNamespace(id=0, compute_capability=tuple(map(int, capability.split("."))))
    dispatcher.get_current_device = lambda: device
    devices.get_context = lambda *_: MagicMock(device=device)
    module, name = place.split(":")
    kernel = getattr(import_module(module), name)
    compiled = kernel.compile((getattr(types, kind)[::1],))
    code = compiled._codelibrary.get_cubin().code
    assert compiled.argument_types[0].dtype is getattr(types, kind)
    hits = sum(kernel._cache_hits.values())
    sys.stdout.write(f"{hits} {hashlib.sha256(code).hexdigest()}\n")
