"""Cache of compiled kernels, in a folder that belongs to this user alone.

numba stores its index and its machine code as pickles, which are executed when they are read. So the folder must be
this user's own, closed to everybody else, and not in a shared temporary place. Every file in it is checked before use:
owner, permissions, and the SHA-256 noted when it was written. A file that does not pass is removed and compiled anew.
Without such a folder a kernel is compiled in a temporary one and forgotten.

Writers hold a file lock and replace files atomically, so that several processes can share the cache.
"""

from __future__ import annotations

import contextlib
import fcntl
import functools
import hashlib
import json
import logging
import math
import os
import shutil
import stat
import sys
import tempfile
import threading
from collections.abc import Callable, Iterator
from pathlib import Path
from types import ModuleType
from typing import Any

from twin.kernel.generated_code import BUILTINS, check_source, compile_tree

FOLDER = "hil-twin"
"""Name of the cache folder inside the user's cache directory."""
OTHERS_WRITE = stat.S_IWGRP | stat.S_IWOTH
_DIGESTS = "digests.json"
_LAYOUT = 2
"""Version of a kernel folder's layout; part of the key, so that folders of another version are ignored."""
FAST = {"contract", "nsz", "arcp"}
"""Freedom of rounding with which kernels are compiled: fused multiply-adds, sign of zero, reciprocals."""
_BUILDING = threading.Lock()
_log = logging.getLogger(__name__)


@functools.lru_cache(maxsize=64)
def compile_kernel(source: str) -> Callable[..., None]:
    """Return machine code for a generated source, from the disk cache where possible.

    Raises
    ------
    twin.kernel.generated_code.GeneratedCodeError
        The source holds more than a kernel needs.
    """
    import numba

    key = hashlib.sha256(f"{_LAYOUT}\n{numba.__version__}\n{sys.version}\n{source}".encode()).hexdigest()[:32]
    root = cache_root()
    if root is None:
        with tempfile.TemporaryDirectory(prefix=f"{FOLDER}-") as temporary:
            return _load(Path(temporary), key, source)
    folder = root / key
    with _locked(root / f"{key}.lock"):
        if not _intact(folder, source):
            shutil.rmtree(folder, ignore_errors=True)
        try:
            kernel = _load(folder, key, source)
        except Exception:
            # Files of a numba that was replaced in place raise any error of unpickling; a rebuild distinguishes a
            # useless cache from broken source.
            shutil.rmtree(folder, ignore_errors=True)
            kernel = _load(folder, key, source)
        _note(folder)
        return kernel


def cache_root() -> Path | None:
    """Return the cache's folder, private to this user, or None where there is no such place."""
    base = os.environ.get("XDG_CACHE_HOME")
    candidates = [Path(base) / FOLDER] if base else []
    with contextlib.suppress(RuntimeError):
        candidates.append(Path.home() / ".cache" / FOLDER)
    reasons = []
    for folder in candidates:
        try:
            folder.mkdir(parents=True, exist_ok=True, mode=0o700)
            folder = folder.resolve()
            reason = privacy_problem(folder)
            if not reason and stat.S_IMODE(folder.stat().st_mode) != 0o700:
                folder.chmod(0o700)
        except OSError as error:
            reason = f"cannot be used ({error.strerror})"
        if not reason:
            return folder
        reasons.append(f"{folder} {reason}")
    _no_cache("; ".join(reasons) or "this user has no home folder")
    return None


def privacy_problem(folder: Path) -> str:
    """Return why other users may put files into a folder, or "" for one that only this user can write.

    A folder above it counts where everybody may rename its contents, which the sticky bit of /tmp forbids.

    Raises
    ------
    OSError
        The folder cannot be read.
    """
    status = folder.stat()
    if status.st_uid != os.getuid():
        return "belongs to another user"
    if status.st_mode & OTHERS_WRITE:
        return "can be written by other users"
    for above in folder.parents:
        mode = above.stat().st_mode
        if mode & stat.S_IWOTH and not mode & stat.S_ISVTX:
            return f"lies in {above}, in which everybody may replace it"
    return "" if os.access(folder, os.W_OK) else "cannot be written"


def numba_may_cache() -> bool:
    """Return True if numba may store machine code where it is told to: beside the source, or in a private folder."""
    given = os.environ.get("NUMBA_CACHE_DIR")
    try:
        return not given or not privacy_problem(Path(given))
    except OSError:
        return False


def cache_folder(name: str) -> Path | None:
    """Return a folder of that name in the cache, beside the kernels, or None where nothing can be stored."""
    root = cache_root()
    if root is None:
        return None
    try:
        (root / name).mkdir(exist_ok=True, mode=0o700)
    except OSError:
        return None
    return root / name


