"""The contract of stable-baselines3's `VecEnv`; each row behaves like the single environment."""

import gymnasium
import numpy as np
import pytest
from stable_baselines3.common.vec_env import VecMonitor, VecNormalize

from baselines.vec_env import EPISODE_INFO, CaterpillarVecEnv
from caterpillar_env.morphology import Morphology
from caterpillar_env.task import Failure

SMALL = {"num_segments": 2, "timestep_s": 0.01}
ID = "CaterpillarSMASwitch-v0"
ROWS = 3


def switches(space, count, seed=0):
    return np.random.default_rng(seed).integers(0, 2, (count, ROWS, *space.shape)).astype(space.dtype)


@pytest.fixture
def env():
    made = CaterpillarVecEnv(ID, ROWS, physics=SMALL, episode_s=1.0)
    yield made
    made.close()


def test_rows_equal_single_environments_with_consecutive_seeds(env):
    env.seed(5)
    ours = env.reset()
    actions = switches(env.action_space, 10)
    singles = [gymnasium.make(ID, physics=SMALL, episode_s=1.0) for _ in range(ROWS)]
    theirs = np.stack([single.reset(seed=5 + row)[0] for row, single in enumerate(singles)])
    np.testing.assert_array_equal(ours, theirs)
    for number in range(10):
        ours, rewards, dones, infos = env.step(actions[number])
        for row, single in enumerate(singles):
            seen, reward, terminated, truncated, info = single.step(actions[number, row])
            assert rewards[row] == np.float32(reward)
            assert dones[row] == (terminated or truncated)
            if dones[row]:
                np.testing.assert_array_equal(infos[row]["terminal_observation"], seen)
                assert infos[row]["TimeLimit.truncated"] is truncated
                assert infos[row]["distance"] == info["distance"]
            else:
                np.testing.assert_array_equal(ours[row], seen)
                assert infos[row] == {}
    assert dones.all()


def test_row_resets_within_the_step_that_ends_its_episode(env):
    first = env.reset()
    for actions in switches(env.action_space, 10):
        observations, _, dones, infos = env.step(actions)
    assert dones.all()
    np.testing.assert_array_equal(observations, first)
    assert all(
        set(info) == {*EPISODE_INFO, "terminal_observation", "TimeLimit.truncated"} for info in infos
    )
    observations, _, dones, _ = env.step(actions)
    assert not dones.any()


def test_failure_is_not_a_truncation():
    rng = np.random.default_rng(0)
    bodies = [Morphology.from_unit(rng.random(8)) for _ in range(8)]
    env = CaterpillarVecEnv("CaterpillarSMA-v0", 8, morphology=bodies, physics={"timestep_s": 0.01})
    env.seed(0)
    env.reset()
    seen = []
    for _ in range(8):
        _, _, dones, infos = env.step(rng.uniform(-1, 1, (8, *env.action_space.shape)))
        seen += [
            (i["failure"], i["TimeLimit.truncated"]) for i, d in zip(infos, dones, strict=True) if d
        ]
    env.close()
    assert {truncated for failure, truncated in seen if failure == Failure.NONE} == {True}
    assert {truncated for failure, truncated in seen if failure != Failure.NONE} == {False}


def test_simulated_seconds_of_all_rows_are_counted(env):
    env.reset()
    for actions in switches(env.action_space, 7):
        env.step(actions)
    assert env.vector_env.crawl.simulation.simulated_s == pytest.approx(ROWS * 0.7)


def test_reset_applies_the_body_in_the_options(env):
    env.reset()
    body = dict.fromkeys(("leg_separation_m",), 0.02)
    env.set_options({"morphology": {**Morphology().to_dict(), **body}})
    env.reset()
    assert {m.leg_separation_m for m in env.vector_env.crawl.simulation.bodies} == {0.02}


def test_options_hold_for_one_reset(env):
    first, second = Morphology(), Morphology(leg_separation_m=0.02)
    env.set_options({"morphology": first})
    env.reset()
    env.vector_env.reset(options={"morphology": second})
    env.reset()
    assert env.vector_env.crawl.simulation.bodies == [second] * ROWS


def test_attributes_are_shared_by_all_rows(env):
    assert env.get_attr("render_mode") == [None] * ROWS
    assert len(env.get_attr("observation_names", indices=[0, 2])) == 2
    assert env.env_is_wrapped(gymnasium.wrappers.TimeLimit) == [False] * ROWS
    with pytest.raises(NotImplementedError, match=r"set vector_env\.render_mode"):
        env.set_attr("render_mode", "rgb_array", indices=1)


def test_monitor_and_normalization_wrappers_work(env):
    wrapped = VecNormalize(VecMonitor(env), gamma=0.99)
    wrapped.reset()
    for actions in switches(env.action_space, 10):
        observations, _, dones, infos = wrapped.step(actions)
    assert dones.all()
    assert [info["episode"]["l"] for info in infos] == [10] * ROWS
    assert np.isfinite(observations).all()


def test_each_row_has_an_image():
    env = CaterpillarVecEnv(ID, 2, physics=SMALL, render_mode="rgb_array", width=64, height=48)
    env.reset()
    assert [frame.shape for frame in env.get_images()] == [(48, 64, 3)] * 2
    env.close()


def test_options_that_differ_between_rows_are_rejected(env):
    env.set_options([{}, {"morphology": None}, {}])
    with pytest.raises(ValueError, match="must be the same for all environments"):
        env.reset()
