"""Saving, restoring and copying the state of an episode."""

import copy
import os
import pickle
import signal
import time

import gymnasium
import mujoco
import numpy as np
import pytest

from caterpillar_env import CaterpillarEnv, CaterpillarVectorEnv, GaitTimings, Morphology
from caterpillar_env.errors import CaterpillarError
from caterpillar_env.gait import MAX_DUTY
from caterpillar_env.task import Failure

SETTINGS = {
    "action_mode": "switch",
    "action_repeat": 5,
    "episode_s": 3.0,
    "reset_noise_scale": 0.02,
    "randomization": {"friction": (0.4, 1.0), "mass": (0.8, 1.2)},
}


@pytest.fixture
def env():
    """An environment after two steps."""
    env = CaterpillarEnv(**SETTINGS)
    env.reset(seed=3, options={"morphology": {"segment_length_m": 0.03}})
    for action in draw_actions(2, seed=1):
        env.step(action)
    return env


def draw_actions(count, seed=0):
    return np.random.default_rng(seed).integers(0, 2, (count, 12))


def go_on(env):
    """Return the rest of the episode, the reset after it, and the first step of the next one."""
    actions = draw_actions(5, seed=2)
    steps = [env.step(action) for action in actions[:4]]
    return [*steps, env.reset(), env.step(actions[4])]


def assert_same(some, others):
    for (observation, *rest), (other, *other_rest) in zip(some, others, strict=True):
        np.testing.assert_array_equal(observation, other)
        assert rest == other_rest


def copy_state(env):
    branch = CaterpillarEnv(**SETTINGS)
    branch.set_state(env.get_state())
    return branch


@pytest.mark.parametrize(
    "branch_of",
    [copy_state, copy.deepcopy, lambda env: pickle.loads(pickle.dumps(env))],
    ids=["state", "deepcopy", "pickle"],
)
def test_copied_episodes_continue_with_identical_results(env, branch_of):
    branch = branch_of(env)
    assert branch.morphology == env.morphology == Morphology(segment_length_m=0.03)
    one = go_on(env)
    assert_same(one, go_on(branch))
    assert one[3][3]  # truncated after 3 s


def test_state_can_be_restored_after_the_episode_went_on(env):
    state = env.get_state()
    one = go_on(env)
    env.set_state(state)
    assert_same(one, go_on(env))


def test_copy_made_before_a_reset_needs_a_reset():
    branch = copy.deepcopy(CaterpillarEnv(**SETTINGS))
    with pytest.raises(CaterpillarError, match="call reset"):
        branch.step(draw_actions(1)[0])


def test_copies_keep_the_generator_and_the_spec():
    env = gymnasium.make("CaterpillarSMA-v0", **SETTINGS).unwrapped
    env.reset(seed=3)
    branch = copy.deepcopy(env)
    assert branch.np_random_seed == 3
    assert branch.spec.max_episode_steps == env.spec.max_episode_steps
    np.testing.assert_array_equal(branch.reset()[0], env.reset()[0])
    env.np_random = np.random.Generator(np.random.MT19937(0))
    branch = copy.deepcopy(env)
    np.testing.assert_array_equal(branch.reset()[0], env.reset()[0])
    env = CaterpillarEnv(**SETTINGS)
    env.np_random = np.random.default_rng(5)
    branch = copy.deepcopy(env)  # before the first reset
    np.testing.assert_array_equal(branch.reset()[0], env.reset()[0])


def test_rows_have_their_own_generators_and_seeds():
    envs = gymnasium.make_vec("CaterpillarSMA-v0", num_envs=2, **SETTINGS).unwrapped
    assert len(set(envs.np_random_seed)) == 2
    envs.reset(seed=5)
    assert envs.np_random_seed == (5, 6)
    single = gymnasium.make("CaterpillarSMA-v0", **SETTINGS).unwrapped
    single.reset(seed=6)
    assert envs.np_random[1].random() == single.np_random.random()
    assert copy.deepcopy(envs).np_random_seed == (5, 6)
    envs.set_state(single.get_state(), np.array([0]))
    assert envs.np_random_seed == (-1, 6)


def test_first_state_covers_all_rows(env):
    envs = CaterpillarVectorEnv(2, threads=1, **SETTINGS)
    with pytest.raises(CaterpillarError, match="or set the state of all rows"):
        envs.set_state(env.get_state(), np.array([1]))
    envs.set_state(env.get_state().rows([0, 0]))
    envs.step(draw_actions(2))