@functools.cache
def _no_cache(reason: str) -> None:
    """Report once that nothing is stored."""
    _log.warning(
        "No cache for compiled twins, so every start compiles them anew: %s. Set XDG_CACHE_HOME to a folder of your "
        "own that nobody else may write (chmod 700).",
        reason,
    )


def _intact(folder: Path, source: str) -> bool:
    """Return True if a kernel's folder holds the source and just the noted files, unchanged and this user's."""
    try:
        noted = json.loads(_bytes(folder / _DIGESTS))
        found = {path.name: hashlib.sha256(_bytes(path)).hexdigest() for path in _kept(folder)}
        own = all(_ours(path, path.lstat()) for path in (folder, folder / "__pycache__"))
        return own and noted == found and _bytes(_source_file(folder)) == source.encode()
    except (OSError, ValueError):
        return False


def _note(folder: Path) -> None:
    """Note the digests of what numba has put into a kernel's folder."""
    with contextlib.suppress(OSError):
        found = {path.name: hashlib.sha256(_bytes(path)).hexdigest() for path in _kept(folder)}
        _replace(folder / _DIGESTS, json.dumps(found))


def _kept(folder: Path) -> list[Path]:
    return sorted((folder / "__pycache__").iterdir())


def _source_file(folder: Path) -> Path:
    return folder / f"kernel_{folder.name}.py"


def _bytes(path: Path) -> bytes:
    """Return the content of a regular file of this user that nobody else may write; links are not followed.

    Raises
    ------
    OSError
        The file is missing or is something else.
    """
    with open(os.open(path, os.O_RDONLY | os.O_NOFOLLOW), "rb") as file:
        if not _ours(path, os.fstat(file.fileno())):
            raise PermissionError(f"{path} is not this user's alone")
        return file.read()


def _ours(path: Path, status: os.stat_result) -> bool:
    kind = stat.S_ISREG(status.st_mode) or stat.S_ISDIR(status.st_mode)
    return kind and status.st_uid == os.getuid() and not status.st_mode & OTHERS_WRITE


def _replace(path: Path, text: str) -> None:
    with tempfile.NamedTemporaryFile("w", dir=path.parent, suffix=".tmp", delete=False, encoding="utf-8") as f:
        f.write(text)
    os.replace(f.name, path)


def _load(folder: Path, key: str, source: str) -> Callable[..., None]:
    """Run a kernel's source, checked; numba compiles its functions or takes them from the folder."""
    import numba
    import numpy as np

    given = {"nb": numba, "np": np, "log": math.log, "FAST": FAST}
    tree = check_source(source, given)
    folder.mkdir(parents=True, exist_ok=True, mode=0o700)
    (folder / "__pycache__").mkdir(exist_ok=True, mode=0o700)
    path = _source_file(folder)
    # numba compares the stamp of the source with that in its index, so an existing file stays untouched.
    if not path.exists() or path.read_bytes() != source.encode():
        _replace(path, source)
    module = ModuleType(f"hil_twin_kernel_{key}")
    module.__dict__.update({"__builtins__": dict(BUILTINS), "__file__": str(path), **given})
    # numba's cached code refers to its module by name while it is being loaded.
    sys.modules[module.__name__] = module
    with _BUILDING, _beside_the_source(numba.config), _operators_resolved_once():
        exec(compile_tree(tree, str(path)), module.__dict__)
    kernel: Callable[..., None] = module.__dict__["kernel"]
    return kernel


@contextlib.contextmanager
def _operators_resolved_once() -> Iterator[None]:
    """Have numba resolve an operator on the same scalar types once a kernel; a third of the time of compiling one.

    A kernel has some 1700 operations of 50 kinds, and numba searches its overloads for each of them. The signatures are
    the same ones. Threads that compile other functions meanwhile may share them.
    """
    from numba.core import types

    functions: Any = types.functions.BaseFunction
    resolve = functions.get_call_type
    known: dict[Any, Any] = {}

    def remembered(function: Any, context: Any, args: Any, kws: Any) -> Any:
        if kws or not all(isinstance(arg, types.Number | types.Boolean) for arg in args):
            return resolve(function, context, args, kws)
        key = (context, function, tuple(args))  # the context itself: an id may be given again
        if key not in known:
            known[key] = resolve(function, context, args, kws)
        return known[key]

    functions.get_call_type = remembered
    try:
        yield
    finally:
        functions.get_call_type = resolve


@contextlib.contextmanager
def _beside_the_source(config: Any) -> Iterator[None]:
    """Make numba store its files beside the source, because the folder that NUMBA_CACHE_DIR names may be shared."""
    elsewhere, config.CACHE_DIR = config.CACHE_DIR, ""
    try:
        yield
    finally:
        config.CACHE_DIR = elsewhere


@contextlib.contextmanager
def _locked(path: Path) -> Iterator[None]:
    with path.open("w") as handle:
        fcntl.flock(handle, fcntl.LOCK_EX)
        yield
