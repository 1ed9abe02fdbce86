"""Runs that are killed repeatedly have the same result as uninterrupted runs.

The environment variable CATERPILLAR_KILLS is the number of times that each run is killed.
"""

import os
import signal
import subprocess
import sys
import time
from functools import cache

import numpy as np
import pytest

from evolution.run.history import load

RUN = """
import sys
from pathlib import Path
import evolution.run.evaluators as evaluators
import evolution.run.loop as run
from caterpillar_env.physics import Physics
from evolution.run.evaluators import LocalEvaluator
from evolution.optimizers.cma_es import CmaConfig
from evolution.optimizers.ga import GaConfig
from evolution.optimizers.shade import ShadeConfig

folder, kind, generations = Path(sys.argv[1]), sys.argv[2], int(sys.argv[3])
target_m = float(sys.argv[4]) if sys.argv[4:] else None
evaluators.CHUNK = 4
config = run.RunConfig(
    seed=3, generations=generations, optimizer="ga" if kind == "racing" else kind,
    physics=Physics(num_segments=2, timestep_s=0.01), cma=CmaConfig(cma_population=8),
    ga=GaConfig(population=10, hall_of_fame=2), shade=ShadeConfig(shade_population=8),
    race_share=0.5 if kind == "racing" else 1.0, target_m=target_m,
)

class Logged(LocalEvaluator):
    def map(self, encoding, jobs, on_progress=None):
        for job in jobs:
            with (folder.parent / f"{folder.name}.log").open("a") as log:
                print(len(job.genomes), file=log)
            yield from super().map(encoding, [job], on_progress)

begun = (folder / "journal.sqlite").exists()
if begun:
    run.resume(folder, evaluator=Logged(1))
else:
    run.evolve(config, folder, evaluator=Logged(1))
"""


KILLS = int(os.environ.get("CATERPILLAR_KILLS", "3"))
GENERATIONS = 2 * KILLS
#: Largest number of genomes that a kill loses: a chunk of four, or a generation of ten and its leaders.
LOST = {"ga": 4, "cma-es": 4, "shade": 4, "random": 4, "racing": 15}


def process(folder, kind, *target_m):
    arguments = [folder, kind, GENERATIONS, *target_m]
    return subprocess.Popen([sys.executable, "-c", RUN, *map(str, arguments)])


def evaluated(folder):
    """Number of genomes whose evaluation was started, over all processes."""
    log = folder.with_name(f"{folder.name}.log")
    return sum(int(line) for line in log.read_text().split()) if log.exists() else 0


@pytest.fixture(scope="module")
def uninterrupted(tmp_path_factory):
    """Return a function from the kind of a run to the folder of an uninterrupted run."""

    @cache
    def run(kind):
        folder = tmp_path_factory.mktemp("uninterrupted") / "whole"
        assert process(folder, kind).wait() == 0
        return folder

    return run


@pytest.mark.slow
@pytest.mark.parametrize("kind", LOST)
def test_run_killed_at_random_times_equals_an_uninterrupted_run(uninterrupted, tmp_path, kind):
    whole, broken = uninterrupted(kind), tmp_path / "broken"
    rng = np.random.default_rng(0)
    for kill in range(KILLS):
        before = evaluated(broken)
        worker = process(broken, kind)
        # Kill after one or two more chunks have started, at a random time in the last of them. Every
        # fifth kill comes at a random time after the process starts, with or without a journal.
        early = kill % 5 == 4
        begun = before + LOST[kind] * int(rng.integers(1, 3))
        while not early and evaluated(broken) < begun and worker.poll() is None:
            time.sleep(0.005)
        time.sleep(float(rng.uniform(0.0, 3.0 if early else 0.15)))
        assert worker.poll() is None, "the run was over before the last kill"
        os.kill(worker.pid, signal.SIGKILL)
        worker.wait()
    assert process(broken, kind).wait() == 0

    assert load(broken).table().drop("session").equals(load(whole).table().drop("session"))
    assert (broken / "best.json").read_bytes() == (whole / "best.json").read_bytes()
    assert load(broken).table()["session"].n_unique() > 1
    # Only the genomes in flight at each kill are evaluated twice.
    assert evaluated(broken) <= evaluated(whole) + LOST[kind] * KILLS
    assert not list(broken.glob(".*.partial"))


#: A shell's background jobs ignore Ctrl-C, and so would the processes that this test starts.
MAIN = """
import signal, sys
signal.signal(signal.SIGINT, signal.default_int_handler)
from evolution.cli import main
sys.exit(main())
"""


@pytest.mark.slow
def test_ctrl_c_ends_a_run_on_ray_within_seconds_and_prints_how_to_resume(tmp_path):
    pytest.importorskip("ray")
    folder = tmp_path / "run"
    command = [
        sys.executable, "-c", MAIN, "evolve", "--out", str(folder), "--no-video",
        "--evaluator", "ray",
    ]  # fmt: skip
    # A new session, as in a terminal: the signal also goes to the processes that the run started.
    worker = subprocess.Popen(command, stderr=subprocess.PIPE, text=True, start_new_session=True)
    while not (folder / "journal.sqlite").exists():
        time.sleep(0.05)
    time.sleep(3.0)
    started = time.monotonic()
    os.killpg(worker.pid, signal.SIGINT)
    output = worker.communicate(timeout=60)[1]
    assert worker.returncode == 130
    assert time.monotonic() - started < 15  # 1 s on an idle machine
    assert f"stopped; continue with: caterpillar resume {folder}" in output
    assert "Traceback" not in output
