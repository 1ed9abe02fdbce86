import math

import numpy as np
import pytest
from gymnasium.vector import AutoresetMode

from caterpillar_env import CaterpillarEnv, CaterpillarVectorEnv, Morphology
from caterpillar_env.errors import CaterpillarError
from caterpillar_env.morphology import LOWER, UPPER
from caterpillar_env.task import Failure

ROWS = 3
BODIES = [
    Morphology(segment_length_m=0.024, segment_radius_m=0.010),
    Morphology(),
    Morphology(leg_separation_m=0.022, segment_length_m=0.035),
]


def switch_envs(rows=ROWS, **kwargs):
    """Return environments at the start of episodes with two steps of 0.5 s each."""
    kwargs = {"action_mode": "switch", "action_repeat": 5, "episode_s": 1.0, "threads": 1, **kwargs}
    envs = CaterpillarVectorEnv(rows, **kwargs)
    envs.reset(seed=0)
    return envs


def off(rows=ROWS):
    return np.zeros((rows, 12), np.int8)


def some_actions(envs, seed=1):
    envs.action_space.seed(seed)
    return envs.action_space.sample()


def times(envs):
    return envs.crawl.progress().time_s.tolist()


def overturn(envs, row):
    """Put a robot on its back. It then fails within the next step."""
    simulation = envs.crawl.simulation
    qpos = simulation.qpos(row)
    qpos[2:7] = [simulation.bodies[row].segment_radius_m, 0, 1, 0, 0]
    simulation.place(qpos[None], np.array([row]))


# Rows


def test_first_reset_starts_all_rows():
    envs, mask = CaterpillarVectorEnv(2), np.array([True, False])
    with pytest.raises(CaterpillarError, match=r"call reset\(\) without reset_mask first"):
        envs.reset(options={"reset_mask": mask})
    envs.reset()
    envs.reset(options={"reset_mask": mask})


def test_length_of_an_episode_includes_the_maximum_number_of_steps():
    envs = CaterpillarVectorEnv(1, max_episode_steps=3)
    assert envs.episode_s == 15.0


@pytest.mark.parametrize("mode", ["timing", "switch"])
def test_row_equals_the_single_environment_with_its_seed(mode):
    kwargs = {"action_mode": mode, "action_repeat": 5, "gait_period_s": 1.0, "reset_noise_scale": 0.02}
    envs = CaterpillarVectorEnv(ROWS, morphology=BODIES, threads=1, **kwargs)
    observations, infos = envs.reset(seed=10)
    steps = [(observations, infos)]
    actions = [some_actions(envs, seed) for seed in (1, 2)]
    for action in actions:
        observation, reward, terminated, truncated, info = envs.step(action)
        steps.append((observation, info | {"r": reward, "t": terminated, "u": truncated}))
    for row in range(ROWS):
        env = CaterpillarEnv(morphology=BODIES[row], **kwargs)
        observation, info = env.reset(seed=10 + row)
        alone = [(observation, info)]
        for action in actions:
            observation, reward, terminated, truncated, info = env.step(action[row])
            alone.append((observation, info | {"r": reward, "t": terminated, "u": truncated}))
        for (mine, my_info), (theirs, their_info) in zip(alone, steps, strict=True):
            np.testing.assert_array_equal(mine, theirs[row])
            for key, value in my_info.items():
                assert value == their_info[key][row], key
                assert key in "rtu" or their_info[f"_{key}"][row]


def test_list_of_seeds_seeds_each_row():
    envs = switch_envs(reset_noise_scale=0.02)
    first, _ = envs.reset(seed=[4, 5, 4])
    np.testing.assert_array_equal(first[0], first[2])
    assert (first[0] != first[1]).any()
    np.testing.assert_array_equal(envs.reset(seed=[7, 8, 5])[0][2], first[1])


def test_unseeded_reset_continues_the_random_sequence():
    envs = switch_envs(reset_noise_scale=0.02)
    first, _ = envs.reset(seed=4)
    second, _ = envs.reset()
    assert (first != second).any(axis=1).all()
    envs.reset(seed=4)
    np.testing.assert_array_equal(envs.reset()[0], second)


