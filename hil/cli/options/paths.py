"""Parameter types for input files: searched as given, then in the project's own profiles."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

PROJECT = Path(__file__).resolve().parents[3]


class InputPath(click.ParamType[Path]):
    """Path of a file or folder that exists; a file of the project's `profiles/` is found from any working directory."""

    name = "path"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Path:
        path = Path(value)
        if path.exists():
            return path
        shipped = PROJECT / path
        if shipped.is_file() and path.parts[:1] == ("profiles",):
            return shipped
        return self.fail(f"{path}: there is no such file or folder; check the path", param, ctx)


class InputFile(click.ParamType[Path]):
    """Path of a file that exists; a file of the project's `profiles/` is found from any working directory."""

    name = "file"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Path:
        path = Path(value)
        if path.is_file():
            return path
        shipped = PROJECT / path
        if shipped.is_file() and path.parts[:1] == ("profiles",):
            return shipped
        if path.is_dir():
            self.fail(f"{path} is a folder; give a file", param, ctx)
        return self.fail(f"{path}: there is no such file; check the path", param, ctx)


class RecordFile(InputFile):
    """Path of a record that exists; that of a run has every tick of the run's journal (`record_of`)."""

    name = "file"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Path:
        from hil.cli.options.subject import record_of

        return record_of(super().convert(value, param, ctx))


class InputCard(InputFile):
    """Path of a network's card; `.json` may be left out, and weights stand for the card beside them."""

    name = "card"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Path:
        path = Path(value)
        if path.suffix not in (".json", ".safetensors") and (path.is_file() or (PROJECT / path).is_file()):
            self.fail(f"{path} is no card of a network; give its .json, or the .safetensors beside it", param, ctx)
        if path.suffix != ".json" and not path.is_dir():
            path = path.with_suffix(".json") if path.suffix == ".safetensors" else path.with_name(f"{path.name}.json")
        return super().convert(path, param, ctx)


INPUT_FILE = InputFile()
INPUT_CARD = InputCard()
INPUT_PATH = InputPath()
RECORD_FILE = RecordFile()
VIRTUAL_RIG = "profiles/rigs/virtual.toml"
