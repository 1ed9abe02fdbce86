"""A study of small robots: running, stopping and resuming."""

import shutil
import subprocess
import sys
import threading
import time
import tomllib
from pathlib import Path

import numpy as np
import polars
import pytest

from caterpillar_env import machine
from caterpillar_env.errors import CaterpillarError
from caterpillar_env.robot import Outcomes
from evolution import cli
from evolution.run.database import JournalError, is_in_use, lock
from evolution.run.history import History
from evolution.run.journal import Journal, read_simulated_s
from evolution.run.loop import resume
from evolution.study.cells import Processes, RayTasks, run_study
from evolution.study.config import Cell, StudyConfig, begin, load
from evolution.study.results import DATA, collect, read_kept, read_run

TOML = Path(__file__).with_name("small.toml").read_text("utf-8")
SMALL = tomllib.loads(TOML)


def changed(**fields):
    return {**SMALL, **fields}


@pytest.fixture(scope="module")
def uninterrupted(tmp_path_factory):
    """A finished study with a single seed, and its folder."""
    config, folder = StudyConfig.from_dict(changed(seeds=[0])), tmp_path_factory.mktemp("uninterrupted")
    begin(config, folder)
    assert run_study(config, folder, Processes(2)) == []
    return config, folder


def test_a_finished_study_is_never_run_again(finished):
    config = load(finished)
    before = {p: p.stat().st_mtime_ns for p in finished.glob("cells/**/journal.sqlite")}
    assert len(before) == len(config.cells())
    assert run_study(config, finished, Processes(2)) == []
    assert {p: p.stat().st_mtime_ns for p in finished.glob("cells/**/journal.sqlite")} == before


def test_every_run_spends_its_budget_and_stops(finished):
    config = load(finished)
    results = collect(config, finished)
    assert not results.missing
    spent = results.table.group_by("arm", "seed").agg(polars.col("simulated_s").sum())
    assert len(spent) == 4
    for total in spent["simulated_s"]:
        assert 240 <= total < 240 + 4 * 30


@pytest.mark.slow
def test_an_interrupted_study_is_resumed_with_the_same_result(uninterrupted, tmp_path):
    config, finished = uninterrupted
    begin(config, tmp_path / "again")
    workers = Processes(2)

    def stop(ended, share):
        if share > 0:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        run_study(config, tmp_path / "again", workers, stop)
    assert len(collect(config, tmp_path / "again").missing) > 0
    assert run_study(config, tmp_path / "again", Processes(2)) == []
    ours, theirs = (collect(config, folder).table for folder in (tmp_path / "again", finished))
    assert ours.equals(theirs)


def test_a_run_that_fails_is_reported_and_does_not_stop_the_others(tmp_path):
    arms = {"ga-uniform": {"prior": "uniform"}}
    config = StudyConfig.from_dict(changed(budget_s=90, arms=arms))
    begin(config, tmp_path)
    broken = Cell("ga-uniform", 1).folder(tmp_path)
    broken.mkdir(parents=True)
    (broken / "journal.sqlite").write_text("not a journal")
    ((cell, error),) = run_study(config, tmp_path, Processes(2))
    assert cell == Cell("ga-uniform", 1)
    assert "is damaged" in error
    assert read_run(config, Cell("ga-uniform", 0), tmp_path).finished


def test_a_study_is_run_by_one_process_at_a_time(tmp_path):
    config = StudyConfig.from_dict(SMALL)
    begin(config, tmp_path)
    with lock(tmp_path), pytest.raises(JournalError, match="another process is working on"):
        run_study(config, tmp_path, Processes(1))
    assert not (tmp_path / "cells").exists()
    longer = StudyConfig.from_dict(changed(seeds=[0, 1, 2]))
    with lock(tmp_path), pytest.raises(JournalError, match="another process is working on"):
        begin(longer, tmp_path)
    assert load(tmp_path) == config


def test_progress_of_a_run_is_read_from_its_journal(finished):
    config = load(finished)
    cell = config.cells()[0]
    rows = collect(config, finished).table.filter(arm=cell.arm, seed=cell.seed)
    simulated_s = read_simulated_s(cell.folder(finished))
    assert simulated_s == pytest.approx(rows["simulated_s"].sum())
    assert read_simulated_s(finished / "nothing") == 0.0