@pytest.mark.parametrize("kind", ["list", "array", "dicts"])
def test_each_row_has_its_own_body(kind):
    bodies = {
        "list": BODIES,
        "array": np.stack([b.to_array() for b in BODIES]),
        "dicts": [b.to_dict() for b in BODIES],
    }[kind]
    envs = CaterpillarVectorEnv(ROWS, morphology=bodies)
    observations, _ = envs.reset(seed=0)
    assert envs.crawl.simulation.bodies == BODIES
    units = np.stack([2 * (b.to_array() - LOWER) / (UPPER - LOWER) - 1 for b in BODIES])
    np.testing.assert_allclose(observations[:, -8:], units, atol=1e-6)
    heights = observations[:, envs.observation_names.index("height")] * 0.024
    np.testing.assert_allclose(heights, [2 * b.segment_radius_m for b in BODIES], atol=1e-6)


@pytest.mark.parametrize(
    "one", [BODIES[0], BODIES[0].to_dict(), BODIES[0].to_array().tolist()], ids=type
)
def test_one_body_applies_to_all_rows(one):
    assert CaterpillarVectorEnv(ROWS, morphology=one).crawl.simulation.bodies == [BODIES[0]] * ROWS


def test_new_bodies_persist_through_resets():
    envs = switch_envs()
    envs.reset(options={"morphology": BODIES})
    envs.step(off())
    envs.step(off())
    envs.step(off())  # all rows reset
    assert times(envs) == [0, 0, 0]
    assert envs.crawl.simulation.bodies == BODIES
    envs.reset()
    assert envs.crawl.simulation.bodies == BODIES


def test_masked_reset_changes_the_bodies_of_its_rows_only():
    envs = switch_envs()
    options = {"morphology": BODIES[2], "reset_mask": np.array([False, False, True])}
    envs.reset(options=options)
    assert envs.crawl.simulation.bodies == [Morphology(), Morphology(), BODIES[2]]
    assert set(options) == {"morphology", "reset_mask"}


# Ends of episodes


def test_next_step_mode_resets_in_the_following_step():
    envs = switch_envs()
    assert envs.metadata["autoreset_mode"] is AutoresetMode.NEXT_STEP
    start, _ = envs.reset(seed=0)
    envs.step(some_actions(envs))
    last, _, terminated, truncated, info = envs.step(some_actions(envs))
    assert truncated.all()
    assert not terminated.any()
    assert (last != start).any()
    assert info["time_s"].tolist() == [1, 1, 1]
    first, rewards, terminated, truncated, info = envs.step(some_actions(envs))
    np.testing.assert_array_equal(first, start)
    assert not rewards.any()
    assert not (terminated | truncated).any()
    assert info["time_s"].tolist() == [0, 0, 0]
    *_, info = envs.step(some_actions(envs))
    assert info["time_s"].tolist() == [0.5, 0.5, 0.5]


def test_next_step_mode_restarts_only_the_row_that_ended():
    envs = switch_envs(episode_s=10.0)
    overturn(envs, 1)
    _, _, terminated, _, info = envs.step(off())
    assert terminated.tolist() == [False, True, False]
    assert info["failure"].tolist() == [Failure.NONE, Failure.FLIPPED, Failure.NONE]
    _, rewards, terminated, _, info = envs.step(off())
    assert info["time_s"].tolist() == [1.0, 0.0, 1.0]
    assert info["reward_failure"].tolist() == [0, 0, 0]
    assert rewards[1] == 0
    assert not terminated.any()
    assert info["failure"].tolist() == [Failure.NONE] * 3


def test_same_step_mode_returns_the_final_and_the_new_observation():
    envs = switch_envs(autoreset_mode=AutoresetMode.SAME_STEP, episode_s=10.0)
    other = switch_envs(autoreset_mode=AutoresetMode.DISABLED, episode_s=10.0)
    start, _ = envs.reset(seed=0)
    overturn(envs, 1)
    overturn(other, 1)
    observation, reward, terminated, truncated, info = envs.step(off())
    last, last_reward, last_terminated, _, last_info = other.step(off())
    assert terminated.tolist() == last_terminated.tolist() == [False, True, False]
    assert not truncated.any()
    np.testing.assert_array_equal(reward, last_reward)
    np.testing.assert_array_equal(observation[1], start[1])
    np.testing.assert_array_equal(observation[0], last[0])
    np.testing.assert_array_equal(info["final_obs"][1], last[1])
    assert info["final_obs"][0] is None
    final = info["final_info"]
    assert final["failure"][1] == Failure.FLIPPED
    assert final["reward_failure"][1] == -5
    assert final["time_s"][1] == last_info["time_s"][1]
    assert final["_time_s"].tolist() == [False, True, False]
    assert info["time_s"].tolist() == [0.5, 0.0, 0.5]
    assert info["failure"].tolist() == [Failure.NONE] * 3
    *_, info = envs.step(off())
    assert info["time_s"].tolist() == [1.0, 0.5, 1.0]
    assert "final_info" not in info


