"""Policies before they learn."""

import numpy as np
import pytest
from sb3_contrib import ARS, TQC
from stable_baselines3 import A2C, PPO, SAC

from baselines.callbacks import InitialDuty
from baselines.vec_env import CaterpillarVecEnv

SMALL = {"physics": {"num_segments": 2, "timestep_s": 0.01}}


def started(kind, env_id, policy, **settings):
    env = CaterpillarVecEnv(env_id, 1, threads=1, **SMALL)
    model = kind(policy, env, seed=0, device="cpu", **settings)
    callback = InitialDuty(0.2)
    callback.init_callback(model)
    callback.on_training_start({}, {})
    return model, env


@pytest.mark.parametrize("kind", [PPO, A2C])
def test_switches_are_on_for_that_share_of_the_time(kind):
    model, env = started(kind, "CaterpillarSMASwitch-v0", "MlpPolicy")
    seen = np.repeat(env.reset(), 4000, axis=0)
    drawn, _ = model.predict(seen, deterministic=False)
    assert drawn.mean() == pytest.approx(0.2, abs=0.02)


@pytest.mark.parametrize(
    ("kind", "policy", "settings"),
    [
        (PPO, "MlpPolicy", {}),
        (SAC, "MlpPolicy", {}),
        (TQC, "MlpPolicy", {}),
        (ARS, "LinearPolicy", {"policy_kwargs": {"with_bias": True}}),
    ],
    ids=lambda v: getattr(v, "__name__", ""),
)
def test_timings_power_a_pair_for_that_share_of_the_period(kind, policy, settings):
    model, env = started(kind, "CaterpillarSMA-v0", policy, **settings)
    action, _ = model.predict(env.reset(), deterministic=True)
    on, off = action.reshape(-1, 2).T
    np.testing.assert_allclose((off - on) / 2, 0.2, atol=0.15 if kind in (SAC, TQC) else 0.02)


def test_ars_searches_about_it():
    model, _ = started(ARS, "CaterpillarSMA-v0", "LinearPolicy", policy_kwargs={"with_bias": True})
    assert set(np.round(model.weights.numpy()[-4:], 6)) == {np.float32(-0.2), np.float32(0.2)}


def test_a_policy_that_has_learned_is_left_alone():
    model, _ = started(A2C, "CaterpillarSMASwitch-v0", "MlpPolicy")
    model.num_timesteps = 1
    callback = InitialDuty(0.5)
    callback.init_callback(model)
    callback.on_training_start({}, {})
    np.testing.assert_allclose(model.policy.action_net.bias.detach(), np.log(0.25), rtol=1e-6)


@pytest.mark.parametrize("duty", [0.0, 1.0, -1])
def test_duty_is_a_share(duty):
    with pytest.raises(ValueError, match="must lie between 0 and 1"):
        InitialDuty(duty)
