"""Trainings of small robots: what is kept, what is counted, what is refused."""

import csv
import json
import sys

import numpy as np
import pytest

from baselines import training
from baselines.training import Point, TrainConfig, TrainingError, crawl, hyperparameters, load, train
from evolution import cli

SMALL = {"num_segments": 2, "timestep_s": 0.01}


def config(algorithm="ppo", mode="switch", **fields):
    given = {"budget_s": 300.0, "evaluations": 3, "physics": SMALL, "seed": 1}
    return TrainConfig(algorithm=algorithm, mode=mode, **{**given, **fields})


@pytest.fixture(scope="module")
def trained(tmp_path_factory):
    folder = tmp_path_factory.mktemp("rl") / "ppo"
    return folder, train(config(), folder)


def test_budget_counts_training_and_evaluation_and_is_kept(trained):
    _, result = trained
    assert result.finished
    last = result.points[-1].simulated_s
    # A step of all robots and two evaluations are kept back for the end.
    assert 300.0 - 32 * 0.1 - 2 * 30.0 - 5.0 < last <= 300.0
    assert len(result.points) >= 3


def test_record_holds_every_evaluation(trained):
    folder, result = trained
    with (folder / "evaluations.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert [float(row["distance_m"]) for row in rows] == [p.distance_m for p in result.points]
    assert [float(row["simulated_s"]) for row in rows] == [p.simulated_s for p in result.points]
    assert TrainConfig(**json.loads((folder / "config.json").read_text())) == config()


def test_best_policy_crawls_as_far_again(trained):
    folder, result = trained
    again, model, normalizer = load(folder)
    judge = again.environment(1)
    judge.seed(again.seed)
    final = crawl(model, judge, normalizer)
    judge.close()
    assert final["distance"] == max(p.distance_m for p in result.points if p.failure == "ok")


def test_policy_that_fails_is_not_the_best(tmp_path, monkeypatch):
    finals = iter([(0.5, "tipped"), (0.01, "ok"), (0.4, "veered")])

    def fake(*_args):
        distance, failure = next(finals, (0.0, "ok"))
        return {"distance": distance, "energy_j": 1.0, "time_s": 3.0, "failure": failure}

    monkeypatch.setattr(training, "crawl", fake)
    result = train(config(), tmp_path / "run")
    assert result.best.distance_m == 0.01


def test_policies_that_all_fail_have_no_best(tmp_path, monkeypatch):
    final = {"distance": 0.5, "energy_j": 1.0, "time_s": 3.0, "failure": "tipped"}
    monkeypatch.setattr(training, "crawl", lambda *_args: final)
    assert train(config(), tmp_path / "run").best is None
    load(tmp_path / "run")


def test_interrupt_leaves_the_policies_so_far(tmp_path):
    def stop(point: Point) -> None:
        raise KeyboardInterrupt

    result = train(config(), tmp_path / "run", stop)
    assert not result.finished
    assert load(tmp_path / "run", "last")[1].num_timesteps >= 0


@pytest.mark.slow
@pytest.mark.parametrize(
    ("algorithm", "mode"),
    [("ppo", "timing"), ("sac", "timing"), ("tqc", "timing"), ("ars", "timing"), ("a2c", "switch")],
)
@pytest.mark.filterwarnings("default")
def test_every_algorithm_trains_and_comes_back(tmp_path, algorithm, mode):
    result = train(config(algorithm, mode, budget_s=2000.0), tmp_path / "run")
    assert result.finished
    assert np.isfinite([p.distance_m for p in result.points]).all()
    assert load(tmp_path / "run", "last")[1]._n_updates > 0


@pytest.mark.parametrize(
    ("fields", "message"),
    [
        ({"algorithm": "dqn"}, "algorithm = 'dqn' must be one of ppo"),
        ({"mode": "hope"}, "mode = 'hope' must be one of timing, switch"),
        ({"algorithm": "sac"}, "sac cannot learn in mode 'switch'; it can in timing"),
        ({"budget_s": 0}, "budget_s = 0 must be a positive"),
        ({"evaluations": 0}, "evaluations = 0"),
        ({"seed": -1}, "seed = -1"),
        ({"seed": 2**32}, "seed = 4294967296"),
    ],
    ids=str,
)
def test_unusable_settings_are_refused(fields, message):
    with pytest.raises(TrainingError, match=message):
        config(**fields)


def test_hyperparameters_are_those_of_rl_zoo():
    for path in training.HYPERPARAMETERS.glob("*.yml"):
        for mode in training.ENVIRONMENTS:
            try:
                found = hyperparameters(TrainConfig(algorithm=path.stem, mode=mode))
            except TrainingError:
                continue
            assert {"policy", "n_timesteps", "n_envs"} <= set(found)


def test_folder_that_holds_something_is_refused(trained):
    with pytest.raises(TrainingError, match="is not empty; choose another with --out"):
        train(config(), trained[0])


def test_commands(trained, tmp_path, capsys):
    folder, result = trained
    assert cli.main(["rl", "eval", str(folder)]) == 0
    assert f"{1000 * result.best.distance_m:.1f} mm" in capsys.readouterr().out
    flags = ["--budget-s", "100", "--evaluations", "1", "--out", str(tmp_path / "run")]
    assert cli.main(["rl", "train", *flags]) == 0
    said = capsys.readouterr()
    assert said.out.startswith("best: ")
    assert "deterministic policy" in said.err


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ([], "choose from train, eval; got nothing"),
        (["teach"], "choose from train, eval; got teach"),
        (["eval", "nowhere"], "nowhere holds no trained policy"),
    ],
    ids=str,
)
def test_wrong_input_is_answered_in_one_line(arguments, message, capsys):
    assert cli.main(["rl", *arguments]) == 1
    err = capsys.readouterr().err
    assert message in err
    assert err.count("\n") == 1


def test_without_the_extra_it_says_what_to_install(monkeypatch, capsys):
    monkeypatch.setitem(sys.modules, "sb3_contrib", None)
    assert cli.main(["rl", "train"]) == 1
    assert "pip install 'caterpillar-sma[rl]'" in capsys.readouterr().err