class Waiting:
    """Workers whose runs wait until their progress is reported."""

    count = 2

    def __init__(self):
        self.reported = threading.Event()

    def __enter__(self):
        return self

    def __exit__(self, *_):
        return None

    def run(self, task, cells):
        self.reported.wait(timeout=20)


@pytest.fixture
def begun(tmp_path):
    """A study whose runs have 9, 4 and 8 evaluations of 30 s. The budget of a run is 240 s."""
    config = StudyConfig.from_dict(
        changed(seeds=[2, 0, 1], arms={"ga-uniform": SMALL["arms"]["ga-uniform"]})
    )
    arm = config.arms["ga-uniform"]
    for seed, evaluations in ((2, 9), (0, 4), (1, 8)):
        folder = Cell("ga-uniform", seed).folder(tmp_path)
        folder.mkdir(parents=True)
        with Journal.create(folder, arm.run_config(seed, config.budget_s).to_dict()) as journal:
            history = History(journal)
            history.begin()
            genomes = np.full((evaluations, len(arm.config.encoding.genes)), 0.5)
            ends = np.full((3, evaluations), 30.0)
            history.append(genomes, Outcomes(np.zeros(evaluations, dtype=np.int8), *ends))
            history.complete()
            if seed == 1:
                history.finish()
    return config


def report_progress(config, folder):
    workers, reports = Waiting(), []

    def report(ended, share):
        reports.append((ended, share))
        workers.reported.set()

    run_study(config, folder, workers, report)
    return reports


def test_progress_counts_every_run_up_to_its_budget(tmp_path, begun):
    reports = report_progress(begun, tmp_path)
    assert reports[0] == (2, pytest.approx((1.0 + 0.5 + 1.0) / 3))
    assert reports[-1] == (3, 1.0)


def test_progress_includes_runs_that_are_not_restored_yet(tmp_path, begun):
    collect(begun, tmp_path)
    shutil.rmtree(tmp_path / "cells")
    reports = report_progress(begun, tmp_path)
    assert reports[0] == (2, pytest.approx((1.0 + 0.5 + 1.0) / 3))


@pytest.mark.slow
def test_runs_end_if_their_study_is_killed(tmp_path):
    (tmp_path / "small.toml").write_text(TOML)
    parent = subprocess.Popen(
        [sys.executable, "-c", "from evolution.cli import main; main(['study', 'small.toml'])"],
        cwd=tmp_path,
    )
    cell = tmp_path / "studies" / "small" / "cells" / "ga-uniform" / "seed-0"
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
def test_cells_on_ray_give_the_same_bits(uninterrupted, tmp_path):
    """Run more cells than cores, then a single cell, whose genomes are evaluated on the cluster."""
    ray = pytest.importorskip("ray")
    config, finished = uninterrupted
    begin(config, tmp_path)
    own = {"address": "local", "num_cpus": 2, "include_dashboard": False}  # not another test's cluster
    with ray.init(**own, log_to_driver=False, logging_level="ERROR"):
        assert run_study(config, tmp_path, RayTasks()) == []
        assert collect(config, tmp_path).table.equals(collect(config, finished).table)
        last = config.cells()[-1].folder(tmp_path)
        shutil.rmtree(last)
        (tmp_path / DATA).unlink()
        assert run_study(config, tmp_path, RayTasks()) == []
    ours = collect(config, tmp_path)
    assert not ours.missing
    assert ours.table.equals(collect(config, finished).table)


# Continuing from the table of evaluations


def test_runs_in_the_table_are_not_repeated_without_their_folders(finished, tmp_path):
    class Never(Processes):
        def run(self, task, cells):
            raise AssertionError("nothing is left to run")

    study = tmp_path / "study"
    shutil.copytree(finished, study, ignore=shutil.ignore_patterns("cells"))
    assert run_study(load(study), study, Never(1)) == []
    before = polars.read_parquet(study / DATA)
    assert collect(load(study), study).table.equals(before)


