"""The cluster benchmark: its statistics of task times."""

import numpy as np
import pytest

from benchmarks import cluster
from benchmarks.cluster import Task

#: Two workers: one has a gap of 1 s, the other ends 3 s before the last task.
TASKS = [Task(0.0, 4.0, "a"), Task(5.0, 10.0, "a"), Task(0.0, 7.0, "b")]


def test_gaps_and_tail_of_a_generation():
    assert cluster.gaps_s(TASKS) == [1.0]
    assert cluster.tail_s(TASKS, 2) == pytest.approx(1.5)
    assert cluster.tail_s(TASKS, 3) == pytest.approx((3 + 10) / 3)  # the third worker had no task


def test_costs_of_robots_that_fail_are_smaller():
    costs_s = cluster.draw_costs_s(np.random.default_rng(0))
    assert len(costs_s) == cluster.GENOMES
    assert costs_s.max() == cluster.GENOME_S
    assert 0 < (costs_s < cluster.GENOME_S).mean() < 0.15


def test_size_of_a_generation_limits_the_utilization():
    assert cluster.schedule(1) == pytest.approx(1.0)
    assert cluster.schedule(2) > 0.99
    assert cluster.schedule(95) > cluster.schedule(128)
    assert cluster.schedule(380) < 0.5
