import math
import pickle

import gymnasium
import numpy as np
import pytest

from caterpillar_env import CaterpillarEnv, Morphology, Physics
from caterpillar_env.errors import CaterpillarError
from caterpillar_env.morphology import LOWER, UPPER
from caterpillar_env.task import Failure, FailureLimits

SMALL = Morphology(segment_length_m=0.024, segment_radius_m=0.010, joint_limit_rad=0.4)
ALL_ON, ALL_OFF = np.ones(12, np.int8), np.zeros(12, np.int8)


def timing_env(**kwargs):
    """Return an environment after reset, with a gait period of 1 s."""
    env = CaterpillarEnv(**{"gait_period_s": 1.0, **kwargs})
    env.reset(seed=0)
    return env


def switch_env(**kwargs):
    env = CaterpillarEnv(action_mode="switch", **kwargs)
    env.reset(seed=0)
    return env


def fail_at_once(env):
    """Let every pose count as JUMPED."""
    env.crawl.limits = FailureLimits(jumped_clearance_m=-1.0)
    return env


def some_action(env, seed=1):
    env.action_space.seed(seed)
    return env.action_space.sample()


# Spaces


@pytest.mark.parametrize("segments", [2, 4, 6])
def test_spaces_follow_from_the_number_of_segments(segments):
    gaps, joints = segments - 1, 3 * segments - 1
    senses = 2 * joints + 3 + 2 + 1 + 6 + 2 * 4 * gaps + 8
    pairs = CaterpillarEnv(physics={"num_segments": segments})
    single = CaterpillarEnv(physics={"num_segments": segments}, symmetric=False)
    switch = CaterpillarEnv(physics={"num_segments": segments}, action_mode="switch")
    assert pairs.action_space == gymnasium.spaces.Box(-1, 1, (4 * gaps,), np.float32)
    assert single.action_space == gymnasium.spaces.Box(-1, 1, (8 * gaps,), np.float32)
    assert switch.action_space == gymnasium.spaces.MultiBinary(4 * gaps)
    assert pairs.observation_space.shape == (senses,)
    assert switch.observation_space.shape == (senses + 2,)  # the phase
    if segments == 4:  # as in the documentation
        assert senses == 66


def test_first_observation_describes_the_start():
    env = CaterpillarEnv(action_mode="switch", morphology=SMALL)
    observation, info = env.reset(seed=0)
    seen = dict(zip(env.observation_names, observation.tolist(), strict=True))
    unit = 2 * (SMALL.to_array() - LOWER) / (UPPER - LOWER) - 1
    expected = {"up:z": 1, "heading:cos": 1, "phase:cos": 1, "height": 0.020 / 0.024}
    expected |= {f"morphology:{n}": u for n, u in zip(SMALL.to_dict(), unit, strict=True)}
    for name, value in seen.items():
        assert value == pytest.approx(expected.get(name, 0.0), abs=1e-6), name
    assert info["failure"] == Failure.NONE
    assert info["time_s"] == info["energy_j"] == info["distance"] == 0


# Steps


def test_timing_step_repeats_the_gait_period_action_repeat_times():
    env, longer = timing_env(gait_period_s=0.5), timing_env(gait_period_s=0.5, action_repeat=2)
    assert (env.dt, longer.dt) == (0.5, 1.0)
    action = some_action(env)
    assert env.step(action)[-1]["time_s"] == pytest.approx(0.5)
    one, other = env.step(action), longer.step(action)
    assert one[-1]["time_s"] == other[-1]["time_s"] == pytest.approx(1.0)
    np.testing.assert_array_equal(one[0], other[0])


def test_switch_step_lasts_action_repeat_intervals():
    env = switch_env(action_repeat=3)
    assert env.dt == pytest.approx(0.3)
    *_, info = env.step(ALL_OFF)
    assert info["time_s"] == pytest.approx(0.3)


def test_pair_action_powers_both_springs_of_the_pair():
    action = np.full(12, -1.0)
    action[2:4] = [-1.0, 0.0]  # the ventral pair of gap 1, for the first half
    env = timing_env()
    observation, *_, info = env.step(action)
    hot = [
        n for n, v in zip(env.observation_names, observation, strict=True) if n[:4] == "temp" and v > 0
    ]
    assert hot == ["temperature:gap1_ventral_left", "temperature:gap1_ventral_right"]
    watt = 0.35**2 * 0.98e-6 / (math.pi * 0.15e-3**2 / 4) * 100 * math.pi * 0.47e-3
    assert info["energy_j"] == pytest.approx(2 * watt * 0.5)


