"""Exporting runs and listing them."""

import json
from dataclasses import replace

import mujoco
import numpy as np
import polars
import pytest

from caterpillar_env.errors import CaterpillarError
from caterpillar_env.physics import Physics
from caterpillar_env.robot import Outcomes, Robot
from caterpillar_env.task import Failure
from evolution import cli
from evolution.config import RunConfig
from evolution.optimizers.ga import GaConfig
from evolution.run.evaluators import LocalEvaluator
from evolution.run.history import History, load
from evolution.run.journal import FILE, Journal
from evolution.run.loop import evolve

CONFIG = RunConfig(
    seed=4, generations=2, physics=Physics(num_segments=2, timestep_s=0.01),
    ga=GaConfig(population=3, hall_of_fame=1),
)  # fmt: skip


@pytest.fixture(scope="module")
def runs(tmp_path_factory):
    """A folder with a finished run, one that was stopped, and one that is damaged."""
    folder = tmp_path_factory.mktemp("runs")

    def stop(generation):
        raise KeyboardInterrupt

    for name, hook in (("done", None), ("stopped", stop), ("damaged", None)):
        evolve(CONFIG, folder / name, evaluator=LocalEvaluator(1), on_generation=hook)
    (folder / "empty").mkdir()
    (folder / "policy.json").write_text('{"fitness_m": 0.1, "morphology": {}, "training": {}}')
    with (folder / "damaged" / FILE).open("r+b") as file:
        file.truncate(6000)
    return folder


@pytest.mark.parametrize(
    ("kind", "read"),
    [("csv", polars.read_csv), ("parquet", polars.read_parquet), ("json", polars.read_json)],
)
def test_exported_tables_equal_the_journal(runs, tmp_path, kind, read, capsys):
    out = tmp_path / f"rows.{kind}"
    assert cli.main(["export", str(runs / "done"), "--to", kind, "--out", str(out)]) == 0
    assert "5 evaluations written to" in capsys.readouterr().err
    assert read(out).equals(load(runs / "done").table())


def test_export_is_written_beside_the_journal_and_contains_the_best_robot(runs):
    assert cli.main(["export", str(runs / "done")]) == 0
    rows = polars.read_csv(runs / "done" / "evaluations.csv")
    best = Robot.load(runs / "done")
    row = rows.row(int(rows["fitness"].arg_max()), named=True)
    assert row["distance_m"] == best.fitness_m
    assert row["segment_mass_kg"] == best.morphology.segment_mass_kg
    assert row["gap1_ventral_off_s"] == best.timings.off_s[1]


@pytest.mark.parametrize("source", ["done", "done/best.json"])
def test_robot_of_a_run_is_exported_as_a_model(runs, source, capsys):
    out = runs / "done" / "best.xml"
    out.unlink(missing_ok=True)
    assert cli.main(["export", str(runs / source), "--to", "mjcf"]) == 0
    assert f"with 2 segments written to {out}" in capsys.readouterr().err
    model = mujoco.MjModel.from_xml_path(str(out))
    best = Robot.load(runs / "done")
    assert model.nu == 4
    assert model.opt.timestep == 0.01
    assert model.body_mass.sum() == pytest.approx(2 * best.morphology.segment_mass_kg)


@pytest.mark.parametrize("genome", ["full", "per-segment"])
def test_robots_of_all_kinds_are_exported(tmp_path, genome):
    encoding = replace(CONFIG, genome=genome, physics=Physics(num_segments=3)).encoding
    genes = np.random.default_rng(1).random(len(encoding.genes))
    encoding.robot(genes).save(tmp_path / "robot.json")
    out = tmp_path / "model.xml"  # the suffix selects the kind
    assert cli.main(["export", str(tmp_path / "robot.json"), "--out", str(out)]) == 0
    assert mujoco.MjModel.from_xml_path(str(out)).nu == 8


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["export", "nowhere"], "is not a run folder"),
        (["export", "done", "--to", "xlsx"], "--to"),
        (["export", "done", "--out", "missing/rows.csv"], "choose another place with --out"),
        (["export", "damaged"], "is damaged"),
        (["export", "done/best.json"], "is not a run folder"),
        (["export", "nowhere", "--to", "mjcf"], "give a run folder or the JSON file of one robot"),
        (["export", "empty", "--to", "mjcf"], "empty holds no best.json"),
        (["export", "done", "--to", "mjcf", "--out", "missing/robot.xml"], "cannot write missing/robot"),
        (["export", "done", "--to", "mjcf", "--out", "empty"], "choose another place with --out"),
        (["export", "policy.json", "--to", "mjcf"], "for a trained policy, use caterpillar rl eval"),
        (["runs", "nowhere"], "nowhere is not a folder"),
    ],
)
def test_wrong_input_is_refused_with_the_reason(runs, monkeypatch, capsys, arguments, message):
    monkeypatch.chdir(runs)
    assert cli.main(arguments) in (1, 2)
    assert message in capsys.readouterr().err


