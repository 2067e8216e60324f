"""Blind trials of the diagnosis.

The names below are the package's interface; they are loaded on first use. Other modules are private to the package.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from hil.lazy_names import lazy_names

if TYPE_CHECKING:
    from hil.bench.discovery.injector import opened
    from hil.bench.discovery.ledger import Ledger, sha256_of
    from hil.bench.discovery.score import NAMED, pooled, spoken, wilson
    from hil.bench.discovery.sides import GIVEN, answer_case, sealed_folder, side_process
    from hil.bench.discovery.trial import no_answer, sources
    from hil.bench.discovery.worker import PROJECT, Request, Worker, WorkerError, serve

__all__ = [
    "GIVEN",
    "NAMED",
    "PROJECT",
    "Ledger",
    "Request",
    "Worker",
    "WorkerError",
    "answer_case",
    "no_answer",
    "opened",
    "pooled",
    "public_records",
    "repeated",
    "sealed_folder",
    "serve",
    "sha256_of",
    "side_process",
    "sources",
    "spoken",
    "tables",
    "trial",
    "wilson",
]

__getattr__, __dir__ = lazy_names(
    __name__,
    {
        "": (
            "public_records",
            "repeated",
            "tables",
            "trial",
        ),
        "injector": ("opened",),
        "ledger": (
            "Ledger",
            "sha256_of",
        ),
        "score": (
            "NAMED",
            "pooled",
            "spoken",
            "wilson",
        ),
        "sides": (
            "GIVEN",
            "answer_case",
            "sealed_folder",
            "side_process",
        ),
        "trial": (
            "no_answer",
            "sources",
        ),
        "worker": (
            "PROJECT",
            "Request",
            "Worker",
            "WorkerError",
            "serve",
        ),
    },
)
