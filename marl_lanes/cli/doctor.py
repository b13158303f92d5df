"""The command that says whether this installation works, and what to do where it does not."""

import argparse
import hashlib
import os
import platform
import shutil
import sys
import tempfile
import webbrowser
from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass
from importlib import import_module
from importlib.metadata import PackageNotFoundError, metadata, requires, version
from importlib.util import find_spec
from pathlib import Path
from time import perf_counter

from marl_lanes.cli.arguments import Commands, add_command, add_json
from marl_lanes.cli.outputs import check_outputs, show_result
from marl_lanes.extras import MissingExtraError

PACKAGE = "marl-lanes"

IMPORTED = ("numpy", "numba", "torch", "tensordict", "torchrl", "gymnasium", "pettingzoo")
"""Packages with compiled parts, or that use each other's names: they may be there and not load."""

DIGEST = "f2b5b0939b8a"
"""Of the road that ``_drive`` steps."""

NUM_STEPS = 60
MIN_MEMORY = 2**30
"""[bytes] With less, a training does not begin."""
MIN_DISK = 100 * 2**20
"""[bytes] With less, kernels and runs are not kept."""


@dataclass(frozen=True)
class Finding:
    """What a check has found.

    Args:
        subject: what was looked at.
        found: what is there.
        advice: what to do; None if nothing is wrong.
    """

    subject: str
    found: str
    advice: str | None = None


def add(commands: Commands) -> None:
    """Add ``doctor``."""
    doctor = add_command(
        commands,
        "doctor",
        _examine,
        summary="check this installation, and say what is wrong",
        description="Print versions, processors, memory, the cache of compiled kernels, the GPU "
        "and what pictures need; step a road and compare it with what is known of it. The status "
        "is 0 if all is right and 1 if something is wrong: then it is said what to do.",
        examples="""
            marl-lanes doctor
            marl-lanes doctor --json found.json
        """,
    )
    add_json(doctor)


def _examine(options: argparse.Namespace) -> int:
    check_outputs([("--json", options.json)], [])
    findings = examine()
    wrong = [one for one in findings if one.advice is not None]
    lines = [f"{one.subject:16} {one.found}" for one in findings]
    lines += ["", "all is right" if not wrong else "wrong:"]
    lines += [f"  {one.subject}: {one.found}: {one.advice}" for one in wrong]
    result = {"is_right": not wrong, "findings": [*map(asdict, findings)]}
    show_result(options.json, result, "\n".join(lines))
    return 1 if wrong else 0


def examine() -> list[Finding]:
    """What all checks find; one that fails is a finding, too."""
    findings: list[Finding] = []
    for check in CHECKS:
        try:
            findings += check()
        except Exception as error:
            subject = check.__name__.removeprefix("_check_").replace("_", " ")
            found = f"{type(error).__name__}: {error}"
            findings.append(Finding(subject, found, "could not be checked; see what this names"))
    return findings


def _check_python() -> Iterator[Finding]:
    found = f"{platform.python_version()}, {platform.platform()}"
    try:
        wanted = metadata(PACKAGE)["Requires-Python"]
        yield Finding(PACKAGE, version(PACKAGE))
    except PackageNotFoundError:
        yield Finding(PACKAGE, "is not installed", f"pip install {PACKAGE}, or pip install .")
        return
    from packaging.specifiers import SpecifierSet

    is_right = SpecifierSet(wanted).contains(platform.python_version(), prereleases=True)
    yield Finding("python", found, None if is_right else f"use a Python {wanted}")


