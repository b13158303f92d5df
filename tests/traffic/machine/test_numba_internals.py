"""The kernel cache, also when it is damaged, and numba without its private names."""

import os
import shutil
import subprocess
import sys
import types

import numba
import pytest

import marl_lanes.traffic
from marl_lanes.traffic.machine import numba_internals

pytestmark = pytest.mark.skipif(
    bool(numba.config.DISABLE_JIT), reason="numba's compilation is switched off"
)

TINY = """
from marl_lanes.traffic.machine.compiled import compiled, internal

@internal
def twice(x):
    return x * 2.0

@compiled
def kernel(x):
    return twice(x) + 1.0
"""
PROGRAM = "import tiny; print(tiny.kernel(1.5), sum(tiny.kernel.stats.cache_hits.values()))"

GONE_OPTIONS = """
from numba.core.cpu import CPUTargetOptions
for name in ("_nrt", "no_cfunc_wrapper", "no_cpython_wrapper", "forceinline"):
    (owner,) = (kind for kind in CPUTargetOptions.__mro__ if name in vars(kind))
    delattr(owner, name)
"""


@pytest.fixture(scope="module")
def code(tmp_path_factory):
    """A folder with a module of two kernels."""
    folder = tmp_path_factory.mktemp("code")
    (folder / "tiny.py").write_text(TINY)
    return folder


@pytest.fixture(scope="module")
def filled(code, tmp_path_factory):
    """A cache that holds these kernels."""
    cache = tmp_path_factory.mktemp("filled")
    assert run(code, cache) == ("4.0 0", "")
    return cache


@pytest.fixture
def cache(filled, tmp_path):
    """A copy of the filled cache."""
    return shutil.copytree(filled, tmp_path / "cache")


def run(code, cache, before="", **environment):
    """Output of a new process that calls the kernel: value, number of cache hits; and stderr."""
    done = subprocess.run(
        [sys.executable, "-W", "error", "-c", f"{before}\n{PROGRAM}"],
        env=os.environ
        | {"NUMBA_CACHE_DIR": str(cache), "PYTHONPATH": str(code), "PYTHONDONTWRITEBYTECODE": "1"}
        | environment,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    return done.stdout.strip(), done.stderr.strip()


def test_a_kept_kernel_is_found(code, cache):
    assert run(code, cache) == ("4.0 1", "")


@pytest.mark.slow
@pytest.mark.parametrize("suffix", ["nbi", "nbc"])
@pytest.mark.parametrize(
    "damage",
    [
        lambda _: b"",
        lambda content: content[: len(content) // 2],
    ],
    ids=["empty", "cut"],
)
def test_a_damaged_file_is_a_miss_and_is_replaced(code, cache, suffix, damage):
    (path,) = cache.rglob(f"*.{suffix}")
    path.write_bytes(damage(path.read_bytes()))
    assert run(code, cache) == ("4.0 0", "")
    assert run(code, cache) == ("4.0 1", "")


@pytest.mark.slow
def test_zeros_within_the_code_are_a_miss(code, cache):
    (path,) = cache.rglob("*.nbc")
    content = bytearray(path.read_bytes())
    start = content.index(b"\x7fELF") + 64
    content[start : start + 32] = bytes(32)
    path.write_bytes(content)
    assert run(code, cache) == ("4.0 0", "")
    assert run(code, cache) == ("4.0 1", "")


@pytest.mark.slow
@pytest.mark.parametrize(
    "other",
    [
        "import numba; numba.__version__ = '0.0'",
        "import marl_lanes.traffic.machine.numba_internals as n; n.SOURCES = 'of before'",
    ],
    ids=["numba", "sources"],
)
def test_a_kernel_of_another_version_is_a_miss(code, cache, other):
    assert run(code, cache, other) == ("4.0 0", "")
    assert run(code, cache) == ("4.0 0", "")
    assert run(code, cache) == ("4.0 1", "")


@pytest.mark.slow
def test_a_full_disk(code, tmp_path):
    # Enough for the index but not for the code: the index then lists a missing file.
    full = "import resource; resource.setrlimit(resource.RLIMIT_FSIZE, (2000, 2000))"
    message = "compiled kernels are not kept on disk: File too large"
    assert run(code, tmp_path, full) == ("4.0 0", message)
    assert len(list(tmp_path.rglob("*.nbi"))) == 1
    assert not list(tmp_path.rglob("*.nbc"))
    assert run(code, tmp_path) == ("4.0 0", "")
    assert run(code, tmp_path) == ("4.0 1", "")


@pytest.mark.slow
def test_without_a_writable_folder(tmp_path):
    (tmp_path / "tiny.py").write_text(TINY)
    file = tmp_path / "__pycache__"
    file.write_text("")
    below = str(file / "cache")
    home = {"HOME": below, "XDG_CACHE_HOME": below}
    message = (
        "compiled kernels are not kept on disk: no folder for them can be written; "
        "name one in NUMBA_CACHE_DIR"
    )
    assert run(tmp_path, below, **home) == ("4.0 0", message)


@pytest.mark.slow
@pytest.mark.parametrize(
    "name",
    [
        "FunctionCache",
        "CompileResultCacheImpl",
        "CompileResultCacheImpl.rebuild",
        "FunctionCache._impl_class",
    ],
)
def test_a_numba_without_the_known_cache(code, tmp_path, name):
    # ccallback imports the name from caching, so it must be loaded before.
    before = f"from numba.core import caching, ccallback; del caching.{name}"
    if name.endswith("_impl_class"):
        before += "; del caching.Cache._impl_class"
    if name.endswith("rebuild"):
        before += "; del caching.CacheImpl.rebuild"
    message = "compiled kernels are not kept on disk: this version of numba is not known"
    assert run(code, tmp_path, before) == ("4.0 0", message)
    assert not list(tmp_path.rglob("*.nb?"))


@pytest.mark.slow
def test_a_numba_without_the_options_that_save_time(code, tmp_path):
    assert run(code, tmp_path, GONE_OPTIONS) == ("4.0 0", "")


def test_options_that_numba_does_not_have_are_left_out():
    assert numba_internals.known_options(_nrt=False, quickly=True) == {"_nrt": False}


def test_scipy_is_not_imported_to_check_for_it(monkeypatch):
    asked = []
    module = types.SimpleNamespace(ensure_blas=lambda: asked.append("numba's own"))
    monkeypatch.setitem(sys.modules, "numba.np.linalg", module)
    monkeypatch.delitem(sys.modules, "numba.np.arraymath", raising=False)
    with numba_internals.unused_scipy():
        module.ensure_blas()
    assert asked == []
    module.ensure_blas()
    assert asked == ["numba's own"]


def test_a_numba_that_looks_for_scipy_in_another_way(monkeypatch):
    module = types.SimpleNamespace()
    monkeypatch.setitem(sys.modules, "numba.np.linalg", module)
    monkeypatch.delitem(sys.modules, "numba.np.arraymath", raising=False)
    with numba_internals.unused_scipy():
        assert vars(module) == {}
    assert vars(module) == {}


def test_the_digest_changes_with_any_source(tmp_path):
    (package,) = marl_lanes.traffic.__path__
    copied = shutil.copytree(package, tmp_path / "traffic")
    assert numba_internals.hash_sources(copied) == numba_internals.SOURCES
    with (copied / "road" / "motion.py").open("a") as file:
        file.write("\n")
    assert numba_internals.hash_sources(copied) != numba_internals.SOURCES