def test_runs_are_listed_with_their_state(runs, capsys):
    assert cli.main(["runs", str(runs), "--json"]) == 0
    rows = {row["run"].rsplit("/", 1)[1]: row for row in json.loads(capsys.readouterr().out)}
    assert rows["done"]["state"] == "finished"
    assert rows["done"]["generation"] == "2 of 2"
    assert rows["done"]["best, mm"] == round(1000 * Robot.load(runs / "done").fitness_m, 1)
    assert rows["stopped"]["state"] == "stopped"
    assert rows["stopped"]["evaluations"] == 3
    assert "is damaged" in rows["damaged"]["state"]


def test_a_run_with_a_budget_is_listed_without_a_number_of_generations(tmp_path, capsys):
    (tmp_path / "run").mkdir()
    Journal.create(tmp_path / "run", replace(CONFIG, budget_s=240.0).to_dict()).close()
    assert cli.main(["runs", str(tmp_path), "--json"]) == 0
    (row,) = json.loads(capsys.readouterr().out)
    assert row["generation"] == "0 (0 %)"


def test_a_run_in_progress_is_listed_as_running(runs, capsys):
    for name in ("stopped", "done"):  # the second run is being extended
        with Journal(runs / name):
            assert cli.main(["runs", str(runs / name), "--json"]) == 0
        (row,) = json.loads(capsys.readouterr().out)
        assert row["state"] == "running"


def test_a_folder_without_runs_is_not_an_error(tmp_path, capsys):
    assert cli.main(["runs", str(tmp_path)]) == 0
    assert "no runs in" in capsys.readouterr().err


# leaders


def test_leaders_are_the_best_so_far_and_crawl_as_recorded(runs):
    rows = load(runs / "done").table()
    found = load(runs / "done").leaders()
    assert len(found) == CONFIG.generations
    for number, leader in enumerate(found):
        so_far = rows.filter(polars.col("generation") <= number)
        assert leader.fitness_m == so_far["fitness"].max()
        best = so_far.row(so_far["fitness"].arg_max(), named=True)
        assert leader.generation == best["generation"]
        assert leader.morphology.segment_length_m == best["segment_length_m"]
    assert found[-1].simulate(threads=1).fitness()[0] == found[-1].fitness_m


def test_farthest_robot_leads_until_a_robot_qualifies_as_the_best(tmp_path):
    rng = np.random.default_rng(0)
    genomes = rng.random((6, len(CONFIG.encoding.genes)))
    outcomes = Outcomes(
        np.array([Failure.VEERED, Failure.DIVERGED, Failure.TIPPED, 0, 0, 0]),
        np.array([0.01, 0.0, 0.05, -0.01, 0.002, 0.001]),
        np.ones(6), np.full(6, 30.0),
    )  # fmt: skip
    config = replace(CONFIG, failed_fitness=0.1)  # must not make a failed robot the best
    with Journal.create(tmp_path, config.to_dict()) as journal:
        journal.begin()
        history = History(journal)
        for generation in range(3):
            part = slice(2 * generation, 2 * generation + 2)
            history.append(genomes[part], Outcomes(*(field[part] for field in outcomes)))
            history.complete()
    fitness_m = [leader.fitness_m for leader in load(tmp_path).leaders()]
    assert fitness_m == [0.0, 0.0, 0.002]
    assert [leader.generation for leader in load(tmp_path).leaders()] == [0, 1, 2]


def test_ties_for_the_best_go_to_the_robot_evaluated_first(tmp_path):
    genomes = np.random.default_rng(0).random((3, len(CONFIG.encoding.genes)))
    outcomes = Outcomes(np.zeros(1, dtype=np.int8), np.array([0.1]), np.ones(1), np.full(1, 30.0))
    with Journal.create(tmp_path, CONFIG.to_dict()) as journal:
        journal.begin()
        history = History(journal)
        for genome in genomes:
            history.append(genome[None], outcomes)
            history.complete()
        assert history.best.number == 0
    assert Robot.load(tmp_path).evaluation == load(tmp_path).best.number == 0


def test_a_generation_completed_during_reading_is_excluded(tmp_path, monkeypatch):
    genomes = np.random.default_rng(0).random((2, len(CONFIG.encoding.genes)))
    outcomes = Outcomes(np.zeros(1, dtype=np.int8), np.array([0.1]), np.ones(1), np.full(1, 30.0))
    read_evaluations, calls = Journal.evaluations, []

    def read_slowly(journal):
        yield from read_evaluations(journal)
        calls.append(journal)
        if len(calls) == 1:
            writer.append(genomes[1:], outcomes)
            writer.complete()

    with Journal.create(tmp_path, CONFIG.to_dict()) as journal:
        journal.begin()
        writer = History(journal)
        writer.append(genomes[:1], outcomes)
        writer.complete()
        monkeypatch.setattr(Journal, "evaluations", read_slowly)
        assert len(load(tmp_path).generations) == 1
        assert len(load(tmp_path).generations) == 2


def test_run_without_evaluations_has_no_leaders(tmp_path):
    Journal.create(tmp_path, {**CONFIG.to_dict(), "own_optimizer": None}).close()
    with pytest.raises(CaterpillarError, match=r"has no completed generation; .* `caterpillar resume"):
        load(tmp_path).leaders()