def _check_packages() -> Iterator[Finding]:
    """Versions, and whether they are within the ranges of the installed metadata."""
    from packaging.requirements import Requirement

    extras = metadata(PACKAGE).get_all("Provides-Extra") or []
    missing: dict[str, list[str]] = {extra: [] for extra in extras}
    narrower: list[tuple[str, Finding]] = []
    always: set[str] = set()
    for requirement in map(Requirement, requires(PACKAGE) or ()):
        if requirement.name == PACKAGE:
            continue
        marker = requirement.marker
        extra = next(
            (one for one in extras if marker is not None and marker.evaluate({"extra": one})), None
        )
        if marker is not None and extra is None and not marker.evaluate({"extra": ""}):
            continue
        wanted, install = requirement.specifier, f"pip install '{requirement.name}"
        try:
            found = version(requirement.name)
        except PackageNotFoundError:
            if extra is None:
                yield Finding(requirement.name, "is missing", f"{install}{wanted}'")
            else:
                missing[extra].append(requirement.name)
            continue
        is_right = wanted.contains(found, prereleases=True)
        advice = None if is_right else f"must be {wanted}: {install}{wanted}'"
        finding = Finding(requirement.name, found, advice)
        if extra is not None and requirement.name in always:
            # It matters only to whoever has the extra.
            narrower.append((extra, finding))
            continue
        always.add(requirement.name)
        yield finding
    for extra, finding in narrower:
        if not missing[extra] and finding.advice is not None:
            yield finding
    for extra, names in missing.items():
        lacks = f"lacks {', '.join(names)}: pip install '{PACKAGE}[{extra}]' if you need it"
        yield Finding(f"extra {extra}", lacks if names else "is complete")


def _check_imports() -> Iterator[Finding]:
    for name in IMPORTED:
        try:
            import_module(name)
        except Exception as error:
            found = f"cannot be loaded: {type(error).__name__}: {error}"
            yield Finding(name, found, f"pip install --force-reinstall {name}")


def _check_processors() -> Iterator[Finding]:
    from torch import get_num_threads

    from marl_lanes.traffic.machine.threads import count_processors

    usable, threads = count_processors(), get_num_threads()
    found = f"{usable} usable of {os.cpu_count()}, {threads} threads of torch"
    advice = f"more threads than processors are slow: set OMP_NUM_THREADS={usable}"
    yield Finding("processors", found, advice if threads > usable else None)


def _check_memory() -> Iterator[Finding]:
    import psutil

    memory = psutil.virtual_memory()
    found = f"{memory.available / 2**30:.1f} GiB available of {memory.total / 2**30:.1f} GiB"
    is_little = memory.available < MIN_MEMORY
    yield Finding("memory", found, "end other programs" if is_little else None)
    yield _check_disk("disk", Path.cwd())


def _check_kernels() -> Iterator[Finding]:
    """One small road, with compiled kernels that are kept on disk."""
    begun = perf_counter()
    digest = _drive()
    seconds = perf_counter() - begun
    is_right = digest == DIGEST
    advice = f"its digest must be {DIGEST}: reinstall numpy and {PACKAGE}, or report this machine"
    found = f"a road of {NUM_STEPS} steps has the digest {digest}, in {seconds:.1f} s"
    yield Finding("simulation", found, None if is_right else advice)
    yield from _check_cache()


def _check_cache() -> Iterator[Finding]:
    from marl_lanes.traffic.machine.numba_internals import CAN_KEEP
    from marl_lanes.traffic.step import run

    stats = getattr(run, "stats", None)
    if stats is None:
        yield Finding("kernels", "are interpreted, which is slow", "unset NUMBA_DISABLE_JIT")
        return
    was_loaded = sum(stats.cache_hits.values()) > 0
    yield Finding("kernels", "loaded from the cache" if was_loaded else "compiled just now")
    if not CAN_KEEP:
        yield Finding("kernel cache", "is off", "this version of numba is not known: change it")
    elif stats.cache_path is None:
        advice = "every start compiles: let NUMBA_CACHE_DIR name a folder that can be written"
        yield Finding("kernel cache", "no folder can be written", advice)
    else:
        yield _check_cache_folder(Path(stats.cache_path))


