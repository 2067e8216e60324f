"""Answering side of the trial, without the truth: a record, a twin and a healthy record (or none) in, `diagnosis.json`
out.

python -m hil.bench.discovery.answerer
"""

from __future__ import annotations

import time
from pathlib import Path

from hil.bench.discovery.worker import Request, serve


def answer(request: Request) -> Request:
    """Diagnose as `hil diagnose` does, without its page and its revision of the twin."""
    from hil.diagnosis import read_columns, with_clock, write_document
    from twin import load
    from twin.discovery import diagnose

    began, used = time.monotonic(), time.process_time()
    network = with_clock(load(Path(request["twin"])))
    record, _ = read_columns(network, Path(request["record"]), request["hour"])
    healthy = read_columns(network, Path(request["healthy"]), request["hour"])[0] if request["healthy"] else None
    diagnosis = diagnose(network, record, healthy, by_evidence=bool(request.get("open_laws")))
    path = write_document(diagnosis.document(), Path(request["out"]))
    return {"answer": str(path), "seconds": time.monotonic() - began, "cpu_s": time.process_time() - used}


if __name__ == "__main__":
    serve(answer)
