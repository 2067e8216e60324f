"""Work of each kind of job on a worker.

The names below are the package's interface; they are loaded on first use. Other modules are private to the package.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from hil.lazy_names import lazy_names

if TYPE_CHECKING:
    from hil.fleet.kinds.work import GivenJob, MadeJob, perform_job

__all__ = ["GivenJob", "MadeJob", "perform_job"]

__getattr__, __dir__ = lazy_names(__name__, {"work": ("GivenJob", "MadeJob", "perform_job")})
