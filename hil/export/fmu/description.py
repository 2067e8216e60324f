"""Description of an FMU, `modelDescription.xml` of FMI 2.0.4: variables with units, start values and bounds."""

from __future__ import annotations

import re
import xml.etree.ElementTree as ElementTree
from collections.abc import Iterable
from dataclasses import dataclass

from hil import __version__

STEP_S = 1.0
"""Step of the default experiment, s: the sample period of most rigs. Any other step may be used."""
STOP_S = 3600.0
"""End of the default experiment, s: some time constants of a thermal rig."""
_BASE_UNITS: dict[str, dict[str, str]] = {
    "degC": {"K": "1", "offset": "273.15"},
    "K": {"K": "1"},
    "s": {"s": "1"},
    "ms": {"s": "1", "factor": "1e-3"},
    "W": {"kg": "1", "m": "2", "s": "-3"},
    "kW": {"kg": "1", "m": "2", "s": "-3", "factor": "1e3"},
    "J/K": {"kg": "1", "m": "2", "s": "-2", "K": "-1"},
    "W/K": {"kg": "1", "m": "2", "s": "-3", "K": "-1"},
    "K/W": {"kg": "-1", "m": "-2", "s": "3", "K": "1"},
    "J/(kg K)": {"m": "2", "s": "-2", "K": "-1"},
    "kg/s": {"kg": "1", "s": "-1"},
    "m/s": {"m": "1", "s": "-1"},
    "kPa": {"kg": "1", "m": "-1", "s": "-2", "factor": "1e3"},
    "kg/m3": {"kg": "1", "m": "-3"},
    "K/h": {"K": "1", "s": "-1", "factor": repr(1.0 / 3600.0)},
    "L/min": {"m": "3", "s": "-1", "factor": repr(1e-3 / 60.0)},
    "L/s": {"m": "3", "s": "-1", "factor": "1e-3"},
    "%": {"factor": "0.01"},
    "1": {},
}
"""Unit -> exponents of SI base units, factor and offset (FMI 2.0.4, 2.2.2); other units have a name alone."""


@dataclass(frozen=True)
class FmuVariable:
    """Real variable of an FMU: `causality` is input, output or parameter; `start` and bounds are in `unit`."""

    name: str
    unit: str
    causality: str
    variability: str
    description: str = ""
    start: float | None = None
    lower: float | None = None
    upper: float | None = None


def model_identifier(name: str) -> str:
    """Return a twin's name as an identifier of C, which FMI asks of a model."""
    plain = re.sub(r"\W", "_", name, flags=re.ASCII)
    return plain if re.match(r"[A-Za-z]", plain) else f"twin_{plain}"


def description_xml(
    name: str, title: str, guid: str, variables: Iterable[FmuVariable], source_files: Iterable[str]
) -> bytes:
    """Return `modelDescription.xml`; references of the variables count from 0 in their order."""
    variables = list(variables)
    root = ElementTree.Element(
        "fmiModelDescription",
        fmiVersion="2.0",
        modelName=name,
        guid=guid,
        description=title,
        generationTool=f"hil {__version__}",
        variableNamingConvention="flat",
        numberOfEventIndicators="0",
    )
    kind = ElementTree.SubElement(
        root,
        "CoSimulation",
        modelIdentifier=model_identifier(name),
        canHandleVariableCommunicationStepSize="true",
        canNotUseMemoryManagementFunctions="true",
    )
    files = ElementTree.SubElement(kind, "SourceFiles")
    for file in source_files:
        ElementTree.SubElement(files, "File", name=file)
    units = ElementTree.SubElement(root, "UnitDefinitions")
    for unit in dict.fromkeys(variable.unit for variable in variables if variable.unit):
        defined = ElementTree.SubElement(units, "Unit", name=unit)
        if unit in _BASE_UNITS:
            ElementTree.SubElement(defined, "BaseUnit", _BASE_UNITS[unit])
    ElementTree.SubElement(root, "DefaultExperiment", startTime="0.0", stopTime=repr(STOP_S), stepSize=repr(STEP_S))
    listed = ElementTree.SubElement(root, "ModelVariables")
    for reference, variable in enumerate(variables):
        _add_variable(listed, reference, variable)
    structure = ElementTree.SubElement(root, "ModelStructure")
    outputs = [str(k) for k, variable in enumerate(variables, start=1) if variable.causality == "output"]
    for part in ("Outputs", "InitialUnknowns"):
        section = ElementTree.SubElement(structure, part)
        for index in outputs:
            ElementTree.SubElement(section, "Unknown", index=index)
    ElementTree.indent(root)
    return bytes(ElementTree.tostring(root, encoding="utf-8", xml_declaration=True))


def _add_variable(parent: ElementTree.Element, reference: int, variable: FmuVariable) -> None:
    scalar = ElementTree.SubElement(
        parent,
        "ScalarVariable",
        name=variable.name,
        valueReference=str(reference),
        causality=variable.causality,
        variability=variable.variability,
    )
    if variable.description:
        scalar.set("description", variable.description)
    real = ElementTree.SubElement(scalar, "Real")
    if variable.unit:
        real.set("unit", variable.unit)
    for key, value in (("min", variable.lower), ("max", variable.upper), ("start", variable.start)):
        if value is not None and abs(value) != float("inf"):
            real.set(key, repr(float(value)))
