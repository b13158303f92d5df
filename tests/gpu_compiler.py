"""PTX without a GPU."""

from numba import cuda, typeof
from numba.cuda import dispatcher


def compile_ptx(function, arguments, monkeypatch, capability=(8, 0)):
    """The PTX of a function as a kernel for arguments like these."""

    class Device:
        compute_capability = capability
        id = 0

    # The compiler asks the present GPU what it can do.
    monkeypatch.setattr(dispatcher, "get_current_device", Device)
    ptx, _ = cuda.compile_ptx(function, tuple(map(typeof, arguments)), cc=capability)
    return ptx
