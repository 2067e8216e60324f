"""Fleet files: each mistake is one sentence with its line, and jobs follow from the content of their files."""

from __future__ import annotations

import re

import pytest

from hil.fleet import FleetError, jobs_of, read_fleet
from hil.fleet.fleet_file import KINDS, FleetSection, RigSection
from hil.record import read_record, write_record
from tests.hil.command_line import typed
from tests.hil.made_fleet import TRACKED, made_fleet
from tests.hil.reference_pages import page


@pytest.mark.parametrize(
    ("old", "new", "line", "said"),
    [
        (
            'kind = "track"',
            'kind = "tracks"',
            10,
            "there is no kind of job 'tracks'; use diagnose, track, train, bench",
        ),
        ('kind = "track"', "", 9, "kind is missing; use diagnose, track, train, bench"),
        ("records/*.parquet", "record/*.parquet", 6, r"records of rig lab: there is no record .*record/\*\.parquet"),
        ('twin = "loop.toml"', 'twin = "lop.toml"', 5, r"twin of rig lab: there is no file .*lop\.toml"),
        ('twin = "loop.toml"\n', "", 3, "twin of rig lab: is missing, and .*records has no twin.toml; name the twin"),
        ('calibrators = ["', 'calibrators = ["no", "', 11, "calibrators of job track: no calibrator no; there are pso"),
        ("[[rig]]", "[rig]", 3, r"rig: is one table; begin each with \[\[rig\]\]"),
        ("calibrators", "calibrater", 11, "calibrater of job track: is not a key here; did you mean calibrators?"),
        ('kind = "track"', 'kind = "track"\nrigs = ["bal"]', 11, "there is no rig 'bal'; there are lab"),
        ('kind = "track"', 'kind = "track"\nseeds = [-1]', 11, "seeds of job track"),
        ('id = "night"', 'id = "../night"', 1, r"id: '../night' must be at most 64 letters"),
        (TRACKED, "", 1, r"the file has no \[\[job\]\]; add one"),
        ("[[rig]]", "[[rig]", 3, "is not valid TOML"),
    ],
)
def test_a_mistake_is_one_sentence_with_its_line(tmp_path, old, new, line, said):
    file = made_fleet(tmp_path, records=1, hours=0.2)
    text = file.read_text(encoding="utf-8")
    assert old in text
    file.write_text(text.replace(old, new), encoding="utf-8")
    with pytest.raises(FleetError) as found:
        read_fleet(file)
    sentence = str(found.value)
    assert "\n" not in sentence and f"line {line}" in sentence and re.search(said, sentence), sentence


def test_check_counts_the_jobs_and_names_a_mistake(tmp_path):
    file = made_fleet(tmp_path, records=3, hours=0.2, jobs=TRACKED + "seeds = [0, 1]\n")
    done = typed("check", file)
    assert done.returncode == 0 and "track: 6 jobs" in done.stdout
    (tmp_path / "loop.toml").unlink()
    done = typed("check", file)
    assert done.returncode == 2 and "there is no file" in done.stderr


def test_a_run_folder_stands_for_its_record(tmp_path):
    file = made_fleet(tmp_path, records=2, hours=0.2)
    for record in sorted((tmp_path / "records").glob("*.parquet")):
        record.with_suffix("").mkdir()
        record.rename(record.with_suffix("") / "record.parquet")
    file.write_text(file.read_text(encoding="utf-8").replace("records/*.parquet", "records/*"), encoding="utf-8")
    assert len(jobs_of(read_fleet(file))) == 2


def test_a_job_is_the_same_as_long_as_its_files_and_options_are(tmp_path):
    file = made_fleet(tmp_path, records=2, hours=0.2)
    before = {job.record: job.id for job in jobs_of(read_fleet(file))}
    file.write_text(file.read_text(encoding="utf-8") + "seeds = [0, 1]\n", encoding="utf-8")
    assert set(before.values()) < {job.id for job in jobs_of(read_fleet(file))}
    changed = tmp_path / "records/r0.parquet"
    record = read_record(changed)
    changed.unlink()
    write_record(type(record)(record.time_s[:-1], {n: v[:-1] for n, v in record.columns.items()}), changed)
    after = {job.record: job.id for job in jobs_of(read_fleet(file)) if job.seed == 0}
    assert after["records/r1.parquet"] == before["records/r1.parquet"]
    assert after["records/r0.parquet"] != before["records/r0.parquet"]


@pytest.mark.parametrize(
    ("section", "model"),
    [("Fleet", FleetSection), ("[[rig]]", RigSection), *((f"Job {kind}", model) for kind, model in KINDS.items())],
)
def test_the_page_names_every_key_and_no_other(section, model):
    assert set(page("fleet-file").keys(section)) == set(model.model_fields)


def test_the_example_of_the_page_is_read(tmp_path):
    made_fleet(tmp_path, records=1, hours=0.2)
    file = tmp_path / "example.toml"
    file.write_text(page("fleet-file").code["toml"][0], encoding="utf-8")
    assert {job.kind for job in jobs_of(read_fleet(file))} == set(KINDS)
