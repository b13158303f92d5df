"""What is said where something for a GPU is missing."""

import sys
from types import SimpleNamespace

import pytest

from marl_lanes import Simulator
from marl_lanes.extras import MissingExtraError
from marl_lanes.traffic.machine import graphics


@pytest.mark.parametrize(
    ("name", "number"), [("cpu", None), ("cuda", 0), ("cuda:0", 0), ("cuda:12", 12)]
)
def test_a_device_has_a_number(name, number):
    assert graphics.read_device(name) == number


@pytest.mark.parametrize("name", ["gpu", "cuda:", "cuda:-1", "cuda:99999", "", None, 0, "CUDA"])
def test_another_name_is_refused(name):
    with pytest.raises(ValueError, match=r"must be cpu, cuda or cuda:N$") as caught:
        Simulator("paper", device=name)
    assert str(caught.value).startswith("device = ")


def test_without_the_extra_it_is_named(monkeypatch):
    monkeypatch.setitem(sys.modules, "numba_cuda", None)
    with pytest.raises(MissingExtraError, match=r"pip install 'marl-lanes\[gpu\]'"):
        Simulator("paper", device="cuda")


def put(monkeypatch, error=None, number=1, versions=((13, 0), (13, 5))):
    """A compiler in the place of numba-cuda's."""
    cuda = SimpleNamespace(cuda_error=lambda: error, gpus=[None] * number)
    monkeypatch.setattr(graphics, "need", lambda *_: cuda)
    monkeypatch.setattr(graphics, "find_versions", lambda _: versions)


def test_a_missing_driver_and_a_missing_gpu_are_told_apart(monkeypatch):
    put(monkeypatch, error="\nCUDA driver library cannot be found.\nInstall it.\n")
    with pytest.raises(
        ValueError,
        match=r"^device = cuda:0: must be cpu here: NVIDIA's driver is missing .* be found",
    ):
        Simulator("paper", device="cuda")
    put(monkeypatch, number=0)
    with pytest.raises(
        ValueError, match=r"^device = cuda:0: must be cpu here: the driver is there, and no GPU"
    ):
        Simulator("paper", device="cuda")
    put(monkeypatch, number=2)
    with pytest.raises(
        ValueError,
        match=r"^device = cuda:2: must be cpu here: there is no GPU 2: there are 2, from 0",
    ):
        Simulator("paper", device="cuda:2")


def test_an_older_driver_is_told(monkeypatch):
    put(monkeypatch, versions=((12, 8), (13, 0)))
    with pytest.raises(
        ValueError,
        match=r"^device = cuda:0: must be cpu here: NVIDIA's driver is for CUDA 12\.8, "
        r"the compiler for CUDA 13\.0: update the driver, or install numba-cuda\[cu12\]$",
    ):
        Simulator("paper", device="cuda")


@pytest.mark.slow
def test_a_linker_of_another_version_of_cuda(monkeypatch):
    nvjitlink = pytest.importorskip("cuda.bindings.nvjitlink")

    def complete(_):
        raise nvjitlink.nvJitLinkError(6)

    put(monkeypatch)
    monkeypatch.setattr(nvjitlink, "complete", complete)
    monkeypatch.setattr(nvjitlink, "version", lambda: (12, 8))
    graphics.find_linker_fault.cache_clear()
    with pytest.raises(
        ValueError,
        match=r"^device = cuda:0: must be cpu here: the linker of CUDA 12\.8, .* CUDA 12 or 13$",
    ):
        Simulator("paper", device="cuda")
    graphics.find_linker_fault.cache_clear()


def test_a_compiler_that_does_not_load(monkeypatch):
    def need(module, _):
        if module == "numba.cuda":
            raise AttributeError("module 'numpy' has no attribute 'in1d'\nmore")

    monkeypatch.setattr(graphics, "need", need)
    with pytest.raises(ValueError, match=r"^numba-cuda: cannot be loaded: AttributeError: .*in1d'"):
        Simulator("paper", device="cuda")
