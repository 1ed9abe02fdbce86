import numpy as np
import pytest

from caterpillar_env.robot import Outcomes
from caterpillar_env.task import Failure
from evolution.run.evaluators import LocalEvaluator, Result


class Invented(LocalEvaluator):
    """An evaluator that makes up a deterministic outcome for each genome instead of simulating it."""

    def map(self, encoding, jobs, on_progress=None):
        for job in jobs:
            stance, reach, effort = job.genomes[:, -3:].T
            failed = stance < 0.2
            failure = np.where(failed, Failure.TIPPED, Failure.NONE).astype(np.int8)
            simulated_s = np.where(failed, 7.0, 30.0)
            yield Result(Outcomes(failure, 0.1 * reach - 0.01, 1.0 + effort, simulated_s), None)


@pytest.fixture(scope="session")
def invented():
    """For tests of the optimizer, the record and the order of events, without simulations."""
    return Invented()
