"""Evaluation on a real Ray cluster of two nodes, and what happens when parts of it are lost."""

import os
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path
from typing import ClassVar

import numpy as np
import pytest

from caterpillar_env.errors import CaterpillarError
from caterpillar_env.physics import Physics
from caterpillar_env.robot import Outcomes
from evolution.config import RunConfig
from evolution.genome import Encoding
from evolution.optimizers.ga import GaConfig
from evolution.run import cluster as module
from evolution.run.cluster import ClusterError, RayEvaluator, chunk_sizes
from evolution.run.evaluators import CHUNK, Job, evaluate
from evolution.run.history import load
from evolution.run.loop import evolve, resume

ENCODING = Encoding(Physics(num_segments=2, timestep_s=0.01), gait_period_s=2.0)
GENOMES = np.random.default_rng(0).random((12, 12))
JOBS = [Job(GENOMES[:5]), Job(GENOMES[5:6]), Job(GENOMES[6:])]


# Chunks


def duration(sizes, workers):
    """Time until all workers end, if a genome takes 1 and each free worker takes the next chunk."""
    ends = np.zeros(workers)
    for size in sizes:
        ends[ends.argmin()] += size
    return ends.max()


@pytest.mark.parametrize("workers", [1, 2, 16, 64, 100, 190, 1000])
def test_chunks_keep_all_workers_busy(workers):
    sizes = chunk_sizes(190, workers)
    assert sum(sizes) == 190
    assert len(sizes) >= min(workers, 190)
    assert max(sizes) <= CHUNK
    assert sizes == sorted(sizes, reverse=True)
    assert duration(sizes, workers) == np.ceil(190 / workers)


def test_chunks_of_cheap_genomes_are_larger():
    assert chunk_sizes(190, 100, least=20) == [20] * 9 + [10]
    assert chunk_sizes(190, 100, least=1000) == [50, 50, 50, 40]
    assert chunk_sizes(0, 100) == []


def test_an_address_without_a_cluster_is_rejected():
    pytest.importorskip("ray")
    for address in ("127.0.0.1:1", "127.0.0.1:99999"):
        with pytest.raises(ClusterError, match=f"no Ray cluster at {address}"), RayEvaluator(address):
            pass
    with pytest.raises(ClusterError, match="not supported"), RayEvaluator("ray://127.0.0.1:10001"):
        pass


# A cluster


def needs_ray(test):
    """Mark a test as slow and allow Ray's own warnings."""
    return pytest.mark.slow(pytest.mark.filterwarnings("default")(test))


@pytest.fixture(scope="module")
def cluster():
    """A real cluster of two nodes with a core each; it notices a lost node after about two seconds."""
    ray = pytest.importorskip("ray")
    from ray.cluster_utils import Cluster

    checks = {f"health_check_{name}_ms": 500 for name in ("initial_delay", "period", "timeout")}
    nodes = Cluster(
        initialize_head=True, head_node_args={"num_cpus": 1, "include_dashboard": False,
        "_system_config": {**checks, "health_check_failure_threshold": 4}},
    )  # fmt: skip
    nodes.add_node(num_cpus=1)
    ray.init(
        nodes.address, log_to_driver=False, logging_level="ERROR",
        runtime_env={"env_vars": {"PYTHONPATH": os.pathsep.join(sys.path)}},
    )  # fmt: skip
    ray.cloudpickle.register_pickle_by_value(sys.modules[__name__])  # workers cannot import the tests
    yield nodes
    ray.shutdown()
    nodes.shutdown()


@pytest.fixture(scope="module")
def reference():
    return evaluate(GENOMES, ENCODING, threads=1)


@needs_ray
def test_two_nodes_give_the_same_bits_in_the_same_order(cluster, reference):
    with RayEvaluator() as evaluator:
        joined = Outcomes.join(result.outcomes for result in evaluator.map(ENCODING, JOBS))
        np.testing.assert_equal(joined, reference)
        assert evaluator._cluster.cores == 2
        assert len(evaluator.split(GENOMES)) > 2


@needs_ray
def test_an_exception_on_a_worker_is_raised(cluster):
    genomes = np.full((4, 12), 0.5)
    genomes[2, 0] = 7.0
    with RayEvaluator() as evaluator, pytest.raises(CaterpillarError, match="genes must lie in"):
        list(evaluator.map(ENCODING, [Job(genomes)]))


