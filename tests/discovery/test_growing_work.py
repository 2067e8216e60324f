"""Work of a growth: simulations of a fit, and the kernels in which hypotheses are simulated."""

from __future__ import annotations

import numpy as np
import pytest

from tests.discovery.test_a_room import ROOM, SUN, lived_in
from twin.discovery.growing import descent
from twin.discovery.growing.descent import Start, descend
from twin.discovery.growing.growth import samples_of
from twin.discovery.growing.growth_problem import GrowthProblem, readings_of
from twin.discovery.growing.superset.candidate_superset import CandidateSuperset, unsized
from twin.elements.candidates import Candidate
from twin.network import Array
from twin.network.assembly import NetworkEquations
from twin.twinfile import parse


@pytest.fixture(scope="module")
def problem() -> GrowthProblem:
    room = parse(ROOM)
    record = lived_in(room, {"sun": SUN})
    samples, ids = samples_of(room, record.time_s, record.inputs, record.measured), room.tunables("commission")
    superset = CandidateSuperset.of(room, ids, float(np.diff(samples.time)[0]), samples.span_s)
    return GrowthProblem(superset, samples, ids)


def candidates(problem: GrowthProblem, kind: str) -> list[Candidate]:
    return [c for c in problem.superset.candidates if any(t["kind"] == kind for t in c.adds.values())]


def test_a_hypothesis_is_simulated_without_the_laws_that_it_does_not_use(problem: GrowthProblem) -> None:
    superset = problem.superset
    assert candidates(problem, "natural_convection") and candidates(problem, "hidden_mass")
    assert not NetworkEquations(superset.network, superset.kernel.lane_ids).linear
    for candidate in superset.candidates:
        kernel = superset.specialised.of(superset.specialised.kinds([candidate])).kernel
        system = NetworkEquations(kernel.network, kernel.lane_ids)
        law = {"natural_convection", "radiation", "evaporation"} & {str(t["kind"]) for t in candidate.adds.values()}
        assert system.linear == (not law)
        masses = any(t["kind"] == "hidden_mass" for t in candidate.adds.values())
        assert (len(system.states) > len(kernel.network.nodes)) == masses


def test_it_reads_what_the_whole_superset_reads(problem: GrowthProblem) -> None:
    samples, superset = problem.samples, problem.superset
    for candidate in superset.candidates:
        one = problem.with_entries((unsized(candidate, min(candidate.typical, candidate.upper)),))
        v = one.start()[None, :]
        whole = superset.kernel.trace(*one.point(v), samples.time, samples.inputs)[0]
        assert readings_of([(one, v)]) == pytest.approx(whole, abs=1e-3), candidate.id


def test_kernels_are_shared_by_hypotheses_of_the_same_kinds(problem: GrowthProblem) -> None:
    found = {
        id(problem.superset.specialised.of(problem.superset.specialised.kinds([c])))
        for c in problem.superset.candidates
    }
    assert len(found) <= 8 < len(problem.superset.candidates)


def test_a_fit_that_begins_at_another_one_takes_over_its_derivatives(
    problem: GrowthProblem, monkeypatch: pytest.MonkeyPatch
) -> None:
    runs: list[int] = []

    def counted(asked: list[tuple[GrowthProblem, Array]]) -> Array:
        runs.append(sum(len(v) for _, v in asked))
        return readings_of(asked)

    monkeypatch.setattr(descent, "readings_of", counted)
    (end,) = descend([Start(problem, problem.start())])
    none = problem.fitted(end.v, end.readings)
    sun = next(c for c in problem.superset.candidates if c.kind == "heat_source" and "sun" in c.driver)
    sunny = problem.with_entries((unsized(sun, 6.0),))
    work: list[int] = []
    ends: list[descent.End] = []
    for near in (None, none):
        runs.clear()
        ends += descend([Start(sunny, sunny.start(none), near)])
        work.append(sum(runs))
    assert ends[0].v == pytest.approx(ends[1].v, rel=0.02, abs=0.02)
    # From scratch each variable is simulated at the start; at another fit, only that of the new effect.
    assert work[1] <= work[0] - (problem.q + problem.k) + descent.FEW_LANES
    runs.clear()
    descend([Start(problem, end.v, none)])
    assert runs[0] == 1


def test_derivatives_that_point_uphill_are_renewed_and_do_not_end_a_fit(problem: GrowthProblem) -> None:
    (end,) = descend([Start(problem, problem.start())])
    wrong = problem.fitted(end.v, end.readings)
    vars(wrong)["slopes"] = -wrong.slopes  # a cached property
    (again,) = descend([Start(problem, problem.start(), wrong)])
    assert again.v == pytest.approx(end.v, rel=0.02, abs=0.02)
