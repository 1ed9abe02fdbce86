"""The first actions of untrained policies."""

import numpy as np
import pytest
from stable_baselines3 import PPO, TD3

from baselines.callbacks import RareFlips, ZeroActions
from baselines.vec_env import CaterpillarVecEnv
from caterpillar_env.errors import CaterpillarError

SMALL = {"physics": {"num_segments": 2, "timestep_s": 0.01}}


def start(kind, env_id, callback, trained=False):
    env = CaterpillarVecEnv(env_id, 1, threads=1, **SMALL)
    model = kind("MlpPolicy", env, seed=0, device="cpu")
    model.num_timesteps = int(trained)
    callback.init_callback(model)
    callback.on_training_start({}, {})
    return model, env.reset()


def test_untrained_policy_flips_with_the_given_probability():
    model, observed = start(PPO, "CaterpillarSMASwitch-v0", RareFlips(0.2))
    flips, _ = model.predict(np.repeat(observed, 4000, axis=0), deterministic=False)
    assert flips.mean() == pytest.approx(0.2, abs=0.02)


@pytest.mark.parametrize("trained", [False, True])
def test_untrained_actor_of_td3_acts_with_zeros(trained):
    model, observed = start(TD3, "CaterpillarSMA-v0", ZeroActions(), trained)
    action, _ = model.predict(observed, deterministic=True)
    assert (action == 0).all() != trained
    target = model.actor_target(model.policy.obs_to_tensor(observed)[0])
    np.testing.assert_allclose(target.detach().numpy(), action, atol=1e-6)


def test_trained_policy_keeps_its_flips():
    model, _ = start(PPO, "CaterpillarSMASwitch-v0", RareFlips(0.2), trained=True)
    np.testing.assert_array_equal(model.policy.action_net.bias.detach(), 0.0)


@pytest.mark.parametrize("probability", [0.0, 1.0, -1])
def test_probability_outside_0_to_1_is_rejected(probability):
    with pytest.raises(CaterpillarError, match="must be between 0 and 1"):
        RareFlips(probability)
