"""What is measured is the very steps that we make."""

import numpy as np
import pytest

from benchmarks.engine import Speed, measure, recorded
from caterpillar_env import Morphology, Physics
from caterpillar_env.task import Crawl, Thresholds


@pytest.fixture(scope="module")
def recording():
    """Three robots, one of which is stopped by a strict threshold of jumping, and what was asked for."""
    rng = np.random.default_rng(0)
    bodies = [Morphology(), Morphology(segment_mass_kg=0.012), Morphology()]
    crawl = Crawl(bodies, Physics(), 1, thresholds=Thresholds(veered_lateral_m=1e-4))
    with recorded(crawl.simulation) as calls:
        crawl.run(rng.integers(0, 2, (3, 200, 12)).astype(float))
    end = np.stack([crawl.simulation.qpos(row) for row in range(3)])
    return calls, end, round(float(crawl.progress().time_s.sum()) / 0.0025)


def test_the_limit_makes_the_very_steps_that_we_made(recording):
    calls, end, steps = recording
    assert calls.steps == steps
    assert steps < 3 * 800  # somebody was stopped
    batch = calls.batch(threads=1)
    calls.repeat(batch, 0, 7)
    calls.repeat(batch, 7)
    np.testing.assert_array_equal(batch.qpos, end)


def test_resets_are_repeated_too():
    crawl = Crawl([Morphology()] * 2, Physics(), 1)
    power = np.random.default_rng(0).integers(0, 2, (2, 50, 12)).astype(float)
    with recorded(crawl.simulation) as calls:
        crawl.run(power)
        crawl.reset([Morphology()], np.array([1]))
        crawl.run(power)
    batch = calls.batch(threads=1)
    calls.repeat(batch)
    np.testing.assert_array_equal(batch.qpos, [crawl.simulation.qpos(row) for row in range(2)])


def test_a_trial_stops_at_its_time_and_tells_what_was_stepped():
    speed = measure(robots=2, limit_s=0.0, threads=1)
    assert speed.simulated_s == pytest.approx(0.2)  # one control interval
    assert speed.threads == 1
    assert min(speed.build_s, speed.crawl_s, speed.engine_s) > 0


def test_time_of_a_run_is_that_of_building_and_of_crawling():
    speed = Speed(robots=10, simulated_s=100.0, build_s=0.1, crawl_s=0.5, engine_s=0.4, threads=2)
    assert speed.simulated_s_per_s == 200.0
    assert speed.share_of_limit == 0.8
    assert speed.run_s(1000) == pytest.approx(1000 * 0.01 + 30_000 / 200)
