"""Files that are none: a pipe, a socket, a device or a folder in place of a file is refused at once, in a sentence."""

from __future__ import annotations

import os
import socket
import threading
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from drivers.can.dbc import read_dbc
from drivers.importers.draft import read_bytes
from drivers.rig_file.reader import load_rig
from drivers.rig_file.text.regular_file import read_regular
from drivers.virtual.plant.effects import load_effects
from hil.profile.load_profile import read_profile
from hil.profile.scenario import read_scenario
from hil.record.reader import read_record
from twin import regular_file
from twin.twinfile import datasheet
from twin.twinfile import load as load_twin


def pipe(path: Path) -> str:
    os.mkfifo(path)
    return "pipe"


def a_socket(path: Path) -> str:
    with socket.socket(socket.AF_UNIX) as listener:
        listener.bind(str(path))
    return "socket"


def device(path: Path) -> str:
    path.symlink_to("/dev/zero")
    return "device"


def folder(path: Path) -> str:
    path.mkdir()
    return "folder"


READERS: dict[str, Callable[[Path], object]] = {
    "rig.toml": load_rig,
    "twin.toml": load_twin,
    "effects.toml": load_effects,
    "scenario.toml": read_scenario,
    "load.csv": read_profile,
    "record.csv": read_record,
    "record.parquet": read_record,
    "can.dbc": read_dbc,
    "points.csv": read_bytes,
    "sheet.json": datasheet.from_datasheet,
}


@pytest.mark.parametrize("make", [pipe, a_socket, device, folder])
@pytest.mark.parametrize("name", READERS)
def test_what_is_no_regular_file_is_refused_at_once_in_a_sentence_that_names_it(name, make, tmp_path):
    path = tmp_path / name
    what = make(path)
    found: list[BaseException] = []

    def read() -> None:
        try:
            READERS[name](path)
        except BaseException as error:
            found.append(error)

    reading = threading.Thread(target=read, daemon=True)
    reading.start()
    reading.join(5.0)
    assert not reading.is_alive(), "the reader hangs"
    (error,) = found
    said = str(error)
    assert str(path) in said and what in said, said
    assert "Errno" not in said and len(said.splitlines()) == 1


@pytest.mark.parametrize("read", [read_regular, regular_file.read_regular])
def test_a_file_beyond_the_limit_is_refused_with_both_sizes_and_one_at_the_limit_is_read(read, tmp_path):
    path = tmp_path / "large"
    path.write_bytes(b"x" * 3_000_000)
    assert len(read(path, 3_000_000)) == 3_000_000
    with pytest.raises(OSError, match="it has 3 MB, and at most 2 MB are read"):
        read(path, 2_000_000)


def test_a_file_that_has_no_size_of_its_own_is_read_up_to_the_limit():
    assert read_regular(Path("/proc/self/status")).startswith(b"Name:")
    with pytest.raises(OSError, match="at most"):
        read_regular(Path("/proc/self/status"), 10)


@pytest.mark.parametrize("make", [pipe, a_socket, device, folder])
@pytest.mark.parametrize("what_is_none", ["card", "weights"])
def test_a_model_card_or_weights_that_are_no_regular_file_are_refused(what_is_none, make, tmp_path):
    pytest.importorskip("torch")
    from twin.calibrators.hiera_unet.serve.members import load_ensemble
    from twin.calibrators.hiera_unet.weights.checkpoint import HieraError, _digest

    path = tmp_path / what_is_none
    what = make(path)
    if what_is_none == "card":
        with pytest.raises(HieraError, match=what):
            load_ensemble(path, None)  # type: ignore[arg-type]
    else:
        with pytest.raises(OSError, match=what):
            _digest(path)


def test_arrays_that_unpack_to_more_than_the_limit_are_not_read(tmp_path, monkeypatch):
    pytest.importorskip("torch")
    from twin.calibrators.hiera_unet.simulated import store

    path = tmp_path / "shard.npz"
    np.savez_compressed(path, length=np.zeros(100_000))
    assert path.stat().st_size < 10_000
    monkeypatch.setattr(store, "MOST_UNPACKED", 100_000)
    with pytest.raises(ValueError, match="unpacks to"):
        store.read_shard(path)