def test_state_of_one_robot_fills_the_rows_of_a_vector(env):
    envs = CaterpillarVectorEnv(3, threads=1, **SETTINGS)
    envs.reset(seed=0)
    other = envs.get_state(np.array([1]))
    envs.set_state(env.get_state().rows([0, 0]), np.array([0, 2]))
    action = draw_actions(1)[0]
    observations, rewards, *_ = envs.step(np.tile(action, (3, 1)))
    expected, reward, *_ = env.step(action)
    np.testing.assert_array_equal(observations[[0, 2]], [expected, expected])
    assert rewards[[0, 2]].tolist() == [reward, reward]
    env.set_state(other)
    np.testing.assert_array_equal(observations[1], env.step(action)[0])


def test_restored_rows_keep_their_observations_when_others_are_reset(env):
    envs = CaterpillarVectorEnv(3, threads=1, **SETTINGS)
    old, _ = envs.reset(seed=0)
    expected, *_ = env.step(draw_actions(1)[0])
    envs.set_state(env.get_state().rows([0, 0]), np.array([0, 2]))
    observations, _ = envs.reset(options={"reset_mask": np.array([False, True, False])})
    # An observation from `step` is one physics step older than the state.
    np.testing.assert_allclose(observations[[0, 2]], [expected, expected], atol=0.05)
    assert np.abs(observations - old)[[0, 2]].max(axis=1).min() > 0.5


@pytest.mark.parametrize("branch_of", [copy.deepcopy, lambda e: pickle.loads(pickle.dumps(e))])
def test_copied_vector_environment_continues_with_identical_results(branch_of):
    envs = CaterpillarVectorEnv(2, threads=1, **SETTINGS)
    envs.reset(seed=0)
    actions = draw_actions(16).reshape(8, 2, 12)
    for action in actions[:6]:  # the episodes have ended, and the next step starts new ones
        ended = envs.step(action)
    assert ended[3].all()
    branch = branch_of(envs)
    for action in actions[6:]:
        one, other = envs.step(action), branch.step(action)
        for mine, theirs in zip(one[:4], other[:4], strict=True):
            np.testing.assert_array_equal(mine, theirs)


def test_rows_can_be_a_list_in_any_order():
    envs = CaterpillarVectorEnv(3, threads=1, **SETTINGS)
    envs.reset(seed=0)
    states = envs.get_state([2, 0])
    expected, *_ = copy.deepcopy(envs).step(np.tile(draw_actions(1), (3, 1)))
    envs.reset()
    envs.set_state(states, [2, 0])
    observations, *_ = envs.step(np.tile(draw_actions(1), (3, 1)))
    np.testing.assert_array_equal(observations[[0, 2]], expected[[0, 2]])


@pytest.mark.parametrize(
    ("rows", "message"),
    [
        ([3], "rows must be indices from 0 to 2; got"),
        (np.array([-1]), "rows must be indices from 0 to 2; got"),
        ([False, True, False], "rows must be a list of indices; got"),
        (np.array([1.0]), "rows must be a list of indices; got"),
        (1, "rows must be a list of indices; got 1"),
        ([1, 1], "rows must not repeat an index; got"),
        ([0, 1], "must have 2 robots"),
        ([], "rows must be a list of indices; got"),
        (np.empty(0, dtype=int), "rows must be a list of indices; got"),
    ],
    ids=str,
)
def test_invalid_rows_change_nothing(env, rows, message):
    envs = CaterpillarVectorEnv(3, threads=1, **SETTINGS)
    envs.reset(seed=0)
    count = max(len(np.atleast_1d(rows)), 1)
    twin, states = copy.deepcopy(envs), env.get_state().rows([0] * count)
    states = states.rows([0]) if "robots" in message else states
    with pytest.raises(CaterpillarError, match=message):
        envs.set_state(states, rows)
    actions = np.tile(draw_actions(1), (3, 1))
    np.testing.assert_array_equal(envs.step(actions)[0], twin.step(actions)[0])


