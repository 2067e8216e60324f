"""Machine code of a compiled function, kept as an object file, so that a rig starts without a compiler.

To import numba and to have it read its own cache takes a second of processor time; an object file takes a twentieth
of that. numba compiles where there is no file yet, or where a source, the processor or llvmlite is another.
"""

from __future__ import annotations

import contextlib
import ctypes
import hashlib
import os
import stat
import tempfile
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, TypeVar

import llvmlite
from llvmlite import binding as llvm

_LAYOUT = 1
"""Version of the file's layout and of the calling convention; part of the key."""
_DIGEST = 32
_Kernel = TypeVar("_Kernel", bound=Callable[..., Any])
_KEPT: list[Any] = []
"""Engines that hold the machine code of this process."""


def may_cache() -> bool:
    """Return True where the folder of NUMBA_CACHE_DIR, if set, is this user's and nobody else may write it.

    numba unpickles, so executes, the files of its cache. Beside the source it is as safe as the source itself.
    """
    given = os.environ.get("NUMBA_CACHE_DIR")
    if not given:
        return True
    try:
        return _ours(Path(given).stat())
    except OSError:
        return False


def compiled_kernel(function: _Kernel) -> _Kernel:
    """Mark a function that numba compiles and nothing else calls; return it as it is."""
    return function


def machine_code(
    name: str, compiled: Callable[[], tuple[str, str]], sources: Sequence[Path], arguments: Sequence[Any]
) -> Callable[..., int]:
    """Return a function as machine code, from the cache where possible.

    Parameters
    ----------
    name
        Name of the function in its file.
    compiled
        Compiles it; returns its LLVM code and its name there. First it takes two addresses of a pointer each, as
        numba's functions do: for a result, and for an error.
    sources
        Files on which it depends.
    arguments
        Types of its arguments, of ctypes.
    """
    llvm.initialize_native_target()
    llvm.initialize_native_asmprinter()
    processor = f"{llvm.get_host_cpu_name()} {llvm.get_host_cpu_features().flatten()}"
    key = hashlib.sha256(f"{_LAYOUT} {llvmlite.__version__} {processor}".encode())
    for source in (*sources, Path(__file__)):
        key.update(source.read_bytes())
    folder = _folder()
    path = None if folder is None else folder / f"{name}-{key.hexdigest()[:32]}.o"
    code = None if path is None else _read(path)
    if code is None:
        code = _emitted(name, *compiled())
        if path is not None:
            _write(path, code)
    engine = llvm.create_mcjit_compiler(llvm.parse_assembly(""), _machine())
    engine.add_object_file(llvm.ObjectFileRef.from_data(code))
    engine.finalize_object()
    _KEPT.append(engine)
    function = ctypes.CFUNCTYPE(ctypes.c_int32, ctypes.c_void_p, ctypes.c_void_p, *arguments)
    return function(engine.get_function_address(name))


def _machine() -> Any:
    return llvm.Target.from_default_triple().create_target_machine(
        cpu=llvm.get_host_cpu_name(),
        features=llvm.get_host_cpu_features().flatten(),
        opt=3,
        codemodel="jitdefault",
        jit=True,
    )


def _emitted(name: str, text: str, known_as: str) -> bytes:
    """Return the object file of LLVM code whose function `known_as` is called `name` there; the others are its own."""
    module = llvm.parse_assembly(text)
    for entry in (*module.functions, *module.global_variables):
        if entry.name == known_as:
            entry.name = name
        elif not entry.is_declaration:
            entry.linkage = "internal"
    # What is left over after inlining, such as the counters of references, names functions of numba's own library.
    machine = _machine()
    builder = llvm.create_pass_builder(machine, llvm.create_pipeline_tuning_options(speed_level=1))
    builder.getModulePassManager().run(module, builder)
    code: bytes = machine.emit_object(module)
    return code


def _folder() -> Path | None:
    """Return the folder of the files: beside the source as Python's own, else in the user's cache; None without one."""
    given = os.environ.get("NUMBA_CACHE_DIR")
    if given:
        return Path(given) if may_cache() else None
    beside = Path(__file__).parent / "__pycache__"
    with contextlib.suppress(OSError):
        beside.mkdir(exist_ok=True)
        if os.access(beside, os.W_OK):
            return beside
    with contextlib.suppress(OSError, RuntimeError):
        folder = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "hil-virtual-rig"
        folder.mkdir(parents=True, exist_ok=True, mode=0o700)
        return folder if _ours(folder.stat()) else None
    return None


def _ours(status: os.stat_result) -> bool:
    return status.st_uid == os.getuid() and not status.st_mode & (stat.S_IWGRP | stat.S_IWOTH)


def _read(path: Path) -> bytes | None:
    """Return the machine code of a file, or None for one that is missing, damaged or not this user's."""
    try:
        with open(os.open(path, os.O_RDONLY | os.O_NOFOLLOW | os.O_NONBLOCK), "rb") as file:
            status = os.fstat(file.fileno())
            if not stat.S_ISREG(status.st_mode) or not _ours(status):
                return None
            content = file.read()
    except OSError:
        return None
    digest, code = content[:_DIGEST], content[_DIGEST:]
    return code if hashlib.sha256(code).digest() == digest else None


def _write(path: Path, code: bytes) -> None:
    """Keep machine code where that is possible; several processes may do so at once."""
    with contextlib.suppress(OSError):
        handle, name = tempfile.mkstemp(dir=path.parent, suffix=".tmp")
        try:
            with open(handle, "wb") as file:
                file.write(hashlib.sha256(code).digest() + code)
            os.replace(name, path)
        except OSError:
            os.unlink(name)