def test_without_symmetry_each_spring_has_its_own_times():
    action = np.full(24, -1.0)
    action[6:8] = [0.0, 1.0]  # the fourth spring, for the second half
    env = timing_env(symmetric=False)
    observation, *_ = env.step(action)
    hot = [
        n for n, v in zip(env.observation_names, observation, strict=True) if n[:4] == "temp" and v > 0
    ]
    assert hot == ["temperature:gap1_ventral_right"]


def test_symmetric_and_full_actions_give_the_same_gait():
    pairs, single = timing_env(), timing_env(symmetric=False)
    action = some_action(pairs)
    one = pairs.step(action)
    other = single.step(np.repeat(action.reshape(6, 2), 2, axis=0).ravel())
    np.testing.assert_array_equal(one[0], other[0])


def test_switch_action_powers_the_selected_springs():
    env = switch_env()
    action = ALL_OFF.copy()
    action[[0, 7]] = 1
    observation, *_ = env.step(action)
    hot = [
        n for n, v in zip(env.observation_names, observation, strict=True) if n[:4] == "temp" and v > 0
    ]
    assert hot == ["temperature:gap1_dorsal_left", "temperature:gap2_ventral_right"]


def test_actions_outside_the_box_are_clipped():
    one, other = timing_env(), timing_env()
    action = 3 * some_action(one)
    np.testing.assert_array_equal(one.step(action)[0], other.step(np.clip(action, -1, 1))[0])


# Reward


def test_return_is_the_distance_in_centimetres():
    env = timing_env(episode_s=3.0)
    total, truncated = 0.0, False
    while not truncated:
        _, reward, _, truncated, info = env.step(some_action(env))
        assert reward == info["reward_forward"]
        total += reward
    assert abs(total) > 0.01
    assert total == pytest.approx(100 * info["distance"])


def test_control_cost_is_the_weighted_energy():
    env = switch_env(forward_reward_weight=0.0, ctrl_cost_weight=2.0, action_repeat=5)
    env.step(ALL_ON)
    _, reward, *_, info = env.step(ALL_ON)
    watt = 12 * 0.35**2 * 0.98e-6 / (math.pi * 0.15e-3**2 / 4) * 100 * math.pi * 0.47e-3
    assert reward == pytest.approx(-2.0 * watt * 0.5)
    assert info["reward_ctrl"] == reward
    assert info["energy_j"] == pytest.approx(watt * 1.0)


def test_failure_cost_is_charged_once():
    env = fail_at_once(
        switch_env(failure_cost=7.0, forward_reward_weight=0.0, terminate_on_failure=False)
    )
    rewards = [env.step(ALL_OFF)[1] for _ in range(3)]
    assert rewards == [-7.0, 0.0, 0.0]


@pytest.mark.parametrize("goal_heading_rad", [0.0, 0.5])
def test_velocity_is_the_mean_over_the_step(goal_heading_rad):
    env = timing_env(gait_period_s=0.5, goal_heading_rad=goal_heading_rad)
    _, before = env.reset(seed=0)
    *_, info = env.step(some_action(env))
    x_m, y_m = (info[f"{axis}_position"] - before[f"{axis}_position"] for axis in "xy")
    assert info["x_velocity"] == pytest.approx(x_m / 0.5)
    assert info["y_velocity"] == pytest.approx(y_m / 0.5)
    assert info["distance_from_origin"] == pytest.approx(math.hypot(x_m, y_m))


# Ends


def test_failure_ends_the_episode_within_the_step():
    env = fail_at_once(timing_env())
    _, reward, terminated, truncated, info = env.step(some_action(env))
    assert terminated
    assert not truncated
    assert info["failure"] == Failure.JUMPED
    assert info["time_s"] == pytest.approx(0.1)
    assert info["reward_failure"] == -5
    assert reward == pytest.approx(info["reward_forward"] - 5)


def test_failure_in_the_last_step_is_not_a_truncation():
    env = fail_at_once(timing_env(episode_s=timing_env().dt))
    assert env.step(some_action(env))[2:4] == (True, False)


def test_failure_can_be_set_not_to_terminate():
    env = fail_at_once(timing_env(terminate_on_failure=False))
    _, _, terminated, _, info = env.step(some_action(env))
    assert not terminated
    assert info["failure"] == Failure.JUMPED
    assert info["time_s"] == pytest.approx(1.0)