@pytest.mark.parametrize("mode", ["NextStep", "Disabled", "SameStep"])
def test_state_remembers_that_the_episode_has_ended(mode):
    nothing = np.zeros((2, 12))
    source = CaterpillarVectorEnv(2, threads=1, **SETTINGS)
    source.reset(seed=0)
    while not source.step(nothing)[3].all():
        pass
    envs = CaterpillarVectorEnv(2, threads=1, autoreset_mode=mode, **SETTINGS)
    envs.reset(seed=0)
    if mode == "SameStep":
        with pytest.raises(CaterpillarError, match=r"the episodes of rows \[0, 1\] have ended"):
            envs.set_state(source.get_state())
        return
    envs.set_state(source.get_state())
    if mode == "Disabled":
        with pytest.raises(CaterpillarError, match="have ended"):
            envs.step(nothing)
    else:
        *_, truncated, info = envs.step(nothing)
        assert not truncated.any()
        assert info["time_s"].tolist() == [0.0, 0.0]


def test_step_after_the_end_warns():
    env = CaterpillarEnv(**{**SETTINGS, "episode_s": 0.5})
    env.reset(seed=0)
    ended = env.step(draw_actions(1)[0])
    assert ended[3]
    state = env.get_state()
    for restart in (lambda: None, lambda: env.set_state(state)):
        restart()
        with pytest.warns(UserWarning, match="the episode has ended: call reset"):
            env.step(draw_actions(1)[0])
    env.reset()
    env.step(draw_actions(1)[0])


@pytest.mark.parametrize("branch_of", [copy.deepcopy, lambda e: pickle.loads(pickle.dumps(e))])
def test_copies_sample_the_same_actions(branch_of):
    for env in (CaterpillarEnv(), CaterpillarVectorEnv(2)):
        env.action_space.seed(5)
        branches = [branch_of(env) for _ in range(2)]
        samples = [e.action_space.sample() for e in (env, *branches)]
        np.testing.assert_array_equal(samples[0], samples[1])
        np.testing.assert_array_equal(samples[0], samples[2])


def test_state_of_another_robot_is_refused(env):
    longer = CaterpillarEnv(physics={"num_segments": 5})
    longer.reset(seed=0)
    with pytest.raises(
        CaterpillarError, match=r"1 robots with 12 springs each; got the shape \(1, 16\)"
    ):
        env.set_state(longer.get_state())
    with pytest.raises(CaterpillarError, match=r"got the shape \(2, 12\)"):
        env.set_state(env.get_state().rows([0, 0]))
    with pytest.raises(CaterpillarError, match="call reset"):
        CaterpillarVectorEnv(1).get_state()


# MuJoCo's model and data


def test_model_and_data_are_those_of_the_robot(env):
    assert env.model.nq == env.data.qpos.size
    np.testing.assert_array_equal(env.data.qpos, env.crawl.simulation.qpos(0))
    assert env.frame_skip * env.model.opt.timestep == pytest.approx(env.dt)
    data = mujoco.MjData(env.model)
    data.qpos[:] = env.data.qpos
    mujoco.mj_kinematics(env.model, data)
    np.testing.assert_allclose(env.data.body("element3").xpos, data.body("element3").xpos, atol=1e-12)


def test_reading_the_data_does_not_disturb_the_robot(env):
    branch = copy.deepcopy(env)
    branch.data.qpos[:] = 1.0
    assert_same(go_on(env), go_on(branch))


# Specification


@pytest.mark.parametrize(
    ("env_id", "arguments", "steps"),
    [
        ("CaterpillarSMA-v0", {}, 6),
        ("CaterpillarSMA-v0", {"gait_period_s": 4.0}, 8),  # the last period is cut short
        ("CaterpillarSMA-v0", {"action_repeat": 6}, 1),
        ("CaterpillarSMASwitch-v0", {"episode_s": 2.0, "action_repeat": 3}, 7),
    ],
)
def test_specification_has_the_number_of_steps(env_id, arguments, steps):
    env = gymnasium.make(env_id, **arguments)
    assert env.spec.max_episode_steps == steps
    assert gymnasium.make_vec(env_id, num_envs=1, **arguments).spec.max_episode_steps == steps
    env.reset(seed=0)
    action = np.zeros(env.action_space.shape, env.action_space.dtype)
    for number in range(1, steps + 1):
        *_, truncated, _ = env.step(action)
        assert truncated == (number == steps)


def test_max_episode_steps_of_the_user_is_kept():
    env = gymnasium.make("CaterpillarSMA-v0", max_episode_steps=2)
    assert env.spec.max_episode_steps == 2


