import subprocess
import sys
from pathlib import Path

import numba
import pytest

import marl_lanes
from marl_lanes.traffic import compiled, followers, step

PACKAGE = Path(marl_lanes.__file__).parent

needs_compilation = pytest.mark.usefixtures("_compilation")


@pytest.fixture
def _compilation():
    if numba.config.DISABLE_JIT:
        pytest.skip("numba's compilation is switched off")


@needs_compilation
def test_an_internal_kernel_refuses_a_call_from_python():
    with pytest.raises(TypeError, match=r"accelerate\(\) can be called by other kernels only"):
        followers.accelerate()


@needs_compilation
def test_a_cached_kernel_carries_the_digest_of_every_source():
    assert compiled._SOURCES in step.run._cache._cache_file._source_stamp


def test_the_digest_changes_with_any_source(tmp_path):
    program = (
        "import importlib.util, sys\n"
        "spec = importlib.util.spec_from_file_location('copied', sys.argv[1])\n"
        "module = importlib.util.module_from_spec(spec); spec.loader.exec_module(module)\n"
        "print(module._SOURCES)"
    )
    for source in (PACKAGE / "traffic").glob("*.py"):
        (tmp_path / source.name).write_bytes(source.read_bytes())

    def digest():
        command = [sys.executable, "-c", program, str(tmp_path / "compiled.py")]
        return subprocess.run(command, check=True, capture_output=True, text=True).stdout.strip()

    assert digest() == compiled._SOURCES
    with (tmp_path / "followers.py").open("a") as file:
        file.write("\n")
    assert digest() != compiled._SOURCES
