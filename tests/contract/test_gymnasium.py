"""The requirements of Gymnasium for every environment."""

import json
import subprocess
import sys

import gymnasium
import numpy as np
import pytest
from gymnasium.envs.registration import EnvSpec
from gymnasium.utils.env_checker import check_env

import caterpillar_env
from caterpillar_env import Failure, Morphology

IDS = ["CaterpillarSMA-v0", "CaterpillarSMASwitch-v0"]
SMALL = Morphology(segment_length_m=0.024, segment_radius_m=0.010)
QUICK = {"gait_period_s": 1.0, "action_repeat": 5}


def made(env_id, **kwargs):
    return gymnasium.make(env_id, **{**QUICK, **kwargs})


# Any warning is an error here: see pytest's settings.
@pytest.mark.parametrize("env_id", IDS)
@pytest.mark.parametrize(
    "kwargs",
    [
        {},
        {"action_mode": "phase", "symmetric": False},
        {"physics": {"num_segments": 3}},
        {"reset_noise_scale": 0.02, "ctrl_cost_weight": 0.1},
        {"terminate_on_failure": False, "morphology": SMALL.to_dict()},
    ],
    ids=["default", "single_springs", "three_segments", "noise", "body"],
)
def test_check_env_passes_without_warnings(env_id, kwargs):
    check_env(made(env_id, **kwargs).unwrapped, skip_render_check=True)


def test_check_env_passes_with_rendering():
    check_env(made(IDS[1], width=64, height=48).unwrapped)


def test_module_in_the_id_registers_the_environments():
    code = (
        "import gymnasium; env = gymnasium.make('caterpillar_env:CaterpillarSMA-v0');"
        "print(env.reset(seed=0)[0].shape[0])"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.stdout.strip() == "66", done.stderr


def test_importing_the_package_again_registers_nothing_twice():
    import importlib

    importlib.reload(caterpillar_env)  # Gymnasium would warn


@pytest.mark.parametrize("env_id", IDS)
def test_spec_round_trips_through_json(env_id):
    kwargs = {
        "morphology": SMALL.to_dict(),
        "physics": {"friction": 0.6, "spring": {"ambient_c": 20.0}},
        "reset_noise_scale": 0.01,
    }
    env = made(env_id, **kwargs)
    text = env.spec.to_json()
    json.loads(text)
    again = gymnasium.make(EnvSpec.from_json(text))
    assert again.unwrapped.morphology == SMALL
    observation, _ = env.reset(seed=3)
    np.testing.assert_array_equal(again.reset(seed=3)[0], observation)
    env.action_space.seed(0)
    action = env.action_space.sample()
    np.testing.assert_array_equal(again.step(action)[0], env.step(action)[0])


@pytest.mark.parametrize("env_id", IDS)
def test_make_vec_uses_the_native_vector_environment(env_id):
    envs = gymnasium.make_vec(env_id, 2, max_episode_steps=2, **QUICK)
    assert type(envs.unwrapped) is caterpillar_env.CaterpillarVectorEnv
    assert envs.num_envs == 2
    envs.reset(seed=0)
    nothing = np.zeros(envs.action_space.shape, envs.action_space.dtype)
    assert [envs.step(nothing)[3].tolist() for _ in range(2)] == [[False] * 2, [True] * 2]
    single = made(env_id)
    assert envs.single_observation_space == single.observation_space
    assert envs.single_action_space == single.action_space
    json.loads(envs.spec.to_json())


@pytest.mark.parametrize("env_id", IDS)
def test_gymnasium_sync_vector_env_agrees_with_the_native_one(env_id):
    native = gymnasium.make_vec(env_id, 2, reset_noise_scale=0.02, **QUICK)
    copies = gymnasium.make_vec(env_id, 2, vectorization_mode="sync", reset_noise_scale=0.02, **QUICK)
    native.action_space.seed(0)
    action = native.action_space.sample()
    one, other = native.reset(seed=4), copies.reset(seed=4)
    for _ in range(2):
        np.testing.assert_array_equal(one[0], other[0])
        assert set(one[-1]) == set(other[-1])
        one, other = native.step(action), copies.step(action)
    for mine, theirs in zip(one[:4], other[:4], strict=True):
        np.testing.assert_array_equal(mine, theirs)


@pytest.mark.parametrize("env_id", IDS)
def test_step_and_info_values_have_python_types(env_id):
    env = made(env_id).unwrapped
    observation, info = env.reset(seed=0)
    assert observation.dtype == np.float32
    _, reward, terminated, truncated, step_info = env.step(env.action_space.sample())
    assert type(reward) is float
    assert type(terminated) is bool
    assert type(truncated) is bool
    for key, value in {**info, **step_info}.items():
        assert type(value) is (Failure if key == "failure" else float), key
    json.dumps(step_info)


@pytest.mark.parametrize("env_id", IDS)
def test_step_returns_a_new_array(env_id):
    env = made(env_id).unwrapped
    first, _ = env.reset(seed=0)
    kept = first.copy()
    second, *_ = env.step(env.action_space.sample())
    np.testing.assert_array_equal(first, kept)
    assert not np.shares_memory(first, second)
    second[:] = 9.0
    np.testing.assert_array_equal(env.reset(seed=0)[0], kept)


@pytest.mark.parametrize("env_id", IDS)
def test_step_does_not_modify_the_action(env_id):
    env = made(env_id)
    env.reset(seed=0)
    action = env.action_space.sample()
    kept = action.copy()
    env.step(action)
    np.testing.assert_array_equal(action, kept)


@pytest.mark.parametrize("env_id", IDS)
def test_body_stays_through_the_autoreset_of_a_wrapper(env_id):
    env = gymnasium.wrappers.Autoreset(made(env_id, episode_s=1.0))
    small, _ = env.reset(seed=0, options={"morphology": SMALL})
    truncated = False
    while not truncated:
        *_, truncated, _ = env.step(env.action_space.sample())
    np.testing.assert_array_equal(env.step(env.action_space.sample())[0], small)


@pytest.mark.parametrize("env_id", IDS)
def test_seed_determines_the_noise(env_id):
    env = made(env_id, reset_noise_scale=0.02)
    first, _ = env.reset(seed=1)
    second, _ = env.reset()
    assert (first != second).any()
    np.testing.assert_array_equal(env.reset(seed=1)[0], first)
    np.testing.assert_array_equal(env.reset()[0], second)
    assert (env.reset(seed=2)[0] != first).any()


@pytest.mark.parametrize("env_id", IDS)
def test_no_entry_of_an_observation_is_constant(env_id):
    """Every entry differs between some robots or times."""
    rng = np.random.default_rng(0)
    bodies = [Morphology.from_unit(u) for u in rng.random((5, 8))]
    kwargs = {"gait_period_s": 1.5, "action_repeat": 7, "autoreset_mode": "SameStep", "threads": 1}
    envs = gymnasium.make_vec(env_id, 5, morphology=bodies, terminate_on_failure=False, **kwargs)
    seen = [envs.reset(seed=0)[0]]
    actions = [(rng.random(envs.action_space.shape) < 0.7) for _ in range(3)]
    if env_id == IDS[0]:
        actions = [rng.uniform(-1, 1, envs.action_space.shape) for _ in range(2)]
    for action in actions:
        seen.append(envs.step(action)[0])
    values = np.concatenate(seen)
    names = envs.unwrapped.observation_names
    assert np.abs(values).max() < 100  # healthy robots stay far from the space's bounds
    constant = [n for n, spread in zip(names, np.ptp(values, axis=0), strict=True) if spread < 1e-4]
    assert constant == []
