"""Outcomes do not depend on where genomes are evaluated."""

import numpy as np
import pytest

from caterpillar_env.errors import CaterpillarError
from caterpillar_env.physics import Physics
from caterpillar_env.robot import Outcomes
from evolution.genome import Encoding
from evolution.run.evaluators import Job, LocalEvaluator, evaluate

ENCODING = Encoding(Physics(num_segments=2, timestep_s=0.01), gait_period_s=2.0)
GENOMES = np.random.default_rng(0).random((12, 12))
JOBS = [Job(GENOMES[:5]), Job(GENOMES[5:6]), Job(GENOMES[6:])]


@pytest.fixture(scope="module")
def reference():
    return evaluate(GENOMES, ENCODING, threads=1)


@pytest.mark.parametrize("threads", [1, 2, 4])
def test_outcomes_do_not_depend_on_threads_and_chunks(reference, threads):
    with LocalEvaluator(threads) as evaluator:
        joined = Outcomes.join(result.outcomes for result in evaluator.map(ENCODING, JOBS))
    np.testing.assert_equal(joined, reference)


def test_progress_runs_to_the_end_of_each_chunk():
    shares = []
    with LocalEvaluator(1) as evaluator:
        for _ in evaluator.map(ENCODING, JOBS[:2], shares.append):
            assert shares[-1] == pytest.approx(1.0)
    assert shares == 2 * sorted(set(shares)), "each chunk is reported in increasing steps"
    assert len(set(shares)) >= 10


def test_genomes_of_another_robot_are_refused():
    with pytest.raises(CaterpillarError, match=r"\(P, 12\)"):
        evaluate(np.zeros((1, 20)), ENCODING)
