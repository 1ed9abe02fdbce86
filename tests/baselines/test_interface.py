"""The observations of a policy, and the meaning of its actions."""

import gymnasium
import numpy as np
import pytest
import yaml
from stable_baselines3.common.vec_env import DummyVecEnv

from baselines.config import HYPERPARAMETERS
from baselines.interface import Interface, best_wave
from baselines.vec_env import CaterpillarVecEnv
from caterpillar_env import Morphology, Physics, simulate
from caterpillar_env.errors import CaterpillarError
from caterpillar_env.gait import MAX_DUTY

IDS = {"timing": "CaterpillarSMA-v0", "phase": "CaterpillarSMA-v0", "switch": "CaterpillarSMASwitch-v0"}


def wrap(mode="phase", robots=2, physics=None, action_repeat=1, **settings):
    env = CaterpillarVecEnv(
        IDS[mode], robots, threads=1, action_mode=mode, physics=physics, action_repeat=action_repeat
    )
    return Interface(env, mode=mode, action_repeat=action_repeat, **settings)


def crawl_m(wave):
    """Distance of the nominal body with a gait."""
    return simulate([Morphology()], wave[None], Physics()).distance_m[0]


def test_best_wave_is_at_the_peak_of_the_prior():
    """K_4 peaks at a duty of a fifth, K_5 for a wave from the tail."""
    gait, action, circular = best_wave(Physics(), "phase")
    delay, duty = (action[0::2] + 1) / 2, MAX_DUTY * (action[1::2] + 1) / 2
    assert delay == pytest.approx([0, 0.5, 0.7, 0.5, 0.7, 0.5])
    assert duty == pytest.approx(np.full(6, 0.21), abs=0.01)
    assert circular.tolist() == [True, False] * 6
    assert 0.1 < crawl_m(gait) < 0.2  # the wave designed by hand makes 0.177 m


@pytest.mark.parametrize("mode", ["timing", "phase"])
def test_action_of_zeros_makes_the_best_wave(mode):
    interface = wrap(mode, robots=1)
    interface.reset()
    for _ in range(6):
        _, _, dones, infos = interface.step(np.zeros((1, 12), dtype=np.float32))
    assert dones.all()
    expected_m = crawl_m(best_wave(Physics(), mode).gait)
    # Actions are of single precision, and stick-slip amplifies their rounding.
    assert infos[0]["distance"] == pytest.approx(expected_m, abs=0.002)


def test_action_moves_values_by_the_reach():
    interface = wrap(reach=0.1)
    centre = best_wave(Physics(), "phase").action
    actions = np.stack([np.ones(12), np.eye(12)[3]])
    moved = interface.act(actions, interface.reset())
    np.testing.assert_allclose(moved[1] - centre, 0.2 * np.eye(12)[3], atol=1e-12)
    np.testing.assert_allclose(moved[0] - centre, np.full(12, 0.2), atol=1e-12)


def test_delays_and_times_are_circular_but_duties_are_not():
    back = -np.ones((1, 12))
    interface = wrap(reach=0.3)
    centre = best_wave(Physics(), "phase").action
    moved = interface.act(back, interface.reset())[0]
    assert moved[0] == pytest.approx(0.4)  # a delay of -0.3 wraps around to 0.7
    assert centre[1] - 0.6 < -1 == moved[1]
    timing = wrap("timing", reach=0.3)
    centre = best_wave(Physics(), "timing").action
    moved = timing.act(back, timing.reset())[0]
    np.testing.assert_allclose(np.cos(np.pi * (moved - centre + 0.6)), 1.0)
    assert (np.abs(moved) <= 1).all()


def test_flips_change_the_switches_of_the_wave():
    interface = wrap("switch", robots=1, action_repeat=5)
    wave = best_wave(Physics(), "switch").gait
    interface.reset()
    seen = []
    for step in range(10):  # one period
        expected = (((step + 0.5) * 0.5 - wave.on_s) % 5.0 < (wave.off_s - wave.on_s) % 5.0).astype(int)
        observed = interface._observations
        np.testing.assert_array_equal(interface.act(np.zeros((1, 12), int), observed)[0], expected)
        np.testing.assert_array_equal(interface.act(np.ones((1, 12), int), observed)[0], 1 - expected)
        interface.step(np.zeros((1, 12), int))
        seen.append(expected)
    np.testing.assert_allclose(np.mean(seen, axis=0), 0.2, atol=0.1)