def test_same_step_mode_marks_the_rows_that_ended():
    envs = switch_envs(autoreset_mode="SameStep", episode_s=10.0)
    overturn(envs, 1)
    *_, info = envs.step(off())
    assert info["_final_obs"].tolist() == [False, True, False]
    assert info["_final_info"].tolist() == [False, True, False]


def test_disabled_mode_waits_for_a_masked_reset():
    envs = switch_envs(autoreset_mode="Disabled", episode_s=10.0)
    start, _ = envs.reset(seed=0)
    overturn(envs, 1)
    last, *_ = envs.step(off())
    with pytest.raises(CaterpillarError, match=r"environments \[1\] have ended.*reset_mask"):
        envs.step(off())
    observation, info = envs.reset(options={"reset_mask": np.array([False, True, False])})
    np.testing.assert_array_equal(observation[1], start[1])
    np.testing.assert_array_equal(observation[[0, 2]], last[[0, 2]])
    assert info["_time_s"].tolist() == [False, True, False]
    *_, info = envs.step(off())
    assert info["time_s"].tolist() == [1.0, 0.5, 1.0]


def test_masked_reset_seeds_only_its_rows():
    envs = switch_envs(reset_noise_scale=0.02)
    start, _ = envs.reset(seed=20)
    envs.reset(seed=20)
    again, _ = envs.reset(seed=20, options={"reset_mask": np.array([True, False, False])})
    np.testing.assert_array_equal(again, start)
    unseeded, _ = envs.reset()
    np.testing.assert_array_equal(envs.reset(seed=20)[0], start)
    np.testing.assert_array_equal(envs.reset()[0], unseeded)


def test_step_limit_truncates():
    envs = switch_envs(episode_s=10.0, max_episode_steps=2)
    ends = [envs.step(off())[3].tolist() for _ in range(5)]
    no, yes = [False] * ROWS, [True] * ROWS
    assert ends == [no, yes, no, no, yes]  # the third step is a reset


def test_failure_in_the_last_step_is_not_a_truncation():
    envs = switch_envs(max_episode_steps=1)
    overturn(envs, 0)
    _, _, terminated, truncated, _ = envs.step(off())
    assert terminated.tolist() == [True, False, False]
    assert truncated.tolist() == [False, True, True]


def test_shorter_last_step_affects_only_its_row():
    """Episodes that start at different steps have the same length."""
    envs = switch_envs(2, action_repeat=4, autoreset_mode="Disabled")  # steps of 0.4, 0.4 and 0.2 s
    envs.step(off(2))
    envs.reset(options={"reset_mask": np.array([False, True])})
    envs.step(off(2))
    _, _, _, truncated, info = envs.step(off(2))
    assert truncated.tolist() == [True, False]
    assert info["time_s"].tolist() == pytest.approx([1.0, 0.8])


# Data


def test_spaces_are_batches_of_the_single_spaces():
    envs = CaterpillarVectorEnv(ROWS)
    assert envs.action_space.shape == (ROWS, *envs.single_action_space.shape)
    observation, _ = envs.reset(seed=0)
    assert observation in envs.observation_space
    assert observation[0] in envs.single_observation_space
    assert len(envs.observation_names) == observation.shape[1]
    switch = CaterpillarVectorEnv(ROWS, action_mode="switch")
    assert switch.action_space.shape == (ROWS, 12)
    switch.reset(seed=0)
    assert switch.step(switch.action_space.sample())[0] in switch.observation_space


def test_types_and_shapes_of_a_step():
    envs = switch_envs()
    observation, reward, terminated, truncated, info = envs.step(off())
    assert (observation.dtype, observation.shape) == (np.float32, (ROWS, 68))
    assert (reward.dtype, reward.shape) == (np.float64, (ROWS,))
    for flags in (terminated, truncated):
        assert (flags.dtype, flags.shape) == (np.bool_, (ROWS,))
    for key in [k for k in info if not k.startswith("_")]:
        assert info[key].shape == info[f"_{key}"].shape == (ROWS,)
        assert info[f"_{key}"].all()


