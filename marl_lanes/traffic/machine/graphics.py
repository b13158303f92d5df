"""Finding a GPU, and one clear line where something for it is missing."""

import re
from functools import cache
from importlib import import_module
from typing import Any, cast

import numba

from marl_lanes.extras import MissingExtraError, need
from marl_lanes.scenario.messages import shown

EXTRA = "gpu"
_ANY_CAPABILITY = 8, 0
_NAME = re.compile(r"cpu|cuda(?::(\d{1,4}))?")


def read_device(name: object) -> int | None:
    """The number of the GPU that a device's name stands for; None for the CPU.

    Args:
        name: ``cpu``, ``cuda`` or ``cuda:N``; or an object that is written so.

    Raises:
        ValueError: it is something else.
    """
    found = _NAME.fullmatch(str(name))
    if found is None:
        raise ValueError(f"device = {shown(name)}: must be cpu, cuda or cuda:N")
    return None if str(name) == "cpu" else int(found[1] or 0)


def find_gpu(number: int) -> Any:
    """numba-cuda's module, once the GPU with this number can be used.

    Raises:
        MissingExtraError: the extra ``gpu`` is not installed.
        ValueError: the compiler does not load, or the driver or the GPU is missing.
    """
    cuda = load_compiler()
    reason = find_fault(cuda)
    if reason is None and number >= len(cuda.gpus):
        reason = f"there is no GPU {number}: there are {len(cuda.gpus)}, from 0"
    if reason is None:
        reason = find_linker_fault()
    if reason is not None:
        raise ValueError(f"device = cuda:{number}: must be cpu here: {reason}")
    return cuda


def find_memory(number: int) -> tuple[float, str]:
    """The memory that a GPU has left [bytes], and its name in messages.

    Raises:
        MissingExtraError, ValueError: as for ``find_gpu``.
    """
    cuda = find_gpu(number)
    with cuda.gpus[number]:
        return cuda.current_context().get_memory_info().free, f"memory of cuda:{number}"


def load_compiler() -> Any:
    """numba-cuda's module.

    Raises:
        MissingExtraError: the extra ``gpu`` is not installed.
        ValueError: a version of numpy or numba is installed that it does not work with.
    """
    need("numba_cuda", EXTRA)
    try:
        cuda = need("numba.cuda", EXTRA)
    except MissingExtraError:
        raise
    except Exception as error:
        reason = str(error).partition("\n")[0]
        raise ValueError(
            f"numba-cuda: cannot be loaded: {type(error).__name__}: {reason}: "
            f"pip install 'marl-lanes[{EXTRA}]'"
        ) from None
    return cuda


def find_fault(cuda: Any) -> str | None:
    """Why there is no GPU to compute on; None if there is one."""
    # Its first line says only that the driver did not start.
    reason = " ".join(str(cuda.cuda_error() or "").split())
    if reason:
        return f"NVIDIA's driver is missing or does not start: {reason}"
    if len(cuda.gpus) == 0:
        return "the driver is there, and no GPU"
    driver, compiler = find_versions(cuda)
    # Within one major number an older driver runs newer code.
    if driver[0] < compiler[0]:
        has, needs = (".".join(map(str, one)) for one in (driver, compiler))
        return (
            f"NVIDIA's driver is for CUDA {has}, the compiler for CUDA {needs}: update the driver, "
            f"or install numba-cuda[cu{driver[0]}]"
        )
    return None


def find_versions(cuda: Any) -> tuple[tuple[int, int], tuple[int, int]]:
    """CUDA's version of the driver, and of the compiler."""
    if cast("Any", numba.config).ENABLE_CUDASIM:
        return (0, 0), (0, 0)
    driver: Any = import_module("numba.cuda.cudadrv.driver")
    return driver.get_version(), cuda.runtime.get_version()


@cache
def find_linker_fault() -> str | None:
    """Why CUDA's linker does not take what numba-cuda's compiler makes; None if it does.

    A process has one linker. If torch, for another version of CUDA, comes first, it is torch's.
    """
    if cast("Any", numba.config).ENABLE_CUDASIM:
        return None
    from cuda.bindings import nvjitlink
    from numba import cuda, void

    try:
        present = ".".join(map(str, nvjitlink.version()))
    except RuntimeError:
        return None  # there is none, and numba-cuda goes without
    code, _ = cuda.compile(lambda: None, void(), cc=_ANY_CAPABILITY, output="ltoir")
    options = [f"-arch=sm_{''.join(map(str, _ANY_CAPABILITY))}", "-lto"]
    linker = nvjitlink.create(len(options), options)
    try:
        nvjitlink.add_data(linker, nvjitlink.InputType.LTOIR, code, len(code), "nothing")
        nvjitlink.complete(linker)
    except nvjitlink.nvJitLinkError:
        return (
            f"the linker of CUDA {present}, which another package has loaded, does not take what "
            "numba-cuda's compiler makes: install numba-cuda[cu12] or numba-cuda[cu13], as torch "
            "is for CUDA 12 or 13"
        )
    finally:
        nvjitlink.destroy(linker)
    return None
