"""Transport by test, as it came out: the table of the contract suite."""

from __future__ import annotations

from pathlib import Path

import pytest

from hil.bench.measure.machine import manifest

_SUITES = {
    "test_modbus_contract": "Modbus: the same device on every transport",
    "test_can_contract": "CAN: the same frames on every interface",
    "test_same_rig_file": "One rig file on the virtual rig: only the bus section differs",
    "test_shared_lines": "Several devices on one wire",
    "test_gateway": "A gateway that is a reply behind",
    "test_naive": "Traps: what the libraries by themselves do",
    "test_interop": "Strangers: programs and libraries that we did not write",
}

_NOTES = {
    "test_modbus_contract": "What the device holds changes before every read. A value that is good and not what it "
    "held, or not good and yet a number, fails the test.",
    "test_naive": "Passed: the trap is there. Plain pymodbus, python-can and cantools, on the same devices and wires.",
}


class Table:
    """Outcomes by suite, test and transport."""

    def __init__(self) -> None:
        self._found: dict[str, dict[str, dict[str, str]]] = {}

    def note(self, item: pytest.Item, report: pytest.TestReport) -> None:
        """One phase of one test."""
        suite = item.nodeid.split("::")[0].rsplit("/", 1)[-1].removesuffix(".py")
        if suite not in _SUITES:
            return
        transport = str((getattr(item, "callspec", None) and item.callspec.params.get("transport")) or "")
        name = getattr(item, "originalname", item.name).removeprefix("test_").replace("_", " ")
        fault = getattr(item, "callspec", None) and item.callspec.params.get("fault")
        name = name.replace("a fault", str(fault)) if fault else name
        stranger = getattr(item, "callspec", None) and item.callspec.params.get("stranger")
        name = f"{name} {stranger}" if stranger else name
        row = self._found.setdefault(suite, {}).setdefault(name, {})
        if report.failed:
            row[transport] = "FAILED"
        elif report.skipped:
            row[transport] = f"left out: {report.longrepr[2].removeprefix('Skipped: ')}"  # type: ignore[index]
        elif report.when == "call":
            row.setdefault(transport, "passed")

    def write(self, path: Path) -> None:
        """Markdown, one table a suite."""
        made = manifest("python -m pytest tests/contract --contract-table docs/results/contract.md", 0)
        lines = ["# Contract suite: transport by test", "", f"`{made['command']}`", "", f"{made['date']}.", ""]
        for suite, title in _SUITES.items():
            rows = self._found.get(suite)
            if not rows:
                continue
            transports = list(dict.fromkeys(t for row in rows.values() for t in row))
            note = [_NOTES[suite], ""] if suite in _NOTES else []
            lines += [f"## {title}", "", *note, "| test | " + " | ".join(t or "outcome" for t in transports) + " |"]
            lines += ["|---" * (1 + len(transports)) + "|"]
            lines += [
                "| " + " | ".join([name, *(row.get(t, "") for t in transports)]) + " |" for name, row in rows.items()
            ]
            lines += [""]
        path.write_text("\n".join(lines), encoding="utf-8")
