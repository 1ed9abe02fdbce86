"""A study of small robots: run, left, gone on with, and told."""

import json
import shutil
import subprocess
import sys
import time
import tomllib
from pathlib import Path

import numpy as np
import polars
import pytest

from evolution import cli
from evolution.run.database import is_in_use
from evolution.run.journal import Journal
from evolution.study.analysis import analyse
from evolution.study.arms import ArmError
from evolution.study.cells import Processes, RayTasks, run_study
from evolution.study.config import (
    Cell,
    StudyConfig,
    StudyError,
    begin,
    is_finished,
    load,
)
from evolution.study.headline import headline
from evolution.study.results import DATA, Course, collect, courses, thresholds, versions

TOML = Path(__file__).with_name("small.toml").read_text("utf-8")
SMALL = tomllib.loads(TOML)


def changed(**fields):
    return {**SMALL, **fields}


@pytest.fixture(scope="module")
def finished(studied):
    """A study that was run to its end."""
    return studied(TOML)


# Running


def test_a_finished_study_is_never_run_again(finished):
    config = load(finished)
    before = {p: p.stat().st_mtime_ns for p in finished.glob("cells/**/journal.sqlite")}
    assert len(before) == len(config.cells())
    assert run_study(config, finished, Processes(2)) == []
    assert {p: p.stat().st_mtime_ns for p in finished.glob("cells/**/journal.sqlite")} == before


def test_every_run_spends_its_budget_and_stops(finished):
    config = load(finished)
    frame, missing = collect(config, finished)
    assert not missing
    spent = frame.group_by("arm", "seed").agg(polars.col("simulated_s").sum())
    assert len(spent) == 5
    for total in spent["simulated_s"]:
        assert 240 <= total < 240 + 4 * 30


@pytest.mark.slow
def test_a_study_that_was_killed_goes_on_to_the_same_end(finished, tmp_path):
    config = load(finished)
    begin(config, tmp_path / "again")
    workers = Processes(2)
    seen = []

    def stop(progress):
        seen.append(progress.spent)
        if any(now.simulated_s > 0 for now in progress.running.values()):
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        run_study(config, tmp_path / "again", workers, stop)
    assert len(collect(config, tmp_path / "again")[1]) > 0
    assert run_study(config, tmp_path / "again", Processes(2)) == []
    ours, theirs = (
        collect(config, folder)[0].drop("wall_s") for folder in (tmp_path / "again", finished)
    )
    assert ours.equals(theirs)


def test_a_run_that_fails_is_told_and_keeps_none_of_the_others(finished, tmp_path):
    config = StudyConfig.from_dict(changed(seeds=[0], arms={"ga-uniform": {"prior": "uniform"}}))
    begin(config, tmp_path)
    broken = Cell("ga-uniform", 8).folder(tmp_path)
    broken.mkdir(parents=True)
    (broken / "journal.sqlite").write_text("not a journal")
    ((cell, error),) = run_study(config, tmp_path, Processes(2))
    assert cell == Cell("ga-uniform", 8)
    assert "is damaged" in error
    assert is_finished(config, Cell("ga-uniform", 0), tmp_path)


def test_progress_of_a_run_is_read_from_outside(finished):
    config = load(finished)
    cell = config.cells()[0]
    standing = config.arms[cell.arm].standing
    now = standing(cell.folder(finished))
    rows = collect(config, finished)[0].filter(
        (polars.col("arm") == cell.arm) & (polars.col("seed") == cell.seed)
    )
    assert now.simulated_s == pytest.approx(rows["simulated_s"].sum())
    assert standing(finished / "nothing") == (0.0, 0.0)


def test_another_study_in_the_same_folder_is_refused(finished):
    with pytest.raises(StudyError, match=r"a study with other budget_s"):
        begin(StudyConfig.from_dict(changed(budget_s=300)), finished)
    arms = {**SMALL["arms"], "cma-es": {"optimizer": "random"}}
    with pytest.raises(StudyError, match=r"a study with other arms\.cma-es"):
        begin(StudyConfig.from_dict(changed(arms=arms)), finished)


def test_cells_of_other_settings_are_never_taken_for_this_studys(finished, tmp_path):
    shutil.copytree(finished, tmp_path / "copy")
    arms = {"ga-uniform": SMALL["arms"]["ga-uniform"]}
    fewer = StudyConfig.from_dict(changed(arms=arms))
    begin(fewer, tmp_path / "copy")
    other = StudyConfig.from_dict(changed(arms={**arms, "cma-es": {"optimizer": "random"}}))
    begin(other, tmp_path / "copy")
    with pytest.raises(ArmError, match=r"cma-es/seed-0 was run with other settings"):
        collect(other, tmp_path / "copy")


