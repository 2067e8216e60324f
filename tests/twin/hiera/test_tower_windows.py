"""Windows of a tower's cell: what they hide, what they are made of, and jumps that are added to them."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

torch = pytest.importorskip("torch", reason="torch is not installed: the network calibrator is left out")
pytest.importorskip("safetensors", reason="safetensors is not installed: trained networks cannot be read")

from tests.twin.hiera.tower_tables import made_table  # noqa: E402
from twin.calibrators.hiera_unet.model.config import PAPER, TOWER_GROUPS, HieraError, named  # noqa: E402
from twin.calibrators.hiera_unet.model.network import HieraUNet  # noqa: E402
from twin.calibrators.hiera_unet.tower.cell_table import CellTable  # noqa: E402
from twin.calibrators.hiera_unet.tower.table import SUBJECT  # noqa: E402
from twin.calibrators.hiera_unet.tower.windows import OUTLET, SCORES, TARGET, Fleet, Jump  # noqa: E402

ROWS = torch.tensor([2, 5])


def test_the_table_has_the_six_groups_of_the_paper_and_the_evidence_over_time() -> None:
    assert SUBJECT.groups == (*TOWER_GROUPS, 8)
    assert len({one.name for one in SUBJECT.channels}) == len(SUBJECT.channels) == 60
    plain = HieraUNet(named("small", **PAPER)).count()
    assert 0.0 < HieraUNet(SUBJECT.config("small")).count() / plain - 1.0 < 0.05


def test_a_window_is_the_same_whatever_its_target_reads() -> None:
    table = made_table()
    start = int(table.start[2])
    later = np.arange(len(table.regime)) >= start
    noisy = np.random.default_rng(3).normal(0, 5, len(later)).astype(np.float32)
    told = np.array(SUBJECT.told)
    x = table.x + (later[:, None] & told) * noisy[:, None].astype(np.float16)
    other = replace(table, x=x, outlet=table.outlet + later * noisy, reading=table.reading + later * noisy)
    a, b = (Fleet([one]).batch(ROWS[:1]) for one in (table, other))
    for name in ("m", "regime", "clock", "meta", "memory", "water", "mean"):
        assert torch.equal(getattr(a, name), getattr(b, name)), name
    assert torch.equal(a.x * a.m, b.x * b.m)
    assert not torch.equal(torch.nan_to_num(a.reading), torch.nan_to_num(b.reading))


def test_interpolated_minutes_after_the_last_sample_before_the_target_are_hidden() -> None:
    table = made_table()
    outlet = table.outlet.copy()
    outlet[int(table.start[2]) - 30 : int(table.start[2])] = np.nan
    batch = Fleet([replace(table, outlet=outlet)]).batch(ROWS[:1])
    told = torch.tensor(SUBJECT.told)
    assert not batch.m[0, -TARGET - 28 :, told].any()
    assert batch.m[0, -TARGET - 60 : -TARGET - 34, told].float().mean() > 0.8
    assert batch.m[0, -TARGET:, ~told].float().mean() > 0.8


def test_channels_follow_the_belief_and_scores_are_residual_times_slope() -> None:
    fleet = Fleet([made_table()])
    plain = fleet.batch(ROWS)
    shift = torch.tensor([[0.02, 0.0, 0.0, 0.1]]).expand(2, -1)
    moved = fleet.batch(ROWS, shift=shift)
    change = moved.x[..., OUTLET] - plain.x[..., OUTLET]
    slope = fleet.arrays["slopes"][fleet.start[ROWS][:, None] + torch.arange(-1320, TARGET)][..., 0]
    assert torch.allclose(change, -(0.02 * slope + 0.1) / 0.3, atol=1e-4)
    assert torch.allclose(moved.water - plain.water, 0.02 * slope[:, -TARGET:], atol=1e-4)
    assert torch.allclose(plain.x[..., SCORES][..., 3], 0.5 * plain.x[..., OUTLET] / 0.3, atol=1e-4)


@pytest.mark.parametrize("which", [0, 3])
def test_a_jump_moves_readings_and_labels_and_only_a_jump_of_the_fill_the_water(which: int) -> None:
    fleet = Fleet([made_table()])
    jump = Jump(torch.tensor([which, -1]), torch.tensor([0.1, 0.5]), torch.tensor([700, 700]))
    plain, jumped = fleet.batch(ROWS), fleet.batch(ROWS, jump)
    label = torch.zeros(2, 4)
    label[0, which] = 0.1
    assert torch.allclose(jumped.true - plain.true, label)
    assert torch.equal(torch.nan_to_num(jumped.reading[1]), torch.nan_to_num(plain.reading[1]))
    change = jumped.x[0, :, OUTLET] - plain.x[0, :, OUTLET]
    assert (change[:700] == 0.0).all() and (change[700:].abs() > 0.2).all()
    water = jumped.true_water[0] - plain.true_water[0]
    assert torch.allclose(water, torch.zeros_like(water)) == (which == 3)


def test_a_table_comes_back_from_its_file_and_one_of_another_table_is_refused(tmp_path: Path) -> None:
    table = made_table()
    table.save(tmp_path / "a.npz")
    again = CellTable.load(tmp_path / "a.npz")
    assert again.name == "made_1" and np.array_equal(again.x, table.x) and again.healthy_end == table.healthy_end
    with np.load(tmp_path / "a.npz") as found:
        values = dict(found)
    values["table"] = np.array("another")
    np.savez(tmp_path / "b.npz", **values)
    with pytest.raises(HieraError, match="another channel table"):
        CellTable.load(tmp_path / "b.npz")
    (tmp_path / "c.npz").write_bytes(b"no table")
    with pytest.raises(HieraError, match="cannot be read as windows"):
        CellTable.load(tmp_path / "c.npz")


def test_a_fleet_without_a_window_is_refused() -> None:
    table = made_table()
    with pytest.raises(HieraError, match="no cycle"):
        Fleet([replace(table, valid=np.zeros_like(table.valid))])