@pytest.mark.parametrize("terminate", [True, False])
def test_divergence_always_ends_the_episode(terminate, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)  # MuJoCo logs its warning in the working directory
    env = switch_env(terminate_on_failure=terminate)
    env.crawl.simulation.place(np.full((1, 18), np.nan))
    observation, reward, terminated, truncated, info = env.step(ALL_OFF)
    assert (terminated, truncated) == (True, False)
    assert info["failure"] == Failure.DIVERGED
    assert math.isfinite(reward)
    assert observation in env.observation_space
    assert env.reset()[1]["failure"] == Failure.NONE


def test_episode_is_truncated_at_its_length():
    env = timing_env(episode_s=2.5)
    ends = [env.step(np.full(12, -1.0))[2:] for _ in range(3)]
    assert [(e[0], e[1]) for e in ends] == [(False, False), (False, False), (False, True)]
    assert ends[-1][2]["time_s"] == pytest.approx(2.5)  # the last step is shorter


def test_default_episode_is_thirty_seconds():
    env = switch_env(action_repeat=299)  # a step of 29.9 s
    assert env.step(ALL_OFF)[3] is False
    assert env.step(ALL_OFF)[3] is True


# Reset


def test_noise_moves_joints_by_its_scale():
    env = CaterpillarEnv(reset_noise_scale=0.05)
    quiet, noisy = CaterpillarEnv().reset(seed=3)[0], env.reset(seed=3)[0]
    moved = dict(zip(env.observation_names, (noisy - quiet).tolist(), strict=True))
    hinges = [abs(v) * 0.3 for n, v in moved.items() if n.startswith(("position:bend", "position:neck"))]
    axials = [abs(v) * 0.003 for n, v in moved.items() if n.startswith("position:axial")]
    assert 0.02 < max(hinges) <= 0.05
    assert 1e-4 < max(axials) <= 5e-4  # 1 cm per unit of noise


def test_distance_and_heading_refer_to_the_goal_heading():
    goal_rad, actions = 0.5, np.random.default_rng(0).uniform(-1, 1, (2, 24))
    settings = {"symmetric": False, "gait_period_s": 1.0}
    straight, turning = CaterpillarEnv(**settings), CaterpillarEnv(goal_heading_rad=goal_rad, **settings)
    seen, heading = turning.reset()[0], straight.observation_names.index("heading:cos")
    straight.reset()
    np.testing.assert_allclose(seen[heading : heading + 2], [math.cos(0.5), -math.sin(0.5)], rtol=1e-6)
    for action in actions:
        straight.step(action)
        _, reward, _, _, info = turning.step(action)
    along, other = straight.crawl.progress(), turning.crawl.progress()
    assert abs(along.lateral_m[0]) > 1e-4
    cosine, sine = math.cos(goal_rad), math.sin(goal_rad)
    assert info["distance"] == pytest.approx(cosine * along.distance_m[0] + sine * along.lateral_m[0])
    assert other.lateral_m == pytest.approx(cosine * along.lateral_m - sine * along.distance_m)
    assert other.heading_rad == pytest.approx(along.heading_rad - goal_rad)
    assert reward == pytest.approx(info["reward_forward"])


def test_new_body_persists_until_replaced():
    env = timing_env()
    env.reset(options={"morphology": SMALL.to_dict()})
    for _ in range(2):
        observation, _ = env.reset()
        assert env.morphology == SMALL
        assert observation[env.observation_names.index("height")] == pytest.approx(0.020 / 0.024)
    env.reset(options={"morphology": Morphology().to_array()})
    assert env.morphology == Morphology()


def test_partial_morphology_changes_the_nominal_body():
    env = CaterpillarEnv({"segment_length_m": 0.024})
    assert env.morphology == Morphology(segment_length_m=0.024)
    env.reset(options={"morphology": {"segment_radius_m": 0.010}})
    assert env.morphology == Morphology(segment_radius_m=0.010)


def test_on_interval_gets_the_traces_of_a_step():
    env, traces = timing_env(), []
    env.on_interval = traces.append
    env.step(some_action(env))
    assert [trace.qpos.shape for trace in traces] == [(1, 10, 18)] * 10
    np.testing.assert_array_equal(traces[-1].qpos[0, -1], env.crawl.simulation.qpos(0))


