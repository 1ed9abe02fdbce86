import numpy as np
import pytest

from caterpillar_env.physics import Physics
from caterpillar_env.robot import Outcomes
from caterpillar_env.task import Failure
from evolution.config import RunConfig
from evolution.optimizers.ga import GaConfig
from evolution.run.evaluators import LocalEvaluator, Result
from evolution.run.journal import FILE
from evolution.run.loop import evolve

CONFIG = RunConfig(
    seed=4, generations=2, physics=Physics(num_segments=2, timestep_s=0.01),
    ga=GaConfig(population=3, hall_of_fame=1),
)  # fmt: skip


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
