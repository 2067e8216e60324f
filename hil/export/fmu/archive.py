"""Export of a twin as an FMU: its C code, compiled where there is a compiler, and its description in one archive."""

from __future__ import annotations

import html
import platform
import shutil
import subprocess
import sys
import tempfile
import uuid
import zipfile
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO

import numpy as np

from hil.export.content import ExportError
from hil.export.fmu.description import FmuVariable, description_xml, model_identifier
from hil.export.fmu.interface import interface_source
from hil.export.target import require_suffix, write_files
from twin import STAMP, Network, load
from twin.kernel import CSource, c_source

SOURCE_FILE = "twin.c"
COMPILERS = ("cc", "gcc", "clang")
"""Compilers that are looked for, in order."""
COMPILE_S = 300.0
"""Longest time of a compiler, s; the largest twin that ships takes about two."""
_OLDEST = (1980, 1, 1, 0, 0, 0)
"""Date of all files in the archive, the first that ZIP has: one twin gives one archive, byte for byte."""


@dataclass(frozen=True)
class ExportedTwin:
    """FMU that was written, and a sentence where it holds sources alone, else ""."""

    path: Path
    remark: str


def export_twin(twin: Path, out: Path | None = None, *, force: bool = False) -> ExportedTwin:
    """Write the twin file `twin` as an FMU for co-simulation (FMI 2.0), which needs no Python where it runs.

    Inputs are the columns of the twin, outputs its sensors and meters. Tunable parameters may be set at any time, the
    temperature of each node before the start. The FMU holds C code, and on Linux a library for this processor.

    Parameters
    ----------
    twin
        Twin file of a network.
    out
        File to write; by default `<name of the twin>.fmu` in the working directory.
    force
        Replace a file that exists.

    Raises
    ------
    ExportError
        The file exists or cannot be written, or the compiler refuses the code.
    TwinFileError
        The twin cannot be read.
    """
    network = load(twin)
    identifier = model_identifier(network.name)
    path = out or Path(f"{identifier}.fmu")
    require_suffix(path, "fmu")
    kernel = c_source(network)
    variables = list(_variables(network))
    guid = _guid(network, kernel)
    code = interface_source(kernel.text, _numbers(network, kernel), _tables(network), guid)
    library, remark = _compiled(code, identifier)
    members = {
        "modelDescription.xml": description_xml(network.name, network.title, guid, variables, [SOURCE_FILE]),
        f"sources/{SOURCE_FILE}": code.encode(),
        "documentation/index.html": _page(network, variables).encode(),
    }
    if library is not None:
        members[f"binaries/linux64/{identifier}.so"] = library

    def write(file: BinaryIO) -> None:
        with zipfile.ZipFile(file, "w", zipfile.ZIP_DEFLATED) as archive:
            for name, content in members.items():
                member = zipfile.ZipInfo(name, _OLDEST)
                member.compress_type = zipfile.ZIP_DEFLATED
                archive.writestr(member, content)

    write_files({path: write}, force, [twin])
    return ExportedTwin(path, remark)


def _tunables(network: Network) -> tuple[str, ...]:
    return tuple(p.id for p in network.parameters.values() if p.status == "tunable" and not p.same_as)


def _start_temperatures(network: Network) -> list[float]:
    nowhere = np.full(len(network.instruments), np.nan)
    return [float(value) for value in network.initial_state(nowhere)]


def _variables(network: Network) -> Iterator[FmuVariable]:
    """Yield the variables of the FMU in the order of their references (see `hil.export.fmu.interface`)."""
    for column in network.recorded_inputs:
        spec = network.inputs[column]
        bounds = (spec.nominal, spec.lower, spec.upper)
        yield FmuVariable(column, spec.unit, "input", "continuous", spec.source, *bounds)
    taken = set(network.inputs)
    units = {meter.name: network.parameters[f"{meter.name}.sigma"].unit for meter in network.meters}
    for sensor in network.instruments:
        name = sensor.name if sensor.name not in taken else f"{sensor.name}_reading"
        read = f"reads {', '.join(sensor.measured)}"
        yield FmuVariable(name, units.get(sensor.name, "degC"), "output", "continuous", read)
    for name in _tunables(network):
        p = network.parameters[name]
        yield FmuVariable(name, p.unit, "parameter", "tunable", p.source, p.value, p.lower, p.upper)
    for node, start in zip(network.nodes, _start_temperatures(network), strict=True):
        yield FmuVariable(f"{node}.initial", "degC", "parameter", "fixed", "temperature at the start", start)


