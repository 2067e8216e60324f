"""Knowing side of the trial: draws a hidden effect, seals it, and makes a record of a rig that has it.

    python -m hil.bench.discovery.injector SEALED

Truths are written to the folder SEALED, and only their hashes are told. Requests: `direct` (a record without wires),
`serve` (a virtual rig in lockstep, over Modbus and CAN), `stop` and, once a truth is opened, `without`: what the rig
would have shown but for each of its effects, weather and noise as they were; so it is judged what was to be seen.
"""

from __future__ import annotations

import asyncio
import hashlib
import json
import sys
from collections.abc import Collection
from pathlib import Path
from typing import TYPE_CHECKING, Any

from hil.bench.discovery.worker import Request, serve
from hil.synthetic import Setting, Truth, effects_text, profile, truth

if TYPE_CHECKING:
    from drivers.virtual import VirtualRig

RIG = Path(__file__).resolve().parents[3] / "profiles" / "rigs" / "virtual.toml"


class Injector:
    """Keeper of the truths in the folder `sealed`."""

    def __init__(self, sealed: Path) -> None:
        self._sealed = sealed
        self._loop = asyncio.new_event_loop()
        self._rig: VirtualRig | None = None

    def answer(self, request: Request) -> Request:
        """Carry out a request; the answer holds only the hash of the truth."""
        if request["do"] == "stop":
            self._stop()
            return {}
        case = Setting(**request["setting"])
        hidden = truth(case.number, request["draw"], case.hours, request["kind"])
        name = f"{request['kind']}_{case.number}"
        digest = seal(hidden, self._sealed / f"{name}.json")
        effects = self._effects(hidden, name)
        if request["do"] == "direct":
            self._direct(case, effects, Path(request["record"]))
            return {"sealed": digest}
        if request["do"] == "without":
            made = Path(request["record"]) if request["record"] else None
            return {"records": self._without(case, hidden, effects, Path(request["folder"]), made)}
        self._stop()
        self._rig = self._loop.run_until_complete(self._start(case, effects))
        rig = self._rig
        ports = {"modbus": rig.modbus_port, "can": rig.can_port, "control": rig.control_port}
        return {"sealed": digest, "ports": ports}

    def _effects(self, hidden: Truth, name: str) -> Path | None:
        if not hidden.effects:
            return None
        path = self._sealed / f"{name}.toml"
        path.write_text(effects_text(hidden.effects), encoding="utf-8")
        return path

    def _direct(self, case: Setting, effects: Path | None, record: Path, left_out: Collection[int] = ()) -> None:
        from drivers.rig_file import load_rig
        from drivers.virtual.plant import load_effects
        from hil.record import write_record
        from hil.synthetic import direct_record

        known = [e for i, e in enumerate(load_effects(effects) if effects else ()) if i not in left_out]
        made = direct_record(profile(case), load_rig(RIG), seed=case.seed, unit=case.unit, effects=tuple(known))
        write_record(made, record)

    def _without(
        self, case: Setting, hidden: Truth, effects: Path | None, folder: Path, made: Path | None
    ) -> list[str]:
        """Return records with all effects, `made` if it exists, then without each labelled effect; none for a healthy
        rig.
        """
        if effects is None:
            return []
        count = len(hidden.effects)
        parts = [(i,) for i in range(count)] if count == len(hidden.labels) else [tuple(range(count))]
        whole = made or folder / "with.parquet"
        if made is None:
            self._direct(case, effects, whole)
        paths = [folder / f"without_{k}.parquet" for k in range(len(parts))]
        for path, part in zip(paths, parts, strict=True):
            self._direct(case, effects, path, part)
        return [str(path) for path in (whole, *paths)]

    async def _start(self, case: Setting, effects: Path | None) -> VirtualRig:
        from drivers.virtual import start_virtual_rig

        return await start_virtual_rig(mode="lockstep", seed=case.seed, unit=case.unit, effects=effects)

    def _stop(self) -> None:
        if self._rig is not None:
            self._loop.run_until_complete(self._rig.stop())
            self._rig = None

    def close(self) -> None:
        """End all remaining processes."""
        self._stop()
        self._loop.close()


def seal(hidden: Truth, path: Path) -> str:
    """Write a truth; return the SHA-256 of the file."""
    text = json.dumps(hidden.document(), indent=1) + "\n"
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(text, encoding="utf-8")
    return hashlib.sha256(text.encode()).hexdigest()


def opened(path: Path) -> dict[str, Any]:
    """Return a sealed truth."""
    found: dict[str, Any] = json.loads(path.read_text(encoding="utf-8"))
    return found


def main() -> None:
    """Serve requests from the command line."""
    injector = Injector(Path(sys.argv[1]))
    try:
        serve(injector.answer)
    finally:
        injector.close()


if __name__ == "__main__":
    main()
