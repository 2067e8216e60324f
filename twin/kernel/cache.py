"""Compilation of kernels, and a cache of their machine code in a folder that belongs to this user alone.

Machine code is executed as it is read. So the folder must be this user's own, closed to everybody else, and not in a
shared temporary place. Every file in it is checked before use: owner, permissions, and the SHA-256 in front of the
code. A file that does not pass is compiled anew. Without such a folder nothing is stored.

Files are replaced atomically, so that several processes can share the cache.
"""

from __future__ import annotations

import contextlib
import ctypes
import functools
import hashlib
import logging
import os
import stat
import tempfile
from array import array
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import llvmlite
import numpy as np
from llvmlite import binding as llvm

from twin.kernel.generated_code import KERNEL_NAMES, check_source
from twin.kernel.llvm_translator import AXES, ENTRY, llvm_text
from twin.kernel.typed_source import Kind, ModuleKinds

FOLDER = "hil-twin"
"""Name of the cache folder inside the user's cache directory."""
OTHERS_WRITE = stat.S_IWGRP | stat.S_IWOTH
_TRANSLATION = ("typed_source.py", "llvm_translator.py", "cache.py")
"""Modules of which the machine code of a source depends; they are part of the key."""
_DIGEST = 32
_log = logging.getLogger(__name__)


@functools.lru_cache(maxsize=64)
def compile_kernel(source: str) -> Callable[..., None]:
    """Return machine code for a generated source, from the disk cache where possible.

    The function takes arrays in C order, of the types in the source, and numbers. It releases Python's lock.

    Raises
    ------
    twin.kernel.generated_code.GeneratedCodeError
        The source holds more than a kernel needs.
    """
    tree = check_source(source, KERNEL_NAMES)
    llvm.initialize_native_target()
    llvm.initialize_native_asmprinter()
    processor = f"{llvm.get_host_cpu_name()} {llvm.get_host_cpu_features().flatten()}"
    given = f"{_translation()}\n{llvmlite.__version__}\n{processor}\n{source}"
    key = hashlib.sha256(given.encode()).hexdigest()[:32]
    root = cache_root()
    path = None if root is None else root / f"{key}.o"
    code = None if path is None else _read(path)
    if code is None:
        code = _compiled(llvm_text(tree))
        if path is not None:
            _write(path, code)
    return _MachineCode(code, ModuleKinds(tree).functions[ENTRY].parameters)


@functools.cache
def _translation() -> str:
    """Return the SHA-256 of this version of the translation and of the calling convention."""
    found = hashlib.sha256()
    for name in _TRANSLATION:
        found.update(Path(__file__).with_name(name).read_bytes())
    return found.hexdigest()


def _machine() -> Any:
    return llvm.Target.from_default_triple().create_target_machine(
        cpu=llvm.get_host_cpu_name(),
        features=llvm.get_host_cpu_features().flatten(),
        opt=3,
        codemodel="jitdefault",
        jit=True,
    )


def _compiled(text: str) -> bytes:
    """Return LLVM assembly as an object file."""
    module, machine = llvm.parse_assembly(text), _machine()
    module.verify()
    options = llvm.create_pipeline_tuning_options(speed_level=3)
    options.loop_vectorization = options.slp_vectorization = True
    # Unrolled loops take half as long again to compile and are no faster: the lanes' loops are short vectors already.
    options.loop_unrolling = False
    builder = llvm.create_pass_builder(machine, options)
    builder.getModulePassManager().run(module, builder)
    code: bytes = machine.emit_object(module)
    return code


class _MachineCode:
    """An object file in memory, called as a function of arrays and numbers; its memory is freed with it."""

    def __init__(self, code: bytes, parameters: Sequence[Kind]) -> None:
        self._engine = llvm.create_mcjit_compiler(llvm.parse_assembly(""), _machine())
        self._engine.add_object_file(llvm.ObjectFileRef.from_data(code))
        self._engine.finalize_object()
        self._entry = ctypes.CFUNCTYPE(None, ctypes.c_void_p)(self._engine.get_function_address(ENTRY))
        self._parameters = [
            (kind.axes, np.dtype(np.int64 if kind.whole else np.float64), [1] * (AXES - kind.axes))
            for kind in parameters
        ]

    def __call__(self, *arguments: Any) -> None:
        words: list[int] = []
        for given, (axes, dtype, rest) in zip(arguments, self._parameters, strict=True):
            if axes:
                if given.ndim != axes or given.dtype != dtype or not given.flags.c_contiguous:
                    raise TypeError(
                        f"a kernel takes {axes} axes of {dtype} in C order, and got {given.ndim} of {given.dtype}"
                        f"{'' if given.flags.c_contiguous else ' in another order'}"
                    )
                words += (given.__array_interface__["data"][0], *given.shape, *rest)
            else:
                words.append(given if dtype.kind == "i" else int(np.float64(given).view(np.int64)))
        packed = array("q", words)
        self._entry(packed.buffer_info()[0])


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


def _read(path: Path) -> bytes | None:
    """Return the machine code of a file; None for one that is missing, damaged, a link, or not this user's alone."""
    try:
        with open(os.open(path, os.O_RDONLY | os.O_NOFOLLOW | os.O_NONBLOCK), "rb") as file:
            status = os.fstat(file.fileno())
            if not stat.S_ISREG(status.st_mode) or status.st_uid != os.getuid() or status.st_mode & OTHERS_WRITE:
                return None
            content = file.read()
    except OSError:
        return None
    digest, code = content[:_DIGEST], content[_DIGEST:]
    return code if hashlib.sha256(code).digest() == digest else None


def _write(path: Path, code: bytes) -> None:
    """Keep machine code where that is possible."""
    with contextlib.suppress(OSError):
        handle, name = tempfile.mkstemp(dir=path.parent, suffix=".tmp")
        try:
            with open(handle, "wb") as file:
                file.write(hashlib.sha256(code).digest() + code)
            os.replace(name, path)
        except OSError:
            os.unlink(name)