def _numbers(network: Network, kernel: CSource) -> dict[str, int]:
    return {
        "PARAMETERS": len(network.ids),
        "NODES": len(network.nodes),
        "COLUMNS": len(network.input_columns),
        "INPUTS": len(network.recorded_inputs),
        "READINGS": len(network.instruments),
        "TUNABLES": len(_tunables(network)),
        "WIDTH": kernel.width,
        "ROWS": kernel.rows,
        "STAMP": network.input_columns.index(STAMP) if STAMP in network.inputs else -1,
        "LOOKS_BACK": int(kernel.looks_back),
    }


def _tables(network: Network) -> dict[str, list[float]]:
    return {
        "start_parameters": [float(value) for value in network.values],
        "start_temperatures": _start_temperatures(network),
        "start_inputs": [float(value) for value in network.nominal_inputs],
        "input_columns": [network.input_columns.index(column) for column in network.recorded_inputs],
        "tunable_parameters": [int(k) for k in network.index(_tunables(network))],
    }


def _guid(network: Network, kernel: CSource) -> str:
    """Return an identity that follows from the twin and the kernel's code alone."""
    return "{" + str(uuid.uuid5(uuid.NAMESPACE_OID, f"{network.digest}\n{kernel.text}")) + "}"


def _compiled(code: str, identifier: str) -> tuple[bytes | None, str]:
    """Return the shared library for Linux on x86-64, or None and the reason.

    Raises
    ------
    ExportError
        The compiler refuses the code, or takes too long.
    """
    compiler = next((found for name in COMPILERS if (found := shutil.which(name))), None)
    rest = f"the FMU holds its source alone, sources/{SOURCE_FILE}, which most importing tools compile"
    if compiler is None:
        return None, f"no C compiler is installed ({', '.join(COMPILERS)}): {rest}"
    if sys.platform != "linux" or platform.machine() != "x86_64":
        return (
            None,
            f"a library is made for Linux on x86-64, and this is {sys.platform} on {platform.machine()}: {rest}",
        )
    with tempfile.TemporaryDirectory(prefix="hil-fmu-") as folder:
        source, library = Path(folder, SOURCE_FILE), Path(folder, f"{identifier}.so")
        source.write_text(code, encoding="utf-8")
        options = ["-std=c99", "-O2", "-fPIC", "-shared", "-fvisibility=hidden"]
        try:
            done = subprocess.run(
                [compiler, *options, str(source), "-o", str(library), "-lm"],
                capture_output=True,
                text=True,
                timeout=COMPILE_S,
                check=False,
            )
        except subprocess.TimeoutExpired:
            raise ExportError(f"{compiler} took more than {COMPILE_S:g} s; export a twin with fewer elements") from None
        if done.returncode or not library.is_file():
            first = (done.stderr.strip().splitlines() or ["no message"])[0]
            raise ExportError(f"{compiler} refuses the code of the twin ({first}); set PATH to a C99 compiler")
        return library.read_bytes(), ""


def _page(network: Network, variables: list[FmuVariable]) -> str:
    """Return the page of the FMU's documentation."""
    rows = "".join(
        f"<tr>{''.join(f'<td>{html.escape(text)}</td>' for text in (v.causality, v.name, v.unit, v.description))}</tr>"
        for v in variables
    )
    return (
        f"<!doctype html><meta charset='utf-8'><title>{html.escape(network.name)}</title>"
        f"<h1>{html.escape(network.title or network.name)}</h1>"
        "<p>Inputs hold from the start of a communication step to its end. A missing input (NaN) holds the last good "
        f"value.</p><table><tr><th>kind<th>name<th>unit<th>description</tr>{rows}</table>"
    )
