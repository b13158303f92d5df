"""The command that checks an installation: what is right, and each thing that can be wrong."""

import json
import os
import sys
from collections import namedtuple
from importlib.metadata import PackageNotFoundError, version

import psutil
import pytest
import torch

from marl_lanes.cli import doctor
from marl_lanes.cli.main import main
from marl_lanes.extras import MissingExtraError
from marl_lanes.traffic import step
from marl_lanes.traffic.machine import graphics, numba_internals

Usage = namedtuple("Usage", "total used free")
Stats = namedtuple("Stats", "cache_path cache_hits cache_misses")
FULL = Usage(2**40, 2**40, 2**20)


@pytest.fixture(autouse=True)
def _right(monkeypatch):
    """As where all is right, whatever this machine is."""
    monkeypatch.setattr(torch, "get_num_threads", lambda: 1)
    monkeypatch.setattr(doctor, "requires", lambda _: ["numpy>=2.0", 'pyarrow>=1; extra == "view"'])


def wrong():
    """What is wrong, by its subject: what was found, and what to do."""
    return {one.subject: (one.found, one.advice) for one in doctor.examine() if one.advice}


def raise_error(error):
    def function(*_, **__):
        raise error

    return function


def test_a_good_installation(capsys, tmp_path):
    assert main(["doctor", "--json", str(tmp_path / "found.json")]) == 0
    captured = capsys.readouterr()
    assert captured.err == ""
    lines = captured.out.splitlines()
    assert lines[-1] == "all is right"
    shown = {line[:16].strip(): line[17:] for line in lines[:-2]}
    assert shown["numpy"] == version("numpy")
    assert shown["extra view"] == "is complete"
    assert str(os.cpu_count()) in shown["processors"]
    assert "GiB" in shown["memory"]
    assert shown["simulation"].startswith(f"a road of 60 steps has the digest {doctor.DIGEST}, ")
    assert {"python", "kernels", "kernel cache", "gpu", "display", "browser"} < set(shown)
    written = json.loads((tmp_path / "found.json").read_text(encoding="utf-8"))
    assert written["is_right"] is True
    assert [one["subject"] for one in written["findings"]] == [
        line[:16].strip() for line in lines[:-2]
    ]


def test_what_is_wrong_is_told_with_what_to_do(capsys, monkeypatch, tmp_path):
    monkeypatch.setattr(torch, "get_num_threads", lambda: 10_000)
    assert main(["doctor", "--json", str(tmp_path / "found.json")]) == 1
    out = capsys.readouterr().out
    (told,) = out.partition("\nwrong:\n")[2].splitlines()
    assert told.startswith("  processors: ")
    assert "10000 threads of torch: more threads than processors are slow: set OMP_NUM" in told
    written = json.loads((tmp_path / "found.json").read_text(encoding="utf-8"))
    assert written["is_right"] is False


@pytest.mark.parametrize(
    ("required", "subject", "found", "advice"),
    [
        ("numpy>=99", "numpy", version("numpy"), "must be >=99: pip install 'numpy>=99'"),
        ("numpy<2", "numpy", version("numpy"), "must be <2: pip install 'numpy<2'"),
        ("not-there>=1", "not-there", "is missing", "pip install 'not-there>=1'"),
        ('pyarrow>=999; extra == "view"', "pyarrow", version("pyarrow"), "must be >=999"),
    ],
)
def test_a_version_out_of_range(monkeypatch, required, subject, found, advice):
    monkeypatch.setattr(doctor, "requires", lambda _: [required])
    told = wrong()[subject]
    assert told[0] == found
    assert told[1].startswith(advice)


def test_an_extra_that_lacks_packages_is_not_wrong(monkeypatch):
    monkeypatch.setattr(doctor, "requires", lambda _: ['not-there>=1; extra == "ray"'])
    assert wrong() == {}
    found = {one.subject: one.found for one in doctor.examine()}
    assert found["extra ray"] == "lacks not-there: pip install 'marl-lanes[ray]' if you need it"


def test_a_package_that_cannot_be_loaded(monkeypatch):
    original = doctor.import_module
    broken = raise_error(OSError("libgomp.so.1: cannot open shared object file"))
    monkeypatch.setattr(
        doctor, "import_module", lambda name: broken() if name == "torchrl" else original(name)
    )
    found, advice = wrong()["torchrl"]
    assert found.startswith("cannot be loaded: OSError: libgomp.so.1")
    assert advice == "pip install --force-reinstall torchrl"


def test_a_package_that_is_not_installed(monkeypatch):
    monkeypatch.setattr(doctor, "metadata", raise_error(PackageNotFoundError("marl-lanes")))
    assert wrong()["marl-lanes"] == ("is not installed", "pip install marl-lanes, or pip install .")


def test_another_python(monkeypatch):
    monkeypatch.setattr(doctor.platform, "python_version", lambda: "3.10.1")
    assert wrong()["python"][1] == "use a Python >=3.11"