class KillsItsWorkers(Encoding):
    """An encoding that kills its worker process in the first `kills` calls of `decode`."""

    marks: ClassVar[Path]
    kills: ClassVar[int]

    def decode(self, genomes):
        evaluate(genomes[:1], ENCODING, threads=1)
        for number in range(self.kills):
            mark = self.marks / str(number)
            if not mark.exists():
                mark.write_text(str(os.getpid()))
                os.kill(os.getpid(), signal.SIGKILL)
        return super().decode(genomes)


@needs_ray
def test_chunk_of_a_killed_worker_is_evaluated_again(cluster, reference, tmp_path):
    KillsItsWorkers.marks, KillsItsWorkers.kills = tmp_path, 2
    with RayEvaluator() as evaluator:
        results = list(
            evaluator.map(KillsItsWorkers(ENCODING.physics, ENCODING.gait_period_s), [Job(GENOMES)] * 4)
        )
    killed = {path.read_text() for path in tmp_path.iterdir()}
    assert len(killed) == 2
    assert len(results) == 4
    for result in results:
        np.testing.assert_equal(result.outcomes, reference)


@needs_ray
def test_chunk_that_kills_all_its_workers_ends_the_run(cluster, tmp_path, monkeypatch):
    monkeypatch.setattr(module, "_RETRIES", 1)
    KillsItsWorkers.marks, KillsItsWorkers.kills = tmp_path, 100
    with (
        RayEvaluator() as evaluator,
        pytest.raises(
            CaterpillarError, match=r"task on the Ray cluster was lost \(WorkerCrashedError\)"
        ),
    ):
        list(evaluator.map(KillsItsWorkers(ENCODING.physics, ENCODING.gait_period_s), [Job(GENOMES)]))
    assert len(list(tmp_path.iterdir())) == 2


@needs_ray
def test_run_continues_after_a_node_is_lost(cluster, tmp_path):
    config = RunConfig(
        seed=3, generations=6, physics=Physics(num_segments=2), ga=GaConfig(population=12)
    )
    node = next(iter(cluster.worker_nodes))
    lost = threading.Timer(1.0, cluster.remove_node, [node], {"allow_graceful": False})
    lost.start()
    with RayEvaluator() as evaluator:
        history = evolve(config, tmp_path / "ray", evaluator=evaluator)
        assert not lost.is_alive(), "the run ended before the node was lost"
        for _ in range(60):  # the head may notice later
            if evaluator._cluster.cores == 1:
                break
            time.sleep(0.5)
        assert evaluator._cluster.cores == 1
    evolve(config, tmp_path / "local")
    assert history.table().equals(load(tmp_path / "local").table())
    assert history.finished


MAIN = """
import sys
from evolution.run import cluster
cluster.HEAD_TIMEOUT_S = 3.0
from evolution.cli import main
sys.exit(main())
"""


@needs_ray
@pytest.mark.parametrize(
    ("lost", "message"), [("gcs_server", "has not answered for"), ("raylet", "raylet, Ray's process")]
)
def test_run_ends_if_its_head_node_is_lost_and_can_be_resumed(tmp_path, lost, message):
    pytest.importorskip("ray")
    import psutil  # installed with Ray

    folder = tmp_path / "run"
    run = subprocess.Popen(
        [
            sys.executable, "-c", MAIN, "evolve", "--out", str(folder), "--evaluator", "ray",
            "--generations", "4", "--population", "6", "--num-segments", "2", "--no-video",
        ],
        stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True,
    )  # fmt: skip
    while not (folder / "journal.sqlite").exists():
        assert run.poll() is None
        time.sleep(0.05)
    time.sleep(1.0)  # the first tasks start
    started = psutil.Process(run.pid).children(recursive=True)
    (victim,) = [process for process in started if process.name() == lost]
    killed = time.monotonic()
    victim.kill()
    output = run.communicate(timeout=90)[0]
    assert run.returncode == 1, output
    assert time.monotonic() - killed < 60  # about 15 on an idle machine
    assert message in output
    assert "continue with `caterpillar resume`" in output
    assert "Traceback" not in output
    assert not psutil.wait_procs(started, timeout=2)[1]
    assert resume(folder).finished
    whole = evolve(load(folder).config, tmp_path / "whole")
    assert load(folder).table().drop("session").equals(whole.table().drop("session"))
