"""Arrival times of queued frames: what was queued while the receiving thread was stopped is as old as the gap."""

from __future__ import annotations

from dataclasses import dataclass

import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivers.bus.arrival import REFILL_S, RELAY_EMPTIES_IN_S, Arrivals, Stamps


@dataclass
class Machine:
    """Clocks that go on by hand; the rig's runs `speed` times as fast as the steady one."""

    steady_s: float = 1000.0
    wall_ahead_s: float = 1.7e9
    speed: float = 1.0

    def arrivals(self, stamps: Stamps) -> Arrivals:
        return Arrivals(self.rig, stamps, steady=lambda: self.steady_s, wall=self.wall)

    def rig(self) -> float:
        return (self.steady_s - 1000.0) * self.speed

    def wall(self) -> float:
        return self.steady_s + self.wall_ahead_s

    def pass_(self, seconds: float) -> None:
        self.steady_s += seconds


def settle(machine: Machine, arrivals: Arrivals, seconds: float = 2 * REFILL_S) -> None:
    """Find the queue empty for a while."""
    for _ in range(round(seconds / 0.01)):
        machine.pass_(0.01)
        arrivals.empty()


@pytest.mark.parametrize("stamps", ["none", "sender", "kernel"])
def test_a_frame_that_is_taken_at_once_has_just_arrived(stamps):
    machine = Machine()
    arrivals = machine.arrivals(stamps)
    for _ in range(50):
        machine.pass_(0.15)
        assert arrivals.frame(machine.wall()) == pytest.approx(machine.rig(), abs=1e-4)
    assert not arrivals.in_doubt


def test_the_backlog_of_a_stopped_thread_is_as_old_as_the_gap():
    machine = Machine()
    arrivals = machine.arrivals("none")
    machine.pass_(0.1)
    before = arrivals.frame(0.0)
    machine.pass_(6.0)
    assert [arrivals.frame(0.0) for _ in range(40)] == [before] * 40
    arrivals.empty()
    machine.pass_(0.001)
    assert arrivals.frame(0.0) == before, "what lay in the buffers behind the queue comes now"
    settle(machine, arrivals)
    assert arrivals.frame(0.0) == machine.rig()


def test_a_receive_call_that_returns_late_with_nothing_proves_no_empty_queue():
    machine = Machine()
    arrivals = machine.arrivals("none")
    machine.pass_(9.0)
    arrivals.empty()
    assert arrivals.in_doubt
    machine.pass_(REFILL_S / 2)
    assert arrivals.frame(0.0) == 0.0


def test_a_second_stop_while_the_backlog_is_read_makes_nothing_younger():
    machine = Machine()
    arrivals = machine.arrivals("none")
    machine.pass_(5.0)
    assert arrivals.frame(0.0) == 0.0
    arrivals.empty()
    machine.pass_(5.0)
    assert arrivals.frame(0.0) == 0.0
    settle(machine, arrivals)
    assert not arrivals.in_doubt


def test_kernel_stamps_tell_the_age_of_each_frame_of_a_backlog():
    machine = Machine(speed=10.0)
    arrivals = machine.arrivals("kernel")
    machine.pass_(0.1)
    arrivals.empty()
    stamps = [machine.wall() + after for after in (1.0, 4.0, 8.0)]
    machine.pass_(8.0)
    assert [arrivals.frame(stamp) for stamp in stamps] == pytest.approx([11.0, 41.0, 81.0], abs=1e-4)


@pytest.mark.parametrize("set_by_s", [-3600.0, -3.0, 3.0, 3600.0])
def test_a_wall_clock_that_is_set_in_the_gap_makes_no_old_frame_fresh(set_by_s):
    machine = Machine()
    arrivals = machine.arrivals("kernel")
    stamp = machine.wall() + 1.0
    machine.pass_(6.0)
    machine.wall_ahead_s += set_by_s
    assert arrivals.frame(stamp) == 0.0
    settle(machine, arrivals)
    assert arrivals.frame(machine.wall()) == pytest.approx(machine.rig(), abs=1e-4)


def test_a_wall_clock_that_is_set_while_the_thread_runs_ages_nothing():
    machine = Machine()
    arrivals = machine.arrivals("kernel")
    stamp = machine.wall()
    machine.pass_(0.05)
    machine.wall_ahead_s += 3600.0
    assert arrivals.frame(stamp) == machine.rig()


def relayed(stopped_s: float, every_s: float = 0.5) -> tuple[Machine, Arrivals, list[float]]:
    """A relay's frames of a gap; its clock is far behind ours."""
    machine = Machine()
    arrivals = machine.arrivals("sender")
    machine.pass_(0.1)
    arrivals.frame(50.0)
    count = round(stopped_s / every_s)
    machine.pass_(stopped_s)
    return machine, arrivals, [50.0 + every_s * (1 + k) for k in range(count)]


def test_frames_that_a_relay_kept_back_are_old_although_the_queue_was_empty_between():
    machine, arrivals, stamps = relayed(20.0)
    half = len(stamps) // 2
    assert [arrivals.frame(stamp) for stamp in stamps[:half]] == [pytest.approx(0.1)] * half
    arrivals.empty()
    came = [arrivals.frame(stamp) for stamp in stamps[half:]]
    assert came == pytest.approx([0.1 + stamp - 50.0 for stamp in stamps[half:]])
    settle(machine, arrivals)
    assert not arrivals.in_doubt


def test_a_relay_whose_clock_was_set_back_is_believed_again_once_its_buffers_must_be_empty():
    machine, arrivals, _ = relayed(5.0)
    arrivals.empty()
    for _ in range(200):
        machine.pass_(0.01)
        arrivals.frame(50.0 - 3600.0 + machine.rig())
        arrivals.empty()
        if not arrivals.in_doubt:
            break
    assert machine.rig() == pytest.approx(5.1 + RELAY_EMPTIES_IN_S, abs=0.05)


def test_time_that_the_rig_waits_for_ages_no_frame():
    machine = Machine()
    arrivals = machine.arrivals("none")
    arrivals.in_step = True
    machine.pass_(30.0)
    assert arrivals.frame(0.0) == machine.rig()


@given(
    stops=st.lists(st.floats(0.0, 30.0), min_size=1, max_size=6),
    queued=st.lists(st.floats(0.0, 1.0), min_size=1, max_size=6),
    stamps=st.sampled_from(["none", "sender", "kernel"]),
    set_by_s=st.sampled_from([0.0, 0.0, -100.0, 100.0]),
)
def test_no_frame_is_ever_stamped_more_than_an_unseen_stall_after_its_arrival(stops, queued, stamps, set_by_s):
    machine = Machine()
    arrivals = machine.arrivals(stamps)
    for number, stop_s in enumerate(stops):
        began, wall = machine.steady_s, machine.wall()
        machine.pass_(stop_s)
        if number == 1:
            machine.wall_ahead_s += set_by_s
        for part in sorted(queued):
            at = began + part * stop_s
            stamped = arrivals.frame(wall + part * stop_s)
            assert stamped - (at - 1000.0) <= 0.3 + 1e-3
        settle(machine, arrivals)
        assert not arrivals.in_doubt