def test_table_never_loses_runs_that_are_not_there_any_more(finished, tmp_path):
    shutil.copytree(finished, tmp_path / "copy")
    config = load(finished)
    for cell in config.cells()[1:]:
        shutil.rmtree(cell.folder(tmp_path / "copy"))
    frame, missing = collect(config, tmp_path / "copy")
    assert not missing
    key = ["arm", "seed", "evaluation"]
    assert frame.sort(key).equals(collect(config, finished)[0].sort(key))


def test_looking_at_a_study_does_not_disturb_its_runs(finished):
    config = load(finished)
    with Journal(config.cells()[0].folder(finished)):
        assert is_finished(config, config.cells()[0], finished)
        assert collect(config, finished)[1] == []
    assert len(versions(config, finished)) == 1


@pytest.mark.slow
def test_runs_of_a_study_that_is_killed_end_with_it(tmp_path):
    (tmp_path / "small.toml").write_text(TOML)
    parent = subprocess.Popen(
        [sys.executable, "-c", "from evolution.cli import main; main(['study', 'small.toml'])"],
        cwd=tmp_path,
    )
    cell = tmp_path / "studies" / "small" / "cells" / "ga-uniform" / "seed-8"
    while not is_in_use(cell):
        time.sleep(0.02)
    parent.kill()
    parent.wait()
    deadline = time.monotonic() + 20
    while is_in_use(cell) and time.monotonic() < deadline:
        time.sleep(0.1)
    assert not is_in_use(cell)


@pytest.mark.slow
@pytest.mark.filterwarnings("default")
def test_cells_on_ray_give_the_same_bits(finished, tmp_path):
    pytest.importorskip("ray")
    arms = {"ga-uniform": SMALL["arms"]["ga-uniform"]}
    config = StudyConfig.from_dict(changed(arms=arms, seeds=[0]))
    begin(config, tmp_path / "ray")
    assert run_study(config, tmp_path / "ray", RayTasks()) == []
    ours, missing = collect(config, tmp_path / "ray")
    theirs, _ = collect(config, finished)
    assert not missing
    assert ours.drop("wall_s").equals(theirs.drop("wall_s"))


def test_folder_of_something_else_is_refused(tmp_path):
    (tmp_path / "notes.txt").write_text("mine")
    with pytest.raises(StudyError, match="is not empty and holds no study"):
        begin(StudyConfig.from_dict(SMALL), tmp_path)


# What it amounts to


def test_thresholds_come_from_the_pilot_seeds_and_stay(finished):
    config = load(finished)
    frame, _ = collect(config, finished)
    rows = frame.filter((polars.col("seed") == 8) & (polars.col("failure") == "ok"))
    top = courses(frame, config, (8,))["ga-uniform"][0].best_m[-1]
    assert rows["distance_m"].max() >= top > 0
    assert thresholds(config, finished, frame) == pytest.approx([0.5 * top, 0.75 * top, top])
    assert thresholds(config, finished, frame.clear()) == pytest.approx([0.5 * top, 0.75 * top, top])


def test_thresholds_are_shares_of_the_pilots_median_and_wait_for_all_of_them(tmp_path):
    config = StudyConfig.from_dict(changed(pilot_seeds=[7, 8, 9]))
    ends_m = {0: 0.5, 7: 0.09, 8: 0.01, 9: 0.02}
    rows = [
        {
            "arm": "ga-uniform", "seed": seed, "evaluation": 0, "generation": 0, "failure": "ok",
            "distance_m": end_m, "simulated_s": 30.0,
        }
        for seed, end_m in ends_m.items()
    ]  # fmt: skip
    assert thresholds(config, tmp_path, polars.DataFrame(rows[:-1])) is None
    assert thresholds(config, tmp_path, polars.DataFrame(rows)) == [0.01, 0.015, 0.02]


def test_pilot_seeds_are_in_no_table(finished):
    config = load(finished)
    frame, missing = collect(config, finished)
    found = analyse(config, frame, missing, [0.001])
    assert {c.seed for courses in found.courses.values() for c in courses} == {0, 1}
    assert {row.runs for row in found.finals} == {2}
    assert [row.arm for row in found.times[0.001]] == list(config.arms)


