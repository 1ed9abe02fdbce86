"""`caterpillar runs` lists runs in every state."""

import json

from caterpillar_env.robot import Robot
from evolution import cli
from evolution.config import RunConfig
from evolution.optimizers.ga import GaConfig
from evolution.run.journal import Journal
from evolution.run.loop import evolve


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
    Journal.create(tmp_path / "run", RunConfig(budget_s=240.0).to_dict()).close()
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


def test_runs_with_a_budget_show_the_spent_share(tmp_path, invented, capsys):
    config = RunConfig(budget_s=400.0, ga=GaConfig(population=4, hall_of_fame=1))

    def stop(generation):
        raise KeyboardInterrupt

    history = evolve(config, tmp_path / "run", evaluator=invented, on_generation=stop)
    assert cli.main(["runs", str(tmp_path), "--json"]) == 0
    (row,) = json.loads(capsys.readouterr().out)
    assert row["generation"] == f"1 ({100 * history.simulated_s / 400:.0f} %)"
