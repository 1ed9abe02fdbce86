"""stable-baselines3 trains on both environments without warnings (which are errors here)."""

import gymnasium
import numpy as np
import pytest
from stable_baselines3 import PPO
from stable_baselines3.common.env_checker import check_env

import caterpillar_env  # noqa: F401

IDS = ("CaterpillarSMA-v0", "CaterpillarSMASwitch-v0")


@pytest.mark.parametrize("name", IDS)
def test_environment_passes_the_checker(name):
    env = gymnasium.make(name)
    check_env(env)
    env.close()


def test_ppo_updates_and_predicts():
    env = gymnasium.make("CaterpillarSMASwitch-v0", physics={"num_segments": 2})
    model = PPO("MlpPolicy", env, n_steps=64, batch_size=32, n_epochs=1, seed=0, device="cpu")
    before = model.policy.state_dict()["action_net.weight"].clone()
    model.learn(128)
    assert not np.array_equal(before, model.policy.state_dict()["action_net.weight"])
    action, _ = model.predict(env.reset(seed=0)[0], deterministic=True)
    assert action in env.action_space
    env.close()


@pytest.mark.slow
@pytest.mark.parametrize(("name", "steps"), [(IDS[0], 100), (IDS[1], 900)])
def test_ppo_trains_for_many_episodes(name, steps):
    env = gymnasium.make(name, physics={"num_segments": 2, "timestep_s": 0.01})
    PPO("MlpPolicy", env, n_steps=100, batch_size=50, seed=0, device="cpu").learn(steps)
    env.close()
