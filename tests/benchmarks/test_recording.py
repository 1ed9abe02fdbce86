import numpy as np
import pytest

from benchmarks.recording import recorded
from caterpillar_env import Morphology, Physics
from caterpillar_env.task import Crawl, Thresholds


@pytest.fixture(scope="module")
def recording():
    """Three robots, one of which is stopped by a strict threshold of jumping, and what was asked for."""
    rng = np.random.default_rng(0)
    bodies = [Morphology(), Morphology(segment_mass_kg=0.012), Morphology()]
    crawl = Crawl(3, Physics(), 1, thresholds=Thresholds(veered_lateral_m=1e-4))
    crawl.reset(bodies)
    with recorded(crawl.simulation) as calls:
        crawl.run(rng.integers(0, 2, (3, 200, 12)).astype(float))
    end = np.stack([crawl.simulation.qpos(row) for row in range(3)])
    return calls, end, round(float(crawl.progress().time_s.sum()) / 0.005)


def test_the_limit_makes_the_very_steps_that_we_made(recording):
    calls, end, steps = recording
    assert calls.steps == steps
    assert steps < 3 * 400  # somebody was stopped
    batch = calls.batch(threads=1)
    calls.repeat(batch, 0, 7)
    calls.repeat(batch, 7)
    np.testing.assert_array_equal(batch.qpos, end)


def test_resets_are_repeated_too():
    crawl = Crawl(2, Physics(), 1)
    crawl.reset([Morphology()] * 2)
    power = np.random.default_rng(0).integers(0, 2, (2, 50, 12)).astype(float)
    with recorded(crawl.simulation) as calls:
        crawl.run(power)
        crawl.reset([Morphology()], np.array([1]))
        crawl.run(power)
    batch = calls.batch(threads=1)
    calls.repeat(batch)
    np.testing.assert_array_equal(batch.qpos, [crawl.simulation.qpos(row) for row in range(2)])
