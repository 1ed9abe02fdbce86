import copy

import gymnasium
import numpy as np
import pytest

import caterpillar_env  # noqa: F401  registers the environments
from caterpillar_env import CaterpillarError
from caterpillar_env.faults import Faults

SWITCH = "CaterpillarSMASwitch-v0"
ON = np.ones(12, dtype=np.int8)


def temperatures(env):
    return env.unwrapped.crawl.simulation.state().temperature_c


def test_dead_springs_stay_cold_from_the_start():
    envs = gymnasium.make_vec(SWITCH, 3, faults=2, threads=1)
    _, info = envs.reset(seed=5)
    dead = info["spring_power"] == 0
    assert dead.sum(axis=1).tolist() == [2, 2, 2]
    assert info["_spring_power"].all()
    for _ in range(5):
        _, _, _, _, info = envs.step(np.tile(ON, (3, 1)))
    hot = temperatures(envs) > 40
    np.testing.assert_array_equal(hot, ~dead)
    np.testing.assert_array_equal(info["spring_power"] == 0, dead)
    assert len(np.unique(dead, axis=0)) > 1  # they differ between episodes


def test_weak_springs_fail_in_mid_episode():
    faults = {"springs": 3, "power": 0.25, "time_s": (0.5, 0.5)}
    env, healthy = gymnasium.make(SWITCH, faults=faults), gymnasium.make(SWITCH)
    env.reset(seed=1)
    healthy.reset(seed=1)
    powers, used_j, usual_j = [], [0.0], [0.0]
    for step in range(8):
        *_, info = env.step(ON)
        *_, usual = healthy.step(ON)
        powers.append(info["spring_power"])
        used_j.append(info["energy_j"])
        usual_j.append(usual["energy_j"])
        if step < 5:
            assert info["energy_j"] == usual["energy_j"]
            np.testing.assert_array_equal(temperatures(env), temperatures(healthy))
    assert [int((power < 1).sum()) for power in powers] == [0] * 4 + [3] * 4
    assert "spring_power" not in usual
    # From the start of the sixth step, three of twelve springs get a quarter of the power.
    ratio = np.diff(used_j[5:7]) / np.diff(usual_j[5:7])
    assert ratio == pytest.approx((9 + 3 * 0.25) / 12)
    weak = powers[-1] == 0.25
    assert (temperatures(env)[0, weak] < temperatures(healthy)[0, weak] - 1).all()
    np.testing.assert_array_equal(temperatures(env)[0, ~weak], temperatures(healthy)[0, ~weak])


def test_times_of_failures_are_uniform_in_their_range():
    faults, rng = Faults(springs=1, time_s=(2.0, 4.0)), np.random.default_rng(0)
    steps = np.array([faults.draw(12, rng)[1] for _ in range(400)])  # in units of 10 ms
    assert 200 <= steps.min() < 205
    assert 395 < steps.max() <= 400
    assert steps.mean() == pytest.approx(300, abs=10)


def test_springs_fail_within_a_gait_period():
    """In timing mode a step is a gait period, and the failure need not be at its start."""
    env = gymnasium.make("CaterpillarSMA-v0", faults={"springs": 12, "time_s": (2.0, 2.0)})
    usual = gymnasium.make("CaterpillarSMA-v0")
    env.reset(seed=0)
    usual.reset(seed=0)
    action = np.tile([-1.0, 0.9], 6).astype(np.float32)  # on for almost the whole period
    *_, info = env.step(action)
    *_, healthy = usual.step(action)
    assert 0.2 < info["energy_j"] / healthy["energy_j"] < 0.95
    assert temperatures(env).max() < temperatures(usual).max() - 10


def test_seeds_and_states_repeat_the_faults():
    make = {"faults": {"springs": 1, "time_s": (0.0, 2.0)}}
    envs = gymnasium.make_vec(SWITCH, 4, threads=1, **make)
    envs.reset(seed=7)
    single = gymnasium.make(SWITCH, **make)
    single.reset(seed=9)
    copied = copy.deepcopy(single.unwrapped)
    for _ in range(20):
        _, _, _, _, info = envs.step(np.tile(ON, (4, 1)))
        *_, alone = single.step(ON)
        *_, again = copied.step(ON)
    np.testing.assert_array_equal(alone["spring_power"], info["spring_power"][2])
    np.testing.assert_array_equal(alone["spring_power"], again["spring_power"])
    assert alone["energy_j"] == again["energy_j"] == info["energy_j"][2]
    assert (info["spring_power"].sum(axis=1) == 11).all()
    first = envs.unwrapped.get_state().rows([1, 1])
    assert first.kept.shape == (2, 12)


def test_no_faults_can_be_written_as_0():
    env = gymnasium.make(SWITCH, faults=0)
    assert "spring_power" not in env.reset(seed=0)[1]


@pytest.mark.parametrize(
    ("value", "message"),
    [
        (-1, "springs = -1 must be an integer from 1"),
        (2.0, "faults must be a number of springs, or a mapping from field names to values; got 2.0"),
        (13, "faults.springs = 13 must be at most the number of springs, 12"),
        ({"power": 2}, "power = 2 must be a finite number from 0 to 1"),
        ({"time_s": (3, 1)}, r"time_s of faults must be \(earliest, latest\) with earliest <= latest"),
        ({"time_s": 3}, "time_s = 3 must be a list"),
        ({"force": 1}, "faults has no force; its fields are springs, power, time_s"),
        ("two", "faults must be a number of springs, or a mapping from field names to values"),
    ],
)
def test_errors_name_the_field(value, message):
    with pytest.raises(CaterpillarError, match=message):
        gymnasium.make(SWITCH, faults=value)


def test_state_carries_faults_to_an_environment_without_faults():
    env, model = gymnasium.make(SWITCH, faults=4), gymnasium.make(SWITCH)
    env.reset(seed=1)
    model.reset(seed=2)
    model.unwrapped.set_state(env.unwrapped.get_state())
    *_, info = env.step(ON)
    *_, predicted = model.step(ON)
    assert predicted["energy_j"] == info["energy_j"]
    model.reset()
    *_, healthy = model.step(ON)
    assert healthy["energy_j"] == pytest.approx(12 / 8 * info["energy_j"])


def test_faults_accept_a_number_of_springs():
    assert Faults.of(3) == Faults(springs=3) == Faults.of({"springs": 3})
    assert Faults.of(None) is None
