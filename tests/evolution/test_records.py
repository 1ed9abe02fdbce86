"""Exporting runs and listing them."""

import json

import polars
import pytest

from caterpillar_env.model import Physics
from evolution import cli
from evolution.evaluators import LocalEvaluator
from evolution.individual import Individual
from evolution.journal import FILE, Journal
from evolution.optimizers.ga import GaConfig
from evolution.records import table
from evolution.run import RunConfig, evolve

CONFIG = RunConfig(
    seed=4, generations=2, physics=Physics(num_segments=2, timestep_s=0.01),
    ga=GaConfig(population=3, hall_of_fame=1),
)  # fmt: skip


@pytest.fixture(scope="module")
def runs(tmp_path_factory):
    """A folder with a finished run, one that was stopped, and one that is damaged."""
    folder = tmp_path_factory.mktemp("runs")

    def stop(told):
        raise KeyboardInterrupt

    for name, hook in (("done", None), ("stopped", stop), ("damaged", None)):
        evolve(CONFIG, folder / name, evaluator=LocalEvaluator(1), on_generation=hook)
    with (folder / "damaged" / FILE).open("r+b") as file:
        file.truncate(6000)
    return folder


@pytest.mark.parametrize(
    ("kind", "read"),
    [("csv", polars.read_csv), ("parquet", polars.read_parquet), ("json", polars.read_json)],
)
def test_exported_tables_hold_every_bit(runs, tmp_path, kind, read, capsys):
    out = tmp_path / f"rows.{kind}"
    assert cli.main(["export", str(runs / "done"), "--to", kind, "--out", str(out)]) == 0
    assert "5 evaluations in" in capsys.readouterr().err
    assert read(out).equals(table(runs / "done"))


def test_export_goes_beside_the_journal_and_best_robot_is_in_it(runs):
    assert cli.main(["export", str(runs / "done")]) == 0
    rows = polars.read_csv(runs / "done" / "evaluations.csv")
    best = Individual.load(runs / "done")
    row = rows.row(int(rows["fitness"].arg_max()), named=True)
    assert row["distance_m"] == best.fitness_m
    assert row["segment_mass_kg"] == best.morphology.segment_mass_kg
    assert row["gap1_ventral_off_s"] == best.timings.off_s[1]


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["export", "nowhere"], "it is no run folder"),
        (["export", "done", "--to", "xlsx"], "--to"),
        (["export", "done", "--out", "missing/rows.csv"], "choose another file with --out"),
        (["export", "damaged"], "is damaged"),
        (["runs", "nowhere"], "is no folder"),
    ],
)
def test_wrong_input_is_answered_in_one_line(runs, monkeypatch, capsys, arguments, message):
    monkeypatch.chdir(runs)
    assert cli.main(arguments) in (1, 2)
    said = capsys.readouterr().err
    assert message in said
    assert said.count("\n") == 1


def test_runs_are_listed_with_their_state(runs, capsys):
    assert cli.main(["runs", str(runs), "--json"]) == 0
    rows = {row["run"].rsplit("/", 1)[1]: row for row in json.loads(capsys.readouterr().out)}
    assert rows["done"]["state"] == "finished"
    assert rows["done"]["generation"] == "2 of 2"
    assert rows["done"]["best, mm"] == round(1000 * Individual.load(runs / "done").fitness_m, 1)
    assert rows["stopped"]["state"] == "stopped"
    assert rows["stopped"]["evaluations"] == 3
    assert "is damaged" in rows["damaged"]["state"]


def test_a_run_that_is_worked_on_is_running(runs, capsys):
    with Journal(runs / "stopped"):
        assert cli.main(["runs", str(runs)]) == 0
    assert "running" in capsys.readouterr().out


def test_no_runs_is_no_error(tmp_path, capsys):
    assert cli.main(["runs", str(tmp_path)]) == 0
    assert "no runs in" in capsys.readouterr().err