def test_unfinished_and_longer_runs_continue_from_the_table_alone(finished, tmp_path):
    whole = polars.read_parquet(finished / DATA)
    halved = Cell("cma-es", 0)
    is_halved = (polars.col("arm") == halved.arm) & (polars.col("seed") == halved.seed)
    kept = whole.filter(~is_halved | (polars.col("generation") == 0))
    assert len(whole) - len(kept) > 0
    config = StudyConfig.from_dict(changed(long_seeds=[1], long_budget_s=300))
    begin(config, tmp_path)
    kept.write_parquet(tmp_path / DATA)
    longer = Cell("ga-uniform", 1)
    assert collect(config, tmp_path).missing == [halved, longer]
    assert run_study(config, tmp_path, Processes(2)) == []
    assert {path.parent.name for path in tmp_path.glob("cells/*/*")} == set(SMALL["arms"])
    results = collect(config, tmp_path)
    assert not results.missing
    rows = results.table.filter(arm=longer.arm, seed=longer.seed)
    first = whole.filter(arm=longer.arm, seed=longer.seed)
    assert first["simulated_s"].sum() < 300 <= rows["simulated_s"].sum()
    assert rows[: len(first)].equals(first)
    others = ~((polars.col("arm") == longer.arm) & (polars.col("seed") == longer.seed))
    assert results.table.filter(others).equals(whole.filter(others))


def test_interrupted_run_continues_in_its_own_journal(finished, tmp_path):
    config = StudyConfig.from_dict(changed(arms={"ga-uniform": {"prior": "uniform"}}, seeds=[0]))
    begin(config, tmp_path)
    (cell,) = config.cells()
    rows = polars.read_parquet(finished / DATA).filter(arm=cell.arm, seed=cell.seed, generation=0)
    config.arms[cell.arm].restore(rows, cell.folder(tmp_path), cell.seed, config.budget_s)
    collect(config, tmp_path)

    def stop(generation):
        if not generation.replayed:
            raise KeyboardInterrupt

    assert not resume(cell.folder(tmp_path), on_generation=stop).finished
    assert run_study(config, tmp_path, Processes(1)) == []
    history = read_run(config, cell, tmp_path)
    assert history.finished
    assert len(history.sessions) == 3  # a journal that is made again from the table has fewer


def test_run_whose_genomes_have_changed_is_not_continued(finished, tmp_path):
    config = load(finished)
    rows = polars.read_parquet(finished / DATA).filter(generation=0)
    rows.with_columns(polars.col("segment_mass_kg") * 1.01).write_parquet(tmp_path / DATA)
    cell = config.cells()[0]
    with pytest.raises(CaterpillarError, match="the genomes of generation 0 differ from the recorded"):
        config.arms[cell.arm].restore(
            read_kept(tmp_path)[cell], cell.folder(tmp_path), cell.seed, config.budget_s
        )
    assert not cell.folder(tmp_path).exists()


# The command `study`


def test_processes_limit_the_simultaneous_runs(tmp_path, monkeypatch):
    counts = []

    def stop(config, folder, workers, on_progress):
        counts.append(workers.count)
        raise KeyboardInterrupt

    monkeypatch.setattr("evolution.cli.study.run_study", stop)
    for flags in (["--processes", "3"], []):
        arguments = ["study", str(Path(__file__).with_name("small.toml")), "--out", str(tmp_path)]
        assert cli.main([*arguments, *flags]) == 130
    assert counts == [3, machine.cores()]


def test_study_with_a_failed_run_exits_with_status_1(finished, tmp_path, monkeypatch, capsys):
    shutil.copytree(finished, tmp_path / "study")
    failed = [(Cell("cma-es", 1), "no space")]
    monkeypatch.setattr("evolution.cli.study.run_study", lambda *_: failed)
    arguments = ["study", str(Path(__file__).with_name("small.toml")), "--out", str(tmp_path / "study")]
    assert cli.main(arguments) == 1
    assert "cma-es seed 1 failed: no space" in capsys.readouterr().err


def test_stopped_study_leaves_its_evaluations_in_the_table(finished, tmp_path, monkeypatch):
    shutil.copytree(finished, tmp_path / "study")
    (tmp_path / "study" / DATA).unlink()

    def stop(*_):
        raise KeyboardInterrupt

    monkeypatch.setattr("evolution.cli.study.run_study", stop)
    arguments = ["study", str(Path(__file__).with_name("small.toml")), "--out", str(tmp_path / "study")]
    assert cli.main(arguments) == 130
    before, after = (polars.read_parquet(folder / DATA) for folder in (finished, tmp_path / "study"))
    assert after.equals(before)
