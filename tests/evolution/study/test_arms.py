"""What a run that is an arm's says of itself, of made-up records whose answers are known."""

import numpy as np
import pytest

from caterpillar_env.robot import Outcomes
from caterpillar_env.task import Failure
from evolution.config import RunConfig
from evolution.run.journal import Journal
from evolution.study.arms import EvolutionArm, Standing

ARM = EvolutionArm(RunConfig())


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    """Robots that crawl 10 mm, tip over at 500, crawl 30 mm, and 900 once 100 s are spent."""
    folder = tmp_path_factory.mktemp("arm")
    outcomes = Outcomes(
        np.array([0, Failure.TIPPED, 0, 0], dtype=np.int8), np.array([0.01, 0.95, 0.03, 0.9]),
        np.ones(4), np.array([30.0, 10.0, 30.0, 30.0]),
    )  # fmt: skip
    with Journal.create(folder, ARM.run_config(0, 80.0).to_dict()) as journal:
        journal.append(0, 0, np.tile(np.linspace(0.1, 0.4, 4)[:, None], 20), outcomes, journal.begin())
    return folder


@pytest.mark.parametrize(
    ("budget_s", "best_m"), [(20.0, None), (40.0, 0.01), (80.0, 0.03), (100.0, 0.9)]
)
def test_best_robot_did_not_fail_and_is_of_within_the_budget(run, budget_s, best_m):
    robot = ARM.best(run, budget_s)
    assert (robot and robot.fitness_m) == best_m
    if best_m == 0.03:
        assert robot.morphology.to_unit() == pytest.approx([0.3] * 8)


def test_standing_counts_no_failure(run, tmp_path):
    assert ARM.standing(run) == Standing(100.0, 0.9)
    assert ARM.standing(tmp_path) == Standing(0.0, 0.0)  # not begun


def test_run_that_is_gone_on_with_is_not_finished(run):
    """One that came to its end, was made longer and then stopped, say."""
    with Journal(run) as journal:
        journal.finish(journal.begin())
    assert ARM.is_finished(run, 0, 80.0)
    with Journal(run) as journal:
        journal.begin()
    assert not ARM.is_finished(run, 0, 80.0)
