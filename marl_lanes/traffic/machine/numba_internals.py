"""The one place that uses names which numba does not promise to keep.

All of it saves time. Each name is looked for when this module is imported: without it the kernels
are the same, and slower to start or to run.
"""

import hashlib
import logging
import pickle
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from functools import cache
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from numba.core import caching, serialize
from numba.core.registry import CPUDispatcher

_LOG = logging.getLogger(__name__)
_dumps: Any = serialize.dumps


def hash_sources(folder: Path) -> str:
    """A digest of every source file below a folder."""
    digest = hashlib.sha256()
    for path in sorted(folder.rglob("*.py")):
        digest.update(path.read_bytes())
    return digest.hexdigest()


SOURCES = hash_sources(Path(__file__).parents[1])
"""Digest of the simulation."""

# The classes of numba's cache: one for each kernel, and what it writes.
_Cache: Any = getattr(caching, "FunctionCache", object)
_Content: Any = getattr(caching, "CompileResultCacheImpl", object)
# Were one of them not there, numba would keep kernels without the digest, and use stale ones.
CAN_KEEP = hasattr(_Cache, "_impl_class") and all(
    hasattr(kind, name)
    for kind, names in (
        (_Cache, ("load_overload", "save_overload", "flush")),
        (_Content, ("reduce", "rebuild")),
    )
    for name in names
)
"""Whether kernels can be kept on disk."""


class _CheckedContent(_Content):  # type: ignore[misc]
    """A compiled kernel under two digests: of the sources that it is made of, and of its bytes.

    Numba stamps a kept kernel with its own file alone, yet it holds the code of the kernels that it
    calls: without the first an edit of one file would leave others stale. What a crash or a full
    disk left behind may look whole to numba: the second finds it.
    """

    def reduce(self, data: Any) -> tuple[str, bytes, bytes]:
        content = _dumps(super().reduce(data))
        return SOURCES, hashlib.sha256(content).digest(), content

    def rebuild(self, target_context: Any, reduced_data: Any) -> Any:
        sources, digest, content = reduced_data
        if sources != SOURCES or digest != hashlib.sha256(content).digest():
            raise ValueError("stale or damaged")
        # As safe as numba's own cache, which is pickled, too.
        return super().rebuild(target_context, pickle.loads(content))  # noqa: S301


class KernelCache(_Cache):  # type: ignore[misc]
    """Numba's cache of a kernel on disk, in which whatever cannot be read or written is a miss."""

    _impl_class = _CheckedContent

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        """The kept kernel; None where there is none that can be used."""
        try:
            return super().load_overload(sig, target_context)
        except Exception:
            # Damaged bytes raise almost anything. The next save would stumble over them as well.
            with suppress(OSError):
                self.flush()
            return None

    def save_overload(self, sig: Any, data: Any) -> None:
        """Keep a kernel, where that is possible."""
        try:
            super().save_overload(sig, data)
        except Exception as error:
            _note_loss(getattr(error, "strerror", None) or type(error).__name__)


class Kernel(CPUDispatcher):
    """A compiled function, kept on disk where that is possible."""

    def enable_caching(self) -> None:
        """Look for a folder that can be written; without one it is compiled in memory."""
        if not CAN_KEEP:
            _note_loss("this version of numba is not known")
            return
        try:
            self._cache = KernelCache(self.py_func)
        except (OSError, RuntimeError):
            _note_loss("no folder for them can be written; name one in NUMBA_CACHE_DIR")


class InternalKernel(CPUDispatcher):
    """A kernel without an entry from Python; calling it there would crash the interpreter."""

    def __call__(self, *_: Any, **__: Any) -> Any:
        """Refuse."""
        raise TypeError(f"{self.py_func.__name__}() can be called by other kernels only")


def known_options(**options: bool) -> dict[str, bool]:
    """Those of the options, which only save time, that numba has."""
    known = CPUDispatcher.targetdescr.options
    return {name: value for name, value in options.items() if hasattr(known, name)}


@contextmanager
def unused_scipy() -> Iterator[None]:
    """Numba loads what it can compile without importing SciPy, which takes a fifth of a second.

    It imports it only to see whether linear algebra can be compiled; what compiles some still does.
    """
    linear_algebra: Any = import_module("numba.np.linalg")
    ensure_blas = getattr(linear_algebra, "ensure_blas", None)
    if ensure_blas is None or "numba.np.arraymath" in sys.modules:
        yield
        return

    def find_scipy() -> None:
        if find_spec("scipy") is None:
            raise ImportError("no scipy")

    linear_algebra.ensure_blas = find_scipy
    try:
        yield
    finally:
        linear_algebra.ensure_blas = ensure_blas


@cache
def _note_loss(reason: str) -> None:
    """Say once why every start will take the time to compile."""
    _LOG.warning("compiled kernels are not kept on disk: %s", reason)