def _check_cache_folder(folder: Path) -> Finding:
    try:
        with tempfile.TemporaryFile(dir=folder):
            pass
    except OSError as error:
        advice = "let NUMBA_CACHE_DIR name another folder"
        return Finding("kernel cache", f"{folder}: {error.strerror}", advice)
    if not any(folder.glob("step.run*.nbc")):
        advice = "kernels were compiled and not kept: look whether its disk is full"
        return Finding("kernel cache", f"{folder}: is empty", advice)
    return _check_disk("kernel cache", folder)


def _check_gpu() -> Iterator[Finding]:
    import torch

    if torch.cuda.is_available():
        names = [torch.cuda.get_device_name(index) for index in range(torch.cuda.device_count())]
        yield Finding("gpu", f"{', '.join(names)}, CUDA {torch.version.cuda}")
        yield _check_gpu_kernels()
    elif not Path("/dev/nvidiactl").exists() and shutil.which("nvidia-smi") is None:
        yield Finding("gpu", "none; trainings need none")
    elif torch.version.cuda is None:
        yield Finding("gpu", "not used: this build of torch is for processors alone")
    else:
        advice = f"CUDA {torch.version.cuda} needs a newer driver; without it use device=cpu"
        yield Finding("gpu", "is there, but torch cannot use it", advice)


def _check_gpu_kernels() -> Finding:
    """Whether roads can be on the GPU, too."""
    from marl_lanes.traffic.machine.graphics import find_gpu

    try:
        find_gpu(0)
    except MissingExtraError as error:
        return Finding("gpu kernels", f"not there; Simulator(device='cuda') needs them: {error}")
    except ValueError as error:
        return Finding("gpu kernels", str(error), "until then use device=cpu for the roads")
    return Finding("gpu kernels", f"numba-cuda {version('numba-cuda')}")


def _check_pictures() -> Iterator[Finding]:
    if find_spec("imageio_ffmpeg") is not None:
        from imageio_ffmpeg import get_ffmpeg_exe

        try:
            yield Finding("ffmpeg", get_ffmpeg_exe())
        except RuntimeError:
            advice = "films need it: pip install --force-reinstall imageio-ffmpeg"
            yield Finding("ffmpeg", "is missing", advice)
    variables = ("DISPLAY", "WAYLAND_DISPLAY")
    has_display = sys.platform != "linux" or any(map(os.environ.get, variables))
    yield Finding("display", "there" if has_display else "none; only windows need one")
    try:
        webbrowser.get()
        yield Finding("browser", "there")
    except webbrowser.Error:
        yield Finding("browser", "none; only `watch --open` needs one")


CHECKS: tuple[Callable[[], Iterator[Finding]], ...] = (
    _check_python,
    _check_packages,
    _check_imports,
    _check_processors,
    _check_memory,
    _check_kernels,
    _check_gpu,
    _check_pictures,
)
"""In the order of the output."""


def _check_disk(subject: str, folder: Path) -> Finding:
    free = shutil.disk_usage(folder).free
    found = f"{folder}: {free / 2**30:.1f} GiB free"
    return Finding(subject, found, "make room on this disk" if free < MIN_DISK else None)


def _drive() -> str:
    """The digest of a road after some steps, to the millimetre: so far every machine agrees."""
    import numpy as np

    from marl_lanes.traffic.simulator import Simulator

    simulator = Simulator("paper", seed=1)
    simulator.reset()
    actions = np.full((1, simulator.num_slots, simulator.num_actions), 0.05)
    for _ in range(NUM_STEPS):
        simulator.step(actions)
    vehicles = simulator.vehicles[0]
    present = vehicles[vehicles["id"] >= 0]
    present = present[np.argsort(present["id"])]
    content = [present["id"], *(np.rint(1e3 * present[name]) for name in ("position", "speed"))]
    return hashlib.sha256(np.stack(content).astype("<i8").tobytes()).hexdigest()[:12]