def test_returned_arrays_are_not_modified_later():
    envs = switch_envs()
    given = [envs.reset(seed=0)[0]] + [envs.step(some_actions(envs))[0] for _ in range(4)]
    kept = [g.copy() for g in given]
    given[-1][:] = 7.0
    last, *_ = envs.step(some_actions(envs))
    assert last.max() < 7
    for array, copy in zip(given[:-1], kept[:-1], strict=True):
        np.testing.assert_array_equal(array, copy)


# Errors


@pytest.mark.parametrize(
    ("actions", "message"),
    [
        (np.zeros((2, 12)), r"\(3, 12\).*got shape \(2, 12\)"),
        (np.zeros(12), r"\(3, 12\)"),
        (np.zeros((3, 11)), r"the actions must be numbers of shape \(3, 12\); got shape \(3, 11\)"),
        (np.full((3, 12), np.nan), "must be finite"),
        (np.full((3, 12), 0.5), r"0 \(off\) or 1 \(on\)"),
    ],
    ids=["rows", "flat", "short", "nan", "half"],
)
def test_invalid_actions_are_rejected_without_a_step(actions, message):
    envs = switch_envs()
    with pytest.raises(CaterpillarError, match=message):
        envs.step(actions)
    assert times(envs) == [0, 0, 0]


def test_nan_timing_is_rejected():
    envs = CaterpillarVectorEnv(2, gait_period_s=1.0)
    envs.reset(seed=0)
    with pytest.raises(CaterpillarError, match="must be finite"):
        envs.step(np.array([[0.0] * 12, [0.0] * 11 + [math.nan]]))


def test_step_before_reset_is_an_error():
    with pytest.raises(CaterpillarError, match=r"call reset\(\) before step\(\)"):
        CaterpillarVectorEnv(2).step(np.zeros((2, 12)))


@pytest.mark.parametrize(
    "mask",
    [np.zeros(ROWS, bool), np.ones(2, bool), np.array([1, 0, 1]), [True], "all"],
    ids=["none", "short", "numbers", "list", "text"],
)
def test_invalid_mask_is_an_error(mask):
    with pytest.raises(CaterpillarError, match=r"reset_mask must be a bool array of shape \(3,\)"):
        switch_envs().reset(options={"reset_mask": mask})


def test_unknown_option_error_lists_the_known_options():
    with pytest.raises(CaterpillarError, match=r"morphology, reset_mask; got \['mask'\]"):
        switch_envs().reset(options={"mask": None})


def test_number_of_seeds_must_equal_number_of_rows():
    with pytest.raises(CaterpillarError, match=r"a list of 3 integers; got \[1, 2\]"):
        switch_envs().reset(seed=[1, 2])


@pytest.mark.parametrize("bodies", [BODIES[:2], np.zeros((2, 8)), [], np.zeros((1, 3, 8))], ids=type)
def test_number_of_bodies_must_equal_number_of_rows(bodies):
    with pytest.raises(CaterpillarError, match=r"3 bodies, or an array of shape \(3, 8\)"):
        CaterpillarVectorEnv(ROWS, morphology=bodies)


def test_invalid_body_in_a_list_is_an_error():
    bodies = np.stack([b.to_array() for b in BODIES])
    bodies[1, 4] = 3.0
    with pytest.raises(CaterpillarError, match=r"joint_limit_rad = 3\.0 must be in"):
        CaterpillarVectorEnv(ROWS, morphology=bodies)


def test_invalid_modes_are_rejected():
    with pytest.raises(CaterpillarError, match=r'render_mode must be None or "rgb_array"'):
        CaterpillarVectorEnv(2, render_mode="human")
    with pytest.raises(CaterpillarError, match="autoreset_mode = 'sometimes' must be"):
        CaterpillarVectorEnv(2, autoreset_mode="sometimes")
    with pytest.raises(CaterpillarError, match="num_envs = 0 must be an integer from 1"):
        CaterpillarVectorEnv(0)


def test_a_number_is_not_a_body():
    with pytest.raises(CaterpillarError, match="a morphology must be a mapping or 8 numbers"):
        CaterpillarVectorEnv(2, morphology=3)
