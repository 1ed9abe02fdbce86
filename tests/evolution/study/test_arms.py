"""Arms of a study: their settings and the runs that they recognize."""

import numpy as np
import pytest

from caterpillar_env.errors import CaterpillarError
from caterpillar_env.robot import Outcomes
from evolution.config import RunConfig
from evolution.run.history import History
from evolution.run.journal import Journal
from evolution.study.arms import EvolutionArm, make_arm, merge

ARM = EvolutionArm(RunConfig(prior="uniform"))


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    """A run of seed 3 with a budget of 80 s and two evaluations."""
    folder = tmp_path_factory.mktemp("arm")
    outcomes = Outcomes(np.zeros(2, dtype=np.int8), *np.array([[0.01, 0.03], [1.0, 1.0], [30.0, 30.0]]))
    with Journal.create(folder, ARM.run_config(3, 80.0).to_dict()) as journal:
        journal.begin()
        History(journal).append(np.tile([[0.1], [0.3]], 20), outcomes)
    return folder


def test_nested_tables_are_merged_and_other_values_replaced():
    base = {"a": 1, "b": {"c": 2, "d": [3]}}
    assert merge(base, {"b": {"d": [4]}, "e": 5}) == {"a": 1, "b": {"c": 2, "d": [4]}, "e": 5}
    assert base == {"a": 1, "b": {"c": 2, "d": [3]}}


def test_kind_of_an_arm_must_be_installed():
    assert make_arm("a", {"prior": "uniform"}, {}) == ARM
    with pytest.raises(CaterpillarError, match=r"arms\.a: kind = 'magic' must be one of evolution"):
        make_arm("a", {"kind": "magic"}, {})


def test_runs_of_an_arm_differ_in_their_seed_only():
    run = ARM.run_config(1, 240)
    assert (run.seed, run.budget_s, run.prior) == (1, 240, "uniform")


def test_recorded_run_matches_its_arm_seed_and_budget(run):
    history = History.read(run)
    assert ARM.matches(history, 3, 80.0)
    assert not ARM.matches(history, 4, 80.0)
    assert ARM.matches(history, 3, 90.0)  # a run can be extended
    assert not EvolutionArm(RunConfig()).matches(history, 3, 80.0)


def test_robot_of_an_evaluation(run):
    robot = ARM.robot(run, 1)
    assert robot.fitness_m == 0.03
    assert robot.morphology.to_unit() == pytest.approx([0.3] * 8)