@pytest.mark.parametrize(
    ("arguments", "steps"),
    [
        ({"episode_s": 60.0, "max_episode_steps": -1}, 12),
        ({"episode_s": 60.0, "max_episode_steps": None}, 12),
        ({"episode_s": 5.0}, 1),
        ({"max_episode_steps": 3}, 3),
    ],
    ids=str,
)
def test_specification_of_a_vector_has_its_number_of_steps(arguments, steps):
    spec = gymnasium.make("CaterpillarSMA-v0").spec
    assert gymnasium.make_vec(spec, num_envs=1, **arguments).spec.max_episode_steps == steps


def test_time_can_be_observed():
    env = gymnasium.wrappers.TimeAwareObservation(gymnasium.make("CaterpillarSMA-v0"))
    size = env.unwrapped.observation_space.shape[0]
    assert env.reset(seed=0)[0].shape == (size + 1,)


# Actions by phase


def test_phase_actions_are_delays_and_duties():
    action = np.random.default_rng(0).uniform(-1, 1, 12).astype(np.float32)
    shares = (action.astype(float) + 1) / 2
    gait = GaitTimings.from_phases(shares[0::2], MAX_DUTY * shares[1::2], 5.0)
    phase, timing = (CaterpillarEnv(action_mode=mode) for mode in ("phase", "timing"))
    assert phase.action_space == timing.action_space
    ends = []
    for env, given in ((phase, action), (timing, gait.to_action())):
        env.reset(seed=0)
        ends.append(env.step(given)[0])
    np.testing.assert_allclose(*ends, atol=1e-3)


def test_delay_of_a_right_spring_counts_from_the_left_one():
    springs = CaterpillarEnv(action_mode="phase", symmetric=False)
    pairs = CaterpillarEnv(action_mode="phase")
    action = np.random.default_rng(1).uniform(-1, 1, 12).astype(np.float32)
    both = np.repeat(action.reshape(6, 1, 2), 2, axis=1)
    both[:, 1, 0] = -1.0  # no delay
    ends = []
    for env, given in ((springs, both.ravel()), (pairs, action)):
        env.reset(seed=0)
        ends.append(env.step(given)[0])
    np.testing.assert_array_equal(*ends)


def test_switch_mode_rejects_symmetric_false():
    with pytest.raises(CaterpillarError, match="symmetric = False needs action_mode 'timing' or"):
        CaterpillarEnv(action_mode="switch", symmetric=False)


# Info


def test_info_has_numbers_only():
    envs = gymnasium.make_vec("CaterpillarSMASwitch-v0", num_envs=2, threads=1)
    _, info = envs.reset(seed=0)
    assert all(np.issubdtype(value.dtype, np.number) for key, value in info.items() if key[0] != "_")
    torch = pytest.importorskip("torch")
    pytest.importorskip("array_api_compat")
    tensors = gymnasium.wrappers.vector.NumpyToTorch(envs)
    *_, info = tensors.step(torch.zeros(2, 12, dtype=torch.int8))
    assert info["failure"].tolist() == [Failure.NONE] * 2
    single = gymnasium.wrappers.NumpyToTorch(gymnasium.make("CaterpillarSMASwitch-v0"))
    assert single.reset(seed=0)[1]["failure"] == Failure.NONE


def test_failure_prints_its_name():
    assert f"{Failure.NONE} {Failure.TIPPED}" == "ok tipped"


# Forked processes


# Python warns of a fork in a process with threads.
@pytest.mark.filterwarnings("ignore:This process:DeprecationWarning")
@pytest.mark.parametrize("threads", [1, 2])
def test_forked_process_steps_or_raises_but_does_not_hang(threads):
    envs = CaterpillarVectorEnv(2, threads=threads, **SETTINGS)
    envs.reset(seed=0)
    child = os.fork()
    if not child:
        try:
            envs.step(draw_actions(2))
            os._exit(0)
        except CaterpillarError as error:
            os._exit(3 if "forked process has no threads" in str(error) else 4)
    for _ in range(300):
        ended, status = os.waitpid(child, os.WNOHANG)
        if ended:
            break
        time.sleep(0.1)
    else:
        os.kill(child, signal.SIGKILL)
        os.waitpid(child, 0)
        pytest.fail("the forked process hangs")
    assert os.waitstatus_to_exitcode(status) == (0 if threads == 1 else 3)
