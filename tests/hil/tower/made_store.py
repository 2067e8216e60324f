"""A station folder of made series, and the command line as its entry point runs it."""

from __future__ import annotations

import csv
import json
import sys
from pathlib import Path
from typing import Any

from drivers.historian import Samples, open_store
from hil.cli import verbs
from tests.twin.historian.made_station import ZONE
from twin.historian.tags import Series


def hil(*arguments: object) -> int:
    """Run the command as its entry point does and return the exit code."""
    plain = sys.argv
    sys.argv = ["hil", *map(str, arguments)]
    try:
        verbs.main()
    except SystemExit as ended:
        return int(ended.code or 0)
    finally:
        sys.argv = plain
    return 0


def written_station(folder: Path, series: list[Series], sheet: dict[str, Any] | None = None, events: str = "") -> Path:
    folder.mkdir(exist_ok=True)
    with open_store(folder, create=True) as store:
        store.append({one.tag.name: Samples(one.time_s, one.value, one.quality) for one in series})
    with (folder / "tags.csv").open("w", newline="") as handle:
        writer = csv.writer(handle)
        writer.writerow(["tag", "description", "unit", "cell", "role", "scan_s"])
        for one in series:
            writer.writerow([one.tag.name, "", one.tag.unit, one.tag.cell or "", one.tag.role, one.tag.scan_s])
    (folder / "datasheet.json").write_text(json.dumps({"station": "X", "timezone": ZONE} | (sheet or {})))
    (folder / "events.csv").write_text("time,precision,cell,source,event,text\n" + events)
    return folder
