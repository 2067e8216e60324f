"""What the tests of all imports share: files written to a folder, rigs read back, and odd cells."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from hypothesis import strategies as st

from drivers.importers.draft import Draft, ImportFileError, rig_file_text
from drivers.rig_file.model import Rig
from drivers.rig_file.reader import load_rig

BUS = {"transport": "modbus_tcp", "host": "10.0.0.5", "port": 502, "device_id": 3}
CELLS = st.one_of(
    st.sampled_from(
        ["40001", "30001", "3", "0x10", "uint16", "float32", "CDAB", "0.1", "1/0", "rw", "°C", "4-7", "-", ""]
    ),
    st.text(max_size=8),
    st.integers(-10, 10**9).map(str),
    st.floats().map(str),
)


def complaint(importing: Callable[[], Draft]) -> str:
    """Return the note or the refusal that names a mistake, `line N: ...` of a note as the refusal writes it."""
    try:
        draft = importing()
    except ImportFileError as error:
        return str(error)
    left_out = [note for note in draft.notes if note.endswith("(left out)")]
    assert left_out, draft.notes
    return f"{draft.source.name}, {left_out[0]}"


def written(tmp_path: Path, draft: Draft) -> Rig:
    path = tmp_path / "made.toml"
    path.write_text(rig_file_text(draft, "made"), encoding="utf-8")
    return load_rig(path)


def table(tmp_path: Path, text: str, name: str = "registers.csv") -> Path:
    path = tmp_path / name
    path.write_text(text, encoding="utf-8")
    return path