@pytest.mark.parametrize("mode", ["timing", "phase", "switch"])
def test_actions_are_passed_through_without_the_prior(mode):
    interface = wrap(mode, prior="uniform")
    actions = np.array([interface.action_space.sample() for _ in range(2)])
    assert interface.act(actions, interface.reset()) is actions


def test_policy_observes_the_chosen_entries():
    physics = Physics(num_segments=2, timestep_s=0.01)
    interface = wrap("switch", physics=physics, prior="uniform", observe=["fraction", "phase"])
    first = interface.reset()
    assert first.shape == (2, 6)
    assert interface.observation_space.shape == (6,)
    np.testing.assert_array_equal(first, [[0, 0, 0, 0, 1, 0]] * 2)  # cold, at the start of a period
    dones = np.zeros(2, dtype=bool)
    while not dones.all():
        observed, _, dones, infos = interface.step(np.zeros((2, 4), int))
    assert all(info["terminal_observation"].shape == (6,) for info in infos)
    np.testing.assert_array_equal(observed, first)


@pytest.mark.parametrize("path", sorted(HYPERPARAMETERS.glob("*.yml")), ids=lambda path: path.stem)
def test_hyperparameter_files_wrap_single_environments_like_rl_zoo3(path):
    for env_id, found in yaml.safe_load(path.read_text()).items():
        (entry,) = found["vec_env_wrapper"]
        ((name, arguments),) = entry.items()
        assert name == f"{Interface.__module__}.{Interface.__name__}"
        settings = found.get("env_kwargs", {})
        envs = DummyVecEnv([lambda: gymnasium.make(env_id, **settings)])  # noqa: B023
        interface = Interface(envs, **arguments)
        observed = interface.reset()
        still = np.zeros((1, 12), dtype=int if "Switch" in env_id else np.float32)
        assert interface.act(still, observed).any()  # the wave of the prior
        assert interface.step(still)[0].shape == observed.shape


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"observe": ["mood"]}, "observe has mood; choose from position, velocity"),
        ({"observe": []}, "observe is empty"),
        ({"reach": 0.6}, "reach = 0.6 must be"),
    ],
    ids=str,
)
def test_invalid_settings_are_rejected(settings, message):
    with pytest.raises(CaterpillarError, match=message):
        wrap(prior="uniform", **settings)


@pytest.mark.parametrize(
    ("settings", "interface", "message"),
    [
        ({"symmetric": False}, {"mode": "timing"}, "symmetric = True .* got False"),
        ({"gait_period_s": 2.0}, {"mode": "timing"}, "gait_period_s = 5.0 .* got 2.0"),
        ({"action_mode": "phase"}, {"mode": "timing"}, "action_mode = 'timing' .* got 'phase'"),
        ({}, {"mode": "phase", "prior": "uniform"}, "action_mode = 'phase' .* got 'timing'"),
        (
            {"action_mode": "switch"},
            {"mode": "switch", "action_repeat": 5},
            "action_repeat = 5 .* got 1",
        ),
        ({}, {"mode": "timing", "prior": "body"}, "prior = 'body' must be one of uniform, gait"),
    ],
    ids=str,
)
def test_robots_with_other_settings_are_rejected(settings, interface, message):
    env = CaterpillarVecEnv("CaterpillarSMA-v0", 1, threads=1, **settings)
    with pytest.raises(CaterpillarError, match=message):
        Interface(env, **interface)


def test_gait_of_the_prior_has_as_many_pairs_as_the_robot():
    gait, action, _ = best_wave(Physics(num_segments=2), "timing")
    assert gait.on_s.shape == (4,)  # springs
    assert action.shape == (4,)  # on and off times of two pairs