def test_invalid_body_does_not_replace_the_old_one():
    env = timing_env(morphology=SMALL)
    with pytest.raises(CaterpillarError, match="joint_limit_rad"):
        env.reset(options={"morphology": {**SMALL.to_dict(), "joint_limit_rad": 2.0}})
    assert env.morphology == SMALL


def test_noise_at_reset_stays_within_the_stops():
    env = CaterpillarEnv(reset_noise_scale=1.0)
    env.reset(seed=0)
    low, high = env.model.jnt_range[1:].T
    positions = env.data.qpos[7:]
    assert ((low <= positions) & (positions <= high)).all()
    assert (np.isclose(positions, low) | np.isclose(positions, high)).any()


def test_pickled_environment_gives_the_same_results():
    env = timing_env(morphology=SMALL.to_dict(), reset_noise_scale=0.01)
    twin = pickle.loads(pickle.dumps(env))
    start, _ = env.reset(seed=5)
    twin_start, _ = twin.reset(seed=5)
    np.testing.assert_array_equal(start, twin_start)
    action = some_action(env)
    np.testing.assert_array_equal(env.step(action)[0], twin.step(action)[0])


# Errors


@pytest.mark.parametrize(
    ("action", "message"),
    [
        (np.zeros(11), r"the action must be numbers of shape \(12,\); got shape \(11,\)"),
        (np.zeros((1, 12)), r"shape \(12,\)"),
        (np.full(12, np.nan), "must be finite"),
        (np.array([0.0] * 11 + [np.inf]), "must be finite"),
        (None, r"shape \(12,\)"),
        (["on"] * 12, r"shape \(12,\)"),
    ],
    ids=["short", "deep", "nan", "inf", "none", "text"],
)
def test_invalid_action_is_rejected_without_a_step(action, message):
    env = timing_env()
    with pytest.raises(CaterpillarError, match=message):
        env.step(action)
    assert env.crawl.simulation.simulated_s == 0


@pytest.mark.parametrize("value", [0.5, 2, -1])
def test_switch_actions_are_on_or_off(value):
    env = switch_env()
    with pytest.raises(CaterpillarError, match=r"0 \(off\) or 1 \(on\)"):
        env.step(np.full(12, value))


def test_step_before_reset_is_an_error():
    with pytest.raises(CaterpillarError, match=r"call reset\(\) before step\(\)"):
        CaterpillarEnv().step(np.zeros(12))


def test_unknown_option_error_lists_the_known_options():
    env = timing_env()
    with pytest.raises(CaterpillarError, match=r"morphology; got \['body'\]"):
        env.reset(options={"body": SMALL})


@pytest.mark.parametrize(
    ("kwargs", "message"),
    [
        ({"action_mode": "torque"}, "must be one of timing, phase, switch"),
        ({"action_repeat": 0}, "action_repeat = 0 must be an integer from 1"),
        ({"action_repeat": 1.5}, "action_repeat = 1.5 must be an integer"),
        ({"failure_cost": -1.0}, "failure_cost = -1.0 must be a finite number from 0"),
        ({"ctrl_cost_weight": math.nan}, "ctrl_cost_weight = nan must be a finite number"),
        ({"reset_noise_scale": math.inf}, "reset_noise_scale = inf must be a finite number"),
        ({"goal_heading_rad": 0.8}, "goal_heading_rad = 0.8 must be a finite number from -0.7 to 0.7"),
        ({"gait_period_s": 0.25}, "gait_period_s of 0.25 s must be a whole multiple of 0.1"),
        ({"episode_s": 0.0}, "episode_s of 0 s must be a whole multiple"),
        ({"physics": {"legs": 6}}, "physics has no legs"),
        ({"morphology": [1, 2]}, "8 numbers"),
        ({"render_mode": "ascii"}, 'render_mode must be None or "rgb_array"'),
    ],
    ids=lambda v: str(v) if isinstance(v, dict) else "",
)
def test_invalid_argument_is_rejected_with_the_reason(kwargs, message):
    with pytest.raises(CaterpillarError, match=message):
        CaterpillarEnv(**kwargs)


def test_physics_reaches_the_robot():
    env = CaterpillarEnv(physics={"friction": 0.5, "spring": {"ambient_c": 20.0}})
    assert env.crawl.physics == Physics.of({"friction": 0.5, "spring": {"ambient_c": 20.0}})
    env.reset(seed=0)
    assert env.crawl.simulation.state().temperature_c[0, 0] == 20