def test_course_of_a_run():
    course = Course(
        0,
        np.array([10.0, 20.0, 35.0, 50.0]),
        np.array([0.0, 0.01, 0.01, 0.03]),
        np.array([0, 0, 1, 1]),
        2,
    )
    assert course.reaches(0.01, 99.0) == (20.0, True)
    assert course.reaches(0.02, 99.0) == (50.0, True)
    assert course.reaches(0.04, 99.0) == (99.0, False)
    assert [course.at_generation(n) for n in (0, 1)] == [0.01, 0.03]
    assert np.isnan(course.at_generation(2))


def test_evaluations_beyond_the_budget_do_not_count():
    config = StudyConfig.from_dict(changed(budget_s=30))
    frame = polars.DataFrame(
        {
            "arm": ["cma-es"] * 4,
            "seed": [0] * 4,
            "evaluation": [0, 1, 2, 3],
            "generation": [0, 0, 1, 1],
            "failure": ["ok", "tipped", "ok", "ok"],
            "distance_m": [0.01, 0.5, -0.2, 0.9],
            "simulated_s": [10.0, 4.0, 16.0, 10.0],
        }
    )  # fmt: skip
    (course,) = courses(frame, config, (0, 1))["cma-es"]
    assert course.spent_s.tolist() == [10.0, 14.0, 30.0]
    assert course.generations == 1  # the second is not through
    assert course.best_m.tolist() == [0.01, 0.01, 0.01]


def test_report_is_one_page_with_all_arms(finished):
    page = (finished / "report.html").read_text()
    for arm in SMALL["arms"]:
        assert f"<td>{arm}" in page
    assert page.count("data:image/png;base64,") == 5
    assert "http" not in page
    assert "A pilot: with 2 runs" in page


def test_report_can_be_made_again_from_the_table_alone(finished, tmp_path, capsys):
    for name in ("study.json", "thresholds.json", DATA):
        (tmp_path / name).write_bytes((finished / name).read_bytes())
    with Journal(Cell("cma-es", 0).folder(finished)):  # as if it were still running
        assert cli.main(["report", str(finished), "--no-winners"]) == 0
    first = capsys.readouterr().out
    assert cli.main(["report", str(tmp_path), "--no-winners"]) == 0
    assert capsys.readouterr().out == first
    assert "cma-es" in first


def test_unfinished_study_says_what_is_missing_and_draws_the_rest(finished):
    config = load(finished)
    frame, _ = collect(config, finished)
    some = frame.filter((polars.col("arm") != "cma-es") | (polars.col("seed") == 0))
    found = analyse(config, some, [Cell("cma-es", 1)], None)
    said = headline(found)
    assert said[0].startswith("UNFINISHED: 1 of 5 runs are missing (cma-es seed 1)")
    assert any("not frozen yet" in sentence for sentence in said)
    assert {row.arm: row.runs for row in found.finals}["cma-es"] == 1


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["study"], "give either a TOML file or --preset"),
        (["study", "a.toml", "--preset", "pilot"], "give either a TOML file or --preset"),
        (["study", "nothing.toml"], "cannot read nothing.toml"),
        (["study", "broken.toml"], "broken.toml is not TOML"),
        (["report", "nowhere"], "nowhere holds neither a run (journal.sqlite) nor a study (study.json)"),
        (["report", "begun"], "no run of begun is finished yet"),
    ],
    ids=str,
)
def test_wrong_input_is_answered_in_one_line(tmp_path, monkeypatch, capsys, arguments, message):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "broken.toml").write_text("seeds = [")
    begin(StudyConfig.from_dict(SMALL), tmp_path / "begun")
    assert cli.main(arguments) in (1, 2)
    err = capsys.readouterr().err
    assert message in err
    assert err.count("\n") == 1


@pytest.mark.slow
def test_best_robots_are_looked_at_again(finished, capsys):
    assert cli.main(["report", str(finished)]) == 0
    rows = json.loads((finished / "winners" / "winners.json").read_text())
    assert set(rows) == set(SMALL["arms"])
    for arm, row in rows.items():
        assert row["recorded_m"] > 0
        assert (finished / "winners" / f"{arm}.json").exists()
        assert (
            cli.main(["replay", str(finished / "winners" / f"{arm}.json"), "--no-video", "--json"]) == 0
        )
        assert json.loads(capsys.readouterr().out.partition("{")[2].join(["{", ""]))["identical"]
    before = (finished / "winners" / "winners.json").stat().st_mtime_ns
    assert cli.main(["report", str(finished)]) == 0
    assert (finished / "winners" / "winners.json").stat().st_mtime_ns == before
