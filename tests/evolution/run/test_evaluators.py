"""Where genomes are evaluated makes no difference to what comes out."""

import os
import signal
import sys
from pathlib import Path
from typing import ClassVar

import numpy as np
import pytest

from caterpillar_env.errors import CaterpillarError
from caterpillar_env.physics import Physics
from caterpillar_env.robot import Outcomes
from evolution.genome import Encoding
from evolution.run.evaluators import Job, LocalEvaluator, RayEvaluator, evaluate

ENCODING = Encoding(Physics(num_segments=2, timestep_s=0.01), gait_period_s=2.0)
GENOMES = np.random.default_rng(0).random((12, 12))
JOBS = [Job(GENOMES[:5]), Job(GENOMES[5:6]), Job(GENOMES[6:])]


def joined(results):
    columns = zip(*(result.outcomes for result in results), strict=True)
    return Outcomes(*(np.concatenate(column) for column in columns))


def same(one, other):
    return all(np.array_equal(a, b) for a, b in zip(one, other, strict=True))


@pytest.fixture(scope="module")
def reference():
    return evaluate(GENOMES, ENCODING, threads=1)


@pytest.mark.parametrize("threads", [1, 2, 4])
def test_threads_and_chunks_do_not_matter(reference, threads):
    with LocalEvaluator(threads) as evaluator:
        assert same(joined(evaluator.map(ENCODING, JOBS)), reference)


def test_progress_runs_to_the_end_of_each_chunk():
    shares = []
    with LocalEvaluator(1) as evaluator:
        for _ in evaluator.map(ENCODING, JOBS[:2], shares.append):
            assert shares[-1] == pytest.approx(1.0)
    assert shares == 2 * sorted(set(shares)), "each chunk is reported in increasing steps"
    assert len(set(shares)) >= 10


# Ray


def needs_ray(test):
    """Slow, with Ray's own warnings let through."""
    return pytest.mark.slow(pytest.mark.filterwarnings("default")(test))


@pytest.fixture(scope="module")
def cluster():
    """A real cluster of two workers on this machine."""
    ray = pytest.importorskip("ray")
    ray.init(
        num_cpus=2, include_dashboard=False, log_to_driver=False, logging_level="ERROR",
        runtime_env={"env_vars": {"PYTHONPATH": os.pathsep.join(sys.path)}},
    )  # fmt: skip
    yield ray
    ray.shutdown()


@needs_ray
def test_ray_gives_the_same_bits_in_the_same_order(cluster, reference):
    with RayEvaluator() as evaluator:
        assert same(joined(evaluator.map(ENCODING, JOBS)), reference)


class KillsItsWorkers(Encoding):
    """An encoding whose first genomes kill the processes that they are evaluated in, on the way."""

    marks: ClassVar[Path]

    def decode(self, genomes):
        evaluate(genomes[:1], ENCODING, threads=1)
        for mark in (self.marks / "first", self.marks / "second"):
            if not mark.exists():
                mark.write_text(str(os.getpid()))
                os.kill(os.getpid(), signal.SIGKILL)
        return super().decode(genomes)


@needs_ray
def test_chunk_of_a_killed_worker_is_evaluated_again(cluster, reference, tmp_path):
    # By value: the workers cannot import the tests.
    cluster.cloudpickle.register_pickle_by_value(sys.modules[__name__])
    KillsItsWorkers.marks = tmp_path
    with RayEvaluator() as evaluator:
        results = list(
            evaluator.map(KillsItsWorkers(ENCODING.physics, ENCODING.gait_period_s), [Job(GENOMES)] * 4)
        )
    killed = {path.read_text() for path in tmp_path.iterdir()}
    assert len(killed) == 2
    assert len(results) == 4
    assert all(same(result.outcomes, reference) for result in results)


@needs_ray
def test_an_exception_on_a_worker_is_raised(cluster):
    genomes = np.full((4, 12), 0.5)
    genomes[2, 0] = 7.0
    with RayEvaluator() as evaluator, pytest.raises(CaterpillarError, match="genes must lie in"):
        list(evaluator.map(ENCODING, [Job(genomes)]))


def test_an_address_without_a_cluster_is_told():
    pytest.importorskip("ray")
    with (
        pytest.raises(CaterpillarError, match=r"no Ray cluster at 127\.0\.0\.1:1"),
        RayEvaluator("127.0.0.1:1"),
    ):
        pass
