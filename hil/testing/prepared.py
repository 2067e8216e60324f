"""Test plan of a run: its limits for the rig, before anything moves, and the watch that judges them live."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from drivers.rig import rig_signals
from drivers.rig_file import Rig, file_sha256
from hil.profile import Profile
from hil.testing.bound_limits import BoundLimit, RigSignals, bind
from hil.testing.live import LiveTest
from hil.testing.plan import Plan, TestPlanError, read_plan

if TYPE_CHECKING:
    from twin import Network


@dataclass(frozen=True, slots=True)
class PreparedTest:
    """Plan of a run, and its limits in the units of the rig's signals."""

    plan: Plan
    limits: tuple[BoundLimit, ...]


def prepared_test(
    file: Path, rig: Rig, profile: Profile, network: Network | None, twins: tuple[str, ...]
) -> PreparedTest:
    """Return the test plan in `file` for a run, with its limits checked against rig and profile.

    Parameters
    ----------
    file
        Test plan.
    rig
        Rig of the run.
    profile
        Profile that the run replays.
    network
        Network of the twin; None for a run without a twin.
    twins
        Names of the twins that run.

    Raises
    ------
    TestPlanError
        The plan is for another profile, or a limit does not fit the rig or the profile.
    """
    plan = read_plan(file)
    if plan.profile is not None and profile.path is not None and file_sha256(plan.profile) != profile.sha256:
        raise TestPlanError(
            f"{plan.place}: profile: the run replays {profile.path}, and the plan is for {plan.profile}; run that"
        )
    moves = profile.time_s[1:][(np.diff(profile.values, axis=0) != 0.0).any(axis=1)]
    known = RigSignals(
        rig_signals(rig),
        {} if network is None else dict(network.sensor_columns),
        twins,
        profile.duration_s,
        rig.period_s,
        f"rig {rig.name}",
        float(np.diff([0.0, *moves, profile.duration_s]).max()),
    )
    return PreparedTest(plan, bind(plan, known))


def live_watch(test: PreparedTest | None, rig: Rig, announce: Callable[[str], None]) -> LiveTest | None:
    """Return the watch that judges a test while its run goes on; `announce` gets a line for each limit."""
    if test is None:
        return None
    return LiveTest(test.plan, test.limits, rig_signals(rig), rig.period_s, announce)
