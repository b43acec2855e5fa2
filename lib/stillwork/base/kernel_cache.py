"""Numba's on-disk cache, keyed by content, filled by one process at a time, and repaired if damaged."""

import contextlib
import functools
import hashlib
import os
import pickle
import time
from pathlib import Path

from numba import config, types
from numba.core.caching import CompileResultCacheImpl, FunctionCache, _CacheLocator
from numba.core.compiler_lock import global_compiler_lock
from numba.core.serialize import dumps

from stillwork.base.garbage import no_collection
from stillwork.base.kernel_folder import cache_folder
from stillwork.base.kernel_sources import sources_digest

try:
    import fcntl
except ImportError:  # not a Unix: processes may compile the same function at once
    fcntl = None  # type: ignore[assignment]

PATIENCE = 120.0  # s; several times what the largest kernel takes on a busy machine


class CodeCache(FunctionCache):
    """Numba's cache of one function, of which one process at a time compiles what is not there.

    Machine code counts for the functions and constants that it was made from, wherever they stand. A file that cannot
    be read, as a crash or a full disk leave it, counts as absent; a file that cannot be written is left out. What the
    cache gives is time: it must not stop a calculation.
    """

    _turn = None  # the locked file, while this process compiles

    def serve(self, compiled):
        """Be the cache of a dispatcher or a callback. A turn to compile ends with its compilation, failed or not."""
        compile_any = compiled.compile

        @functools.wraps(compile_any)
        def compile_alone(*arguments):
            with global_compiler_lock, no_collection():  # numba's own lock, for a turn belongs to one thread
                outer = self._turn
                try:
                    return compile_any(*arguments)
                finally:
                    if outer is None and self._turn is not None:
                        _unlock(self._turn)
                        self._turn = None

        compiled._cache = self
        compiled.compile = compile_alone

    def load_overload(self, sig, target_context):
        found = self._look(sig, target_context)
        if found is None and self._turn is None:  # else a signature that the compilation of another one needs
            self._turn = _locked(os.path.join(self.cache_path, f"{self._impl.filename_base}.lock"))
            if self._turn is not None:
                found = self._look(sig, target_context)  # another process may have compiled it meanwhile
        return found

    def save_overload(self, sig, data):
        with contextlib.suppress(OSError):
            super().save_overload(sig, data)

    def _index_key(self, sig, codegen):
        return sig, codegen.magic_tuple(), sources_digest(self._py_func), _fields(getattr(sig, "args", sig))

    def _look(self, sig, target_context):
        try:
            return super().load_overload(sig, target_context)
        except Exception:  # bytes that are no pickle, or only half of one, may raise anything
            with contextlib.suppress(OSError):
                self.flush()  # saving reads the index again
            return None


def _fields(kinds) -> tuple:
    """Names of the fields of named tuples: machine code uses their positions."""
    tuples = [each for each in kinds if isinstance(each, types.BaseTuple)]
    return tuple((getattr(each, "fields", ()), _fields(getattr(each, "types", ()))) for each in tuples)


class _ContentLocator(_CacheLocator):
    """Place of a kernel's code: below `_folder`, by what the kernel's file says.

    Neither its path nor its time counts, so that a copy of the workbook finds what the original compiled.
    """

    def __init__(self, py_func, py_file):
        self._py_file = py_file
        self._line = py_func.__code__.co_firstlineno
        self._digest = hashlib.sha256(Path(py_file).read_bytes()).hexdigest()
        folder = f"{Path(py_file).parent.name}_{self._digest[:16]}"
        self._folder = os.path.join(_folder(), folder)

    def get_cache_path(self):
        return self._folder

    def get_source_stamp(self):
        return self._digest

    def get_disambiguator(self):
        return str(self._line)

    @classmethod
    def from_function(cls, py_func, py_file):
        """None, for numba to try its own places, where there is no file or no folder to write to."""
        if not os.path.isfile(py_file) or not _folder():
            return None
        try:
            locator = cls(py_func, py_file)
            os.makedirs(locator.get_cache_path(), exist_ok=True)
            os.utime(locator.get_cache_path())  # what is not used is removed
        except OSError:
            return None
        return locator


def _folder() -> str:
    """The user's folder for machine code, NUMBA_CACHE_DIR, or ours."""
    return config.CACHE_DIR or cache_folder()  # type: ignore[attr-defined]  # numba sets it from the environment


class _CheckedCode(CompileResultCacheImpl):
    """Machine code with its digest: a changed byte of it could end the process instead of raising an error."""

    _locator_classes = (_ContentLocator, *CompileResultCacheImpl._locator_classes)  # type: ignore[assignment]

    def reduce(self, cres):
        code = dumps(super().reduce(cres))
        return hashlib.sha256(code).digest(), code

    def rebuild(self, target_context, payload):
        digest, code = payload
        if hashlib.sha256(code).digest() != digest:
            raise ValueError("damaged machine code")
        return super().rebuild(target_context, pickle.loads(code))


class KernelCache(CodeCache):
    """The cache of a kernel of the package."""

    _impl_class = _CheckedCode  # type: ignore[assignment]


def _locked(path: str):
    """The file at `path`, locked; None where no lock is to be had within `PATIENCE`."""
    if fcntl is None:
        return None
    until = time.monotonic() + PATIENCE
    # An error: no folder to write to, or one without locks.
    with contextlib.suppress(OSError), contextlib.ExitStack() as opened:
        file = opened.enter_context(open(path, "ab"))
        while time.monotonic() < until:
            with contextlib.suppress(BlockingIOError):
                fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
                opened.pop_all()
                return file
            time.sleep(0.02)
    return None


def _unlock(file) -> None:
    fcntl.flock(file, fcntl.LOCK_UN)  # closing alone would leave it to a process that was forked meanwhile
    file.close()