def test_little_memory_and_a_full_disk(monkeypatch):
    memory = namedtuple("Memory", "total available")
    monkeypatch.setattr(psutil, "virtual_memory", lambda: memory(2**34, 2**29))
    monkeypatch.setattr(doctor.shutil, "disk_usage", lambda _: FULL)
    told = wrong()
    assert told["memory"] == ("0.5 GiB available of 16.0 GiB", "end other programs")
    assert told["disk"][1] == told["kernel cache"][1] == "make room on this disk"


def test_other_traffic_than_known(monkeypatch):
    monkeypatch.setattr(doctor, "DIGEST", "0123")
    found, advice = wrong()["simulation"]
    assert "has the digest" in found
    assert advice.startswith("its digest must be 0123")


def test_a_simulation_that_fails(monkeypatch):
    monkeypatch.setattr(doctor, "_drive", raise_error(RuntimeError("no compiler")))
    assert wrong()["kernels"][0] == "RuntimeError: no compiler"


@pytest.mark.parametrize(
    ("stats", "can_keep", "found", "advice"),
    [
        (Stats(None, {}, {}), True, "no folder can be written", "NUMBA_CACHE_DIR"),
        (Stats(None, {}, {}), False, "is off", "this version of numba is not known"),
        (Stats("gone", {}, {}), True, "gone: No such file or directory", "NUMBA_CACHE_DIR"),
        (Stats("empty", {}, {}), True, "empty: is empty", "look whether its disk is full"),
    ],
)
def test_a_cache_that_cannot_be_used(monkeypatch, tmp_path, stats, can_keep, found, advice):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "empty").mkdir()
    monkeypatch.setattr(step, "run", namedtuple("Run", "stats")(stats))
    monkeypatch.setattr(numba_internals, "CAN_KEEP", can_keep)
    told = wrong()["kernel cache"]
    assert told[0] == found
    assert advice in told[1]


def test_kernels_that_are_interpreted(monkeypatch):
    monkeypatch.setattr(step, "run", lambda: None)
    assert wrong()["kernels"] == ("are interpreted, which is slow", "unset NUMBA_DISABLE_JIT")


@pytest.mark.parametrize(
    ("is_there", "cuda", "found"),
    [
        (False, None, "none; trainings need none"),
        (True, None, "not used: this build of torch is for processors alone"),
    ],
)
def test_no_gpu_is_not_wrong(monkeypatch, is_there, cuda, found):
    monkeypatch.setattr(torch.cuda, "is_available", lambda: False)
    monkeypatch.setattr(torch.version, "cuda", cuda)
    monkeypatch.setattr(doctor.Path, "exists", lambda _: is_there)
    assert [one.found for one in doctor._check_gpu()] == [found]


def test_a_gpu_whose_driver_is_too_old(monkeypatch):
    monkeypatch.setattr(torch.cuda, "is_available", lambda: False)
    monkeypatch.setattr(torch.version, "cuda", "99.1")
    monkeypatch.setattr(doctor.Path, "exists", lambda _: True)
    assert wrong()["gpu"][1].startswith("CUDA 99.1 needs a newer driver")


def test_a_gpu_is_named(monkeypatch):
    monkeypatch.setattr(torch.cuda, "is_available", lambda: True)
    monkeypatch.setattr(torch.cuda, "device_count", lambda: 2)
    monkeypatch.setattr(torch.cuda, "get_device_name", lambda index: f"card {index}")
    monkeypatch.setattr(graphics, "find_gpu", lambda _: None)
    monkeypatch.setattr(doctor, "version", lambda name: f"version of {name}")
    found, kernels = doctor._check_gpu()
    assert found.found.startswith("card 0, card 1, CUDA ")
    assert kernels.found == "numba-cuda version of numba-cuda"
    assert found.advice is kernels.advice is None


@pytest.mark.parametrize(
    ("error", "is_wrong"), [(MissingExtraError("install it"), False), (ValueError("numpy"), True)]
)
def test_a_gpu_that_roads_cannot_be_on(monkeypatch, error, is_wrong):
    monkeypatch.setattr(graphics, "find_gpu", raise_error(error))
    found = doctor._check_gpu_kernels()
    assert str(error) in found.found
    assert (found.advice is not None) == is_wrong


@pytest.mark.parametrize(("others", "is_wrong"), [([], True), (["not-there>=1"], False)])
def test_an_extra_may_need_an_older_version_of_what_all_need(monkeypatch, others, is_wrong):
    extra = [f'{one}; extra == "view"' for one in ("numpy<0.1", *others)]
    monkeypatch.setattr(doctor, "requires", lambda _: ["numpy>=1", *extra])
    assert ("numpy" in wrong()) == is_wrong


def test_films_need_their_program(monkeypatch):
    import imageio_ffmpeg

    monkeypatch.setattr(imageio_ffmpeg, "get_ffmpeg_exe", raise_error(RuntimeError("none")))
    assert wrong()["ffmpeg"][0] == "is missing"


@pytest.mark.parametrize("display", ["", ":0"])
def test_a_display(monkeypatch, display):
    monkeypatch.setattr(sys, "platform", "linux")
    monkeypatch.delenv("WAYLAND_DISPLAY", raising=False)
    monkeypatch.setenv("DISPLAY", display)
    (found,) = [one for one in doctor._check_pictures() if one.subject == "display"]
    assert found.found.startswith("there" if display else "none")
