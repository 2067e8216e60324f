"""Knowing side of the zoo's trial: makes a case, seals its truth, and returns the hash alone.

    python -m hil.bench.zoo.injector SEALED

A request names family, seed and effect; the answer names the files that the answering side gets: the record, the
healthy record and the twin that was commissioned on it.
"""

from __future__ import annotations

import hashlib
import json
import sys
import time
from pathlib import Path

from hil.bench.discovery import Request, serve


def make(request: Request, sealed: Path) -> Request:
    """Make a case; write its truth to `sealed` and the rest to the request's folder."""
    from hil.bench.zoo.case import make_case
    from hil.record import write_record
    from twin import save

    began = time.process_time()
    case = make_case(request["family"], request["seed"], request["effect"], open_sealed=request["open_sealed"])
    folder = Path(request["folder"])
    folder.mkdir(parents=True, exist_ok=True)
    found: Request = {}
    for name, table in case.tables.items():
        write_record(table, folder / f"{name}.parquet")
        found[name] = str(folder / f"{name}.parquet")
    twin = folder / "twin.toml"
    twin.unlink(missing_ok=True)
    save(case.network, twin)
    text = json.dumps({**case.truth, "what": case.truth["effect"]}, indent=1) + "\n"
    sealed.mkdir(parents=True, exist_ok=True)
    (sealed / f"{request['name']}.json").write_text(text, encoding="utf-8")
    return {
        **found,
        "twin": str(twin),
        "sealed": hashlib.sha256(text.encode()).hexdigest(),
        "cpu_s": time.process_time() - began,
        "commission_cpu_s": case.commission_cpu_s,
    }


def main() -> None:
    """Serve requests from the command line."""
    sealed = Path(sys.argv[1])
    serve(lambda request: make(request, sealed))


if __name__ == "__main__":
    main()
