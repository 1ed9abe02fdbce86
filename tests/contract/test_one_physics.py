"""One body and one gait give one trajectory, bit for bit, whichever way they are run."""

import gymnasium
import numpy as np
import pytest

import caterpillar_env  # noqa: F401  (registers the environments)
from caterpillar_env import GaitTimings, Physics
from caterpillar_env.robot import simulate
from evolution.genome import Encoding
from evolution.run.evaluators import evaluate

PERIOD_S = 2.0
DURATION_S = 4.0
ENCODING = Encoding(gait_period_s=PERIOD_S)
GENOMES = np.random.default_rng(5).random((3, len(ENCODING.genes)))
BODIES, _ = ENCODING.decode(GENOMES)
ACTIONS = (2 * GENOMES[:, 8:] - 1).astype(np.float32)
KWARGS = {"gait_period_s": PERIOD_S, "episode_s": DURATION_S}


def crawled(rows, threads=1, duration_s=DURATION_S):
    """Outcome of `simulate`, and the poses of each row after every thermal step."""
    traces = []
    timings = GaitTimings.from_action(ACTIONS[rows], PERIOD_S)
    bodies = [BODIES[r] for r in rows]
    outcome = simulate(
        bodies,
        timings,
        Physics(),
        threads=threads,
        duration_s=duration_s,
        on_interval=traces.append,
    )
    assert not outcome.failure.any()  # so that every interval holds every row
    return outcome, np.concatenate([t.qpos for t in traces], axis=1)


@pytest.fixture(scope="module")
def reference():
    """Outcome and poses of the three robots, simulated together."""
    return crawled([0, 1, 2])


def test_robots_move(reference):
    _, poses = reference
    assert poses.shape == (3, 400, 18)
    assert (np.ptp(poses[:, :, 7:], axis=1).max(axis=1) > 0.2).all()


@pytest.mark.parametrize("row", range(3))
def test_single_environment_repeats_the_fitness_run(reference, row):
    outcome, poses = reference
    env = gymnasium.make("CaterpillarSMA-v0", morphology=BODIES[row].to_dict(), **KWARGS)
    env.reset(seed=0)
    for step in (1, 2):
        *_, info = env.step(ACTIONS[row])
        pose = env.unwrapped.crawl.simulation.qpos(0)
        np.testing.assert_array_equal(pose, poses[row, 200 * step - 1])
    assert info["distance"] == outcome.distance_m[row]
    assert info["energy_j"] == pytest.approx(outcome.energy_j[row], rel=1e-12)


@pytest.mark.parametrize("threads", [1, 2])
def test_rows_of_the_vector_environment_repeat_the_fitness_run(reference, threads):
    outcome, poses = reference
    order = [2, 0, 1]  # in another order
    bodies = np.stack([BODIES[r].to_array() for r in order])
    envs = gymnasium.make_vec("CaterpillarSMA-v0", 3, morphology=bodies, threads=threads, **KWARGS)
    envs.reset(seed=0)
    for step in (1, 2):
        *_, info = envs.step(ACTIONS[order])
        for place, row in enumerate(order):
            pose = envs.unwrapped.crawl.simulation.qpos(place)
            np.testing.assert_array_equal(pose, poses[row, 200 * step - 1])
    np.testing.assert_array_equal(info["distance"], outcome.distance_m[order])


def test_switch_actions_reproduce_a_gait():
    """A gait whose times fall on control intervals is also a sequence of switch actions."""
    period_s = 3.2  # its sixteenths are exact in a float32 action
    timings = GaitTimings(
        period_s, np.array([0, 4, 16, 8, 20, 2]) * 0.1, np.array([8, 12, 4, 8, 6, 10]) * 0.1
    )
    timed = gymnasium.make("CaterpillarSMA-v0", gait_period_s=period_s)
    switched = gymnasium.make("CaterpillarSMASwitch-v0", gait_period_s=period_s)
    timed.reset(seed=0)
    switched.reset(seed=0)
    *_, one = timed.step(timings.to_action())
    power = timings.mirrored().power(0.1)
    np.testing.assert_allclose(power, np.round(power), atol=1e-9)
    for interval in np.round(power).astype(np.int8):
        *_, other = switched.step(interval)
    assert one["time_s"] == other["time_s"] == 3.2
    assert one["energy_j"] == pytest.approx(other["energy_j"], rel=1e-9)
    # Only the springs are compared: a share of 1 - 1e-16 instead of 1 changes a trajectory slightly.
    timed_end, switched_end = (e.unwrapped.crawl.simulation.state() for e in (timed, switched))
    assert timed_end.fraction.max() > 0.5
    np.testing.assert_allclose(timed_end.fraction, switched_end.fraction, atol=1e-9)
    np.testing.assert_allclose(timed_end.temperature_c, switched_end.temperature_c, atol=1e-9)


@pytest.mark.parametrize("row", range(3))
def test_results_do_not_depend_on_the_other_rows(reference, row):
    _, poses = reference
    alone_outcome, alone = crawled([row])
    np.testing.assert_array_equal(alone[0], poses[row])
    assert alone_outcome.distance_m[0] == reference[0].distance_m[row]


def test_results_do_not_depend_on_the_row_index(reference):
    _, poses = crawled([1, 2, 0, 1])
    np.testing.assert_array_equal(poses, reference[1][[1, 2, 0, 1]])


def test_results_do_not_depend_on_the_number_of_threads(reference):
    outcome, poses = crawled([0, 1, 2], threads=2)
    np.testing.assert_array_equal(poses, reference[1])
    for one, other in zip(outcome, reference[0], strict=True):
        np.testing.assert_array_equal(one, other)


def test_fitness_equals_the_distance_reported_by_the_environment():
    """Compare a full episode, from genome to fitness."""
    outcome = evaluate(GENOMES[:1], ENCODING, threads=1)
    env = gymnasium.make("CaterpillarSMA-v0", morphology=BODIES[0].to_dict(), gait_period_s=PERIOD_S)
    env.reset(seed=0)
    ended, total = False, 0.0
    while not ended:
        _, reward, terminated, truncated, info = env.step(ACTIONS[0])
        total += reward - info["reward_failure"]
        ended = terminated or truncated
    assert info["time_s"] == outcome.simulated_s[0]
    assert info["distance"] == outcome.distance_m[0]
    assert terminated == bool(outcome.failure[0])
    assert total == pytest.approx(100 * outcome.distance_m[0])
