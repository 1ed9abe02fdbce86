"""Groups and summaries of training runs."""

import numpy as np
import pytest

from baselines.cli.compare import summarize
from baselines.config import TrainConfig, Training, make_configuration
from caterpillar_env.errors import CaterpillarError
from caterpillar_env.robot import Outcomes
from caterpillar_env.task import Failure
from evolution.run.history import History
from evolution.run.journal import Journal


def record(folder, results, **fields):
    """Record a training run with these distances and failures at intervals of 100 s."""
    folder.mkdir(parents=True)
    config = TrainConfig(**fields)
    with Journal.create(folder, make_configuration(config)) as journal:
        journal.begin()
        history = History(journal)
        for distance_m, failure in results:
            row = (failure, distance_m, 1.0, 100.0)
            outcomes = Outcomes(*(np.array([value]) for value in row))
            history.append(config.morphology.to_unit()[None], outcomes)
            history.complete()
    return Training.read(folder)


OK, TIPPED = Failure.NONE, Failure.TIPPED


@pytest.fixture
def trainings(tmp_path):
    return [
        record(tmp_path / "a", [(0.001, OK), (0.05, OK), (0.9, TIPPED)], seed=0),
        record(tmp_path / "b", [(0.3, TIPPED), (0.02, OK)], seed=1),
        record(tmp_path / "c", [(-0.01, OK)], seed=0, mode="timing"),
    ]


def test_trainings_that_differ_only_in_the_seed_form_a_group(trainings):
    rows = summarize(trainings)
    assert [(row["name"], row["runs"]) for row in rows] == [("ppo phase", 2), ("ppo timing", 1)]


def test_groups_with_the_same_title_get_numbers(tmp_path):
    one = record(tmp_path / "a", [(0.0, OK)], budget_s=1000.0)
    two = record(tmp_path / "b", [(0.0, OK)], budget_s=2000.0)
    assert [row["name"] for row in summarize([one, two])] == ["ppo phase", "ppo phase #2"]


def test_summary_covers_the_best_and_the_untrained_policies(trainings):
    row, other = summarize(trainings)
    assert row["simulated_s"] == 250.0
    assert (row["least_m"], row["median_m"], row["most_m"]) == (0.02, pytest.approx(0.035), 0.05)
    assert row["untrained_m"] == pytest.approx((0.001 + 0.0) / 2)  # a failure counts as 0
    assert other["median_m"] == 0.0  # no policy crawled forwards


def test_training_without_evaluations_is_rejected(tmp_path):
    with pytest.raises(CaterpillarError, match="has no evaluation yet"):
        summarize([record(tmp_path / "a", [])])
