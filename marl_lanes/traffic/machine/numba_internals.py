"""The only module that uses private names of numba.

They only save time. Each name is looked for when this module is imported. Without it the results of
the kernels are the same, but they start or run more slowly.
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
    """One digest of all source files below a folder."""
    digest = hashlib.sha256()
    for path in sorted(folder.rglob("*.py")):
        digest.update(path.read_bytes())
    return digest.hexdigest()


SOURCES = hash_sources(Path(__file__).parents[1])
"""Digest of all sources of the simulation."""

# The classes of numba's cache: the cache of a kernel, and the content of its files.
_Cache: Any = getattr(caching, "FunctionCache", object)
_Content: Any = getattr(caching, "CompileResultCacheImpl", object)
# If one of these were missing, numba would cache kernels without the digest, and use stale ones.
CAN_KEEP = hasattr(_Cache, "_impl_class") and all(
    hasattr(kind, name)
    for kind, names in (
        (_Cache, ("load_overload", "save_overload", "flush")),
        (_Content, ("reduce", "rebuild")),
    )
    for name in names
)
"""Whether kernels can be cached on disk."""


class Checked:
    """Content of a cache with two digests: of all sources of the simulation, and of its bytes.

    Numba invalidates a cached kernel only when its own file changes, although the kernel contains
    the code of the kernels that it calls: the first digest finds changes of the others. Numba may
    not notice a file that a crash or a full disk has damaged: the second digest does.
    """

    def reduce(self, data: Any) -> tuple[str, bytes, bytes]:
        """What is written of a compiled kernel."""
        content = _dumps(super().reduce(data))  # type: ignore[misc]
        return SOURCES, hashlib.sha256(content).digest(), content

    def rebuild(self, target_context: Any, reduced_data: Any) -> Any:
        """The kernel again; a ValueError if the content is stale or damaged."""
        sources, digest, content = reduced_data
        if sources != SOURCES or digest != hashlib.sha256(content).digest():
            raise ValueError("stale or damaged")
        # As safe as numba's own cache, which uses pickle, too.
        kept = pickle.loads(content)  # noqa: S301
        return super().rebuild(target_context, kept)  # type: ignore[misc]


class Lenient:
    """A cache on disk of which a file that cannot be read or written is a miss."""

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        """The cached kernel; None if there is none, or it cannot be used."""
        try:
            found = super().load_overload(sig, target_context)  # type: ignore[misc]
            # Two processes that wrote at once may have left the code of other types.
            if found is not None and tuple(found.signature.args) != tuple(sig):
                raise ValueError("of other types")
            return found
        except Exception:
            # Damaged bytes can raise almost any error. The next save would fail on them, too.
            with suppress(OSError):
                super().flush()  # type: ignore[misc]
            return None

    def save_overload(self, sig: Any, data: Any) -> None:
        """Cache a kernel if possible."""
        try:
            super().save_overload(sig, data)  # type: ignore[misc]
        except Exception as error:
            _note_loss(getattr(error, "strerror", None) or type(error).__name__)


class _CheckedContent(Checked, _Content):  # type: ignore[misc]
    """A kernel of the CPU, checked."""


class KernelCache(Lenient, _Cache):  # type: ignore[misc]
    """Numba's cache of a kernel of the CPU."""

    _impl_class = _CheckedContent


def open_cache(kind: Any, function: Any, can_keep: bool, compiler: str) -> Any:
    """A cache of this kind for a kernel; None, and a line in the log, if there can be none.

    Args:
        kind: class of the cache.
        function: the kernel's Python function.
        can_keep: whether the compiler has what the cache uses of it.
        compiler: its name.
    """
    if not can_keep:
        _note_loss(f"this version of {compiler} is not known")
        return None
    try:
        return kind(function)
    except (OSError, RuntimeError):
        _note_loss("no folder for them can be written; name one in NUMBA_CACHE_DIR")
        return None


class Kernel(CPUDispatcher):
    """A compiled function, cached on disk if possible."""

    def enable_caching(self) -> None:
        """Find a writable folder for the cache; without one the kernel is compiled in memory."""
        cache = open_cache(KernelCache, self.py_func, CAN_KEEP, "numba")
        if cache is not None:
            self._cache = cache


class InternalKernel(CPUDispatcher):
    """A kernel without an entry point from Python, where a call would crash the interpreter."""

    def __call__(self, *_: Any, **__: Any) -> Any:
        """Raise TypeError."""
        raise TypeError(f"{self.py_func.__name__}() can be called by other kernels only")


NO_COUNTING = {"_nrt": False}
"""The option of kernels that own no array and count no references, which takes half of the time."""


def known_options(**options: bool) -> dict[str, bool]:
    """The options that this numba has, out of these, which only save time."""
    known = CPUDispatcher.targetdescr.options
    return {name: value for name, value in options.items() if hasattr(known, name)}


@contextmanager
def unused_scipy() -> Iterator[None]:
    """Let numba load its modules without importing SciPy, which would take 0.2 s.

    Numba imports SciPy only to check whether it can compile linear algebra. When it compiles linear
    algebra, it still imports SciPy.
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
    """Log once why every start will compile the kernels again."""
    _LOG.warning("compiled kernels are not kept on disk: %s", reason)
