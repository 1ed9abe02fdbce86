"""The initial duty of untrained policies."""

import numpy as np
import pytest
from sb3_contrib import ARS, TQC
from stable_baselines3 import A2C, PPO, SAC

from baselines.callbacks import InitialDuty
from baselines.vec_env import CaterpillarVecEnv

SMALL = {"physics": {"num_segments": 2, "timestep_s": 0.01}}


def start(kind, env_id, policy, **settings):
    env = CaterpillarVecEnv(env_id, 1, threads=1, **SMALL)
    model = kind(policy, env, seed=0, device="cpu", **settings)
    callback = InitialDuty(0.2)
    callback.init_callback(model)
    callback.on_training_start({}, {})
    return model, env


@pytest.mark.parametrize("kind", [PPO, A2C])
def test_switches_are_on_for_the_duty(kind):
    model, env = start(kind, "CaterpillarSMASwitch-v0", "MlpPolicy")
    seen = np.repeat(env.reset(), 4000, axis=0)
    switches, _ = model.predict(seen, deterministic=False)
    assert switches.mean() == pytest.approx(0.2, abs=0.02)


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
def test_timings_power_a_pair_for_the_duty(kind, policy, settings):
    model, env = start(kind, "CaterpillarSMA-v0", policy, **settings)
    action, _ = model.predict(env.reset(), deterministic=True)
    on, off = action.reshape(-1, 2).T
    np.testing.assert_allclose((off - on) / 2, 0.2, atol=0.15 if kind in (SAC, TQC) else 0.02)


def test_ars_searches_around_it():
    model, _ = start(ARS, "CaterpillarSMA-v0", "LinearPolicy", policy_kwargs={"with_bias": True})
    assert set(np.round(model.weights.numpy()[-4:], 6)) == {np.float32(-0.2), np.float32(0.2)}


def test_trained_policy_is_not_changed():
    model, _ = start(A2C, "CaterpillarSMASwitch-v0", "MlpPolicy")
    model.num_timesteps = 1
    callback = InitialDuty(0.5)
    callback.init_callback(model)
    callback.on_training_start({}, {})
    np.testing.assert_allclose(model.policy.action_net.bias.detach(), np.log(0.25), rtol=1e-6)


@pytest.mark.parametrize("duty", [0.0, 1.0, -1])
def test_duty_outside_0_to_1_is_rejected(duty):
    with pytest.raises(ValueError, match="must be between 0 and 1"):
        InitialDuty(duty)
