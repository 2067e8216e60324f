"""Client and server of libmodbus through ctypes, an independent C library (Debian `libmodbus5`)."""

from __future__ import annotations

import ctypes
import ctypes.util
import socket
from collections.abc import Sequence

_NEEDED = 128  # Twice the largest frame of our requests, below MODBUS_TCP_MAX_ADU_LENGTH.


class NoLibmodbusError(RuntimeError):
    """Error of a missing libmodbus."""


def library() -> ctypes.CDLL:
    """Return the library with the types of the functions used here; raise NoLibmodbusError."""
    for name in ("libmodbus.so.5", ctypes.util.find_library("modbus")):
        if name is None:
            continue
        try:
            lib = ctypes.CDLL(name, use_errno=True)
        except OSError:
            continue
        pointer = ctypes.c_void_p
        for function in ("modbus_new_tcp", "modbus_new_rtu", "modbus_mapping_new"):
            getattr(lib, function).restype = pointer
        lib.modbus_strerror.restype = ctypes.c_char_p
        lib.modbus_new_tcp.argtypes = [ctypes.c_char_p, ctypes.c_int]
        lib.modbus_new_rtu.argtypes = [ctypes.c_char_p, ctypes.c_int, ctypes.c_char, ctypes.c_int, ctypes.c_int]
        for function in ("modbus_connect", "modbus_close", "modbus_free"):
            getattr(lib, function).argtypes = [pointer]
        lib.modbus_set_slave.argtypes = [pointer, ctypes.c_int]
        for function in ("modbus_read_registers", "modbus_read_input_registers", "modbus_write_registers"):
            getattr(lib, function).argtypes = [pointer, ctypes.c_int, ctypes.c_int, pointer]
        lib.modbus_write_register.argtypes = [pointer, ctypes.c_int, ctypes.c_int]
        lib.modbus_tcp_listen.argtypes = [pointer, ctypes.c_int]
        lib.modbus_tcp_accept.argtypes = [pointer, ctypes.POINTER(ctypes.c_int)]
        lib.modbus_receive.argtypes = [pointer, pointer]
        lib.modbus_reply.argtypes = [pointer, pointer, ctypes.c_int, pointer]
        return lib
    raise NoLibmodbusError("libmodbus is not installed (Debian package libmodbus5)")


class Client:
    """Client of libmodbus; device id 1. Raises OSError with the library's own words."""

    def __init__(self, context: int, lib: ctypes.CDLL) -> None:
        self._lib = lib
        self._context = ctypes.c_void_p(context)
        lib.modbus_set_slave(self._context, 1)
        self._check(lib.modbus_connect(self._context))

    @classmethod
    def tcp(cls, port: int) -> Client:
        """Return a client of a port of this machine."""
        lib = library()
        return cls(lib.modbus_new_tcp(b"127.0.0.1", port), lib)

    @classmethod
    def rtu(cls, line: str) -> Client:
        """Return a client on a serial line at 115200 bit/s, 8N1."""
        lib = library()
        return cls(lib.modbus_new_rtu(line.encode(), 115200, b"N", 8, 1), lib)

    def _check(self, result: int) -> int:
        if result < 0:
            raise OSError(self._lib.modbus_strerror(ctypes.get_errno()).decode())
        return result

    def read_inputs(self, first: int, count: int) -> list[int]:
        """Read input registers."""
        found = (ctypes.c_uint16 * count)()
        self._check(self._lib.modbus_read_input_registers(self._context, first, count, found))
        return list(found)

    def read_holdings(self, first: int, count: int) -> list[int]:
        """Read holding registers."""
        found = (ctypes.c_uint16 * count)()
        self._check(self._lib.modbus_read_registers(self._context, first, count, found))
        return list(found)

    def write(self, first: int, values: Sequence[int]) -> None:
        """Write holding registers by function 16."""
        raw = (ctypes.c_uint16 * len(values))(*values)
        self._check(self._lib.modbus_write_registers(self._context, first, len(values), raw))

    def close(self) -> None:
        """Close and free."""
        self._lib.modbus_close(self._context)
        self._lib.modbus_free(self._context)


class _Mapping(ctypes.Structure):
    """Structure `modbus_mapping_t` of libmodbus 3.1."""

    _fields_ = (
        *(
            (name, ctypes.c_int)
            for name in (
                "nb_bits",
                "start_bits",
                "nb_input_bits",
                "start_input_bits",
                "nb_input_registers",
                "start_input_registers",
                "nb_registers",
                "start_registers",
            )
        ),
        ("bits", ctypes.POINTER(ctypes.c_uint8)),
        ("input_bits", ctypes.POINTER(ctypes.c_uint8)),
        ("input_registers", ctypes.POINTER(ctypes.c_uint16)),
        ("registers", ctypes.POINTER(ctypes.c_uint16)),
    )


def serve(line: str | None, count: int = 64) -> None:
    """Serve for ever on a free TCP port, which is printed first, or on a serial line. Register n holds 100 + n."""
    lib = library()
    mapping = lib.modbus_mapping_new(count, count, count, count)
    memory = ctypes.cast(mapping, ctypes.POINTER(_Mapping)).contents
    for n in range(count):
        memory.registers[n] = memory.input_registers[n] = 100 + n
        memory.bits[n] = memory.input_bits[n] = n % 3 == 0
    if line is not None:
        context = ctypes.c_void_p(lib.modbus_new_rtu(line.encode(), 115200, b"N", 8, 1))
        lib.modbus_set_slave(context, 1)
        lib.modbus_connect(context)
        print(0, flush=True)
        _answer(lib, context, mapping)
        return
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port = probe.getsockname()[1]
    context = ctypes.c_void_p(lib.modbus_new_tcp(b"127.0.0.1", port))
    listener = ctypes.c_int(lib.modbus_tcp_listen(context, 1))
    print(port, flush=True)
    while True:
        lib.modbus_tcp_accept(context, ctypes.byref(listener))
        _answer(lib, context, mapping)


def _answer(lib: ctypes.CDLL, context: ctypes.c_void_p, mapping: int) -> None:
    """Answer until the client has gone."""
    request = (ctypes.c_uint8 * (2 * _NEEDED + 4))()
    while (size := lib.modbus_receive(context, request)) >= 0:
        if size:
            lib.modbus_reply(context, request, size, ctypes.c_void_p(mapping))
