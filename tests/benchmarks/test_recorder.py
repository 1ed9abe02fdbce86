"""The recorder repeats the steps of the simulation exactly."""

import numpy as np
import pytest

from benchmarks.recorder import record_calls
from caterpillar_env import Morphology, Physics
from caterpillar_env.task import Crawl, FailureLimits


@pytest.fixture(scope="module")
def recording():
    """Engine calls, final state and steps of three robots. A strict threshold stops some of them."""
    rng = np.random.default_rng(0)
    bodies = [Morphology(), Morphology(segment_mass_kg=0.012), Morphology()]
    crawl = Crawl(bodies, Physics(), 1, limits=FailureLimits(veered_lateral_m=1e-4))
    power = rng.integers(0, 2, (2, 3, 100, 12)).astype(float)
    calls = record_calls(crawl.simulation, lambda number: crawl.run(power[number]), 2)
    end = np.stack([crawl.simulation.qpos(row) for row in range(3)])
    return calls, end, round(float(crawl.progress().time_s.sum()) / 0.0025)


def test_the_bare_engine_makes_the_same_steps(recording):
    calls, end, steps = recording
    assert calls.physics_steps == steps
    assert steps < 3 * 800  # a robot was stopped
    batch = calls.make_batch(threads=1)
    calls.repeat(batch, 0)
    calls.repeat(batch, 1)
    np.testing.assert_array_equal(batch.qpos, end)


def test_resets_are_repeated_too():
    crawl = Crawl([Morphology()] * 2, Physics(), 1)
    power = np.random.default_rng(0).integers(0, 2, (2, 50, 12)).astype(float)

    def step(_):
        crawl.run(power)
        crawl.reset([Morphology()], np.array([1]))
        crawl.run(power)

    calls = record_calls(crawl.simulation, step, 1)
    batch = calls.make_batch(threads=1)
    calls.repeat(batch, 0)
    np.testing.assert_array_equal(batch.qpos, [crawl.simulation.qpos(row) for row in range(2)])
