"""Shapes of the JSON documents in a journal: entries of windows, proposals and bands that reports and reviews read.

Other keys may hold anything.
"""

from __future__ import annotations

from typing import Any

from pydantic import Field, ValidationError

from hil.run_folder import DocumentShape, wrong_place

Numbers = dict[str, float | None]


class ShapeError(ValueError):
    """Value of a journal that its writer does not make; the message names the value in one line."""


class _CalibrationDocument(DocumentShape):
    kind: str = "window"
    rmse_K: float | None = None
    rmse_before_K: float | None = None
    parameters: Numbers = Field(default_factory=dict)
    standard_errors: Numbers | None = None
    flags: list[str] = Field(default_factory=list)


class _DoubtDocument(DocumentShape):
    sensor: str
    off_K: float


class _ProposalDocument(DocumentShape):
    values: dict[str, float]
    standard_errors: dict[str, float]
    held: dict[str, str]
    reasons: list[str]
    doubted: list[_DoubtDocument] = Field(default_factory=list)


class _BandDocument(DocumentShape):
    mean_K: Numbers
    half_width_K: Numbers


_SHAPES: dict[str, type[DocumentShape]] = {
    "CalibrationRow": _CalibrationDocument,
    "ProposalRow": _ProposalDocument,
    "BandRow": _BandDocument,
}


def require_document(row: str, document: dict[str, Any]) -> None:
    """Check the document of a row; `row` is the name of its class. Raises ShapeError."""
    shape = _SHAPES.get(row)
    if shape is None:
        return
    try:
        found = shape.model_validate(document)
    except ValidationError as error:
        raise ShapeError(f"{row}: {wrong_place(error)}") from None
    if isinstance(found, _BandDocument) and found.mean_K.keys() != found.half_width_K.keys():
        raise ShapeError("BandRow: its tables are of different sensors")
    if (
        isinstance(found, _ProposalDocument)
        and not found.held.keys() <= found.values.keys() == found.standard_errors.keys()
    ):
        raise ShapeError("ProposalRow: its tables are of different parameters")
