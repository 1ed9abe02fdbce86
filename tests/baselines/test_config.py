"""Configurations of training runs, and hyperparameters in the schema of rl_zoo3."""

import json
from dataclasses import replace

import pytest
import yaml

from baselines.config import (
    ENVIRONMENTS,
    HYPERPARAMETERS,
    TrainConfig,
    hyperparameters,
    is_same,
    make_configuration,
)  # fmt: skip
from caterpillar_env.errors import CaterpillarError
from caterpillar_env.morphology import Morphology


@pytest.mark.parametrize(
    ("fields", "message"),
    [
        ({"algorithm": "dqn"}, "algorithm = 'dqn' must be one of ppo"),
        ({"mode": "hope"}, "mode = 'hope' must be one of timing, phase, switch"),
        ({"prior": "x"}, "prior = 'x' must be one of uniform, gait"),
        ({"design": "x"}, "design = 'x' must be one of fixed, uniform, body"),
        (
            {"algorithm": "td3", "mode": "switch"},
            "td3 does not support mode 'switch'; it supports timing, phase",
        ),
        ({"budget_s": 0}, "budget_s = 0 must be at least 30, the length of one episode"),
        ({"evaluations": 0}, "evaluations = 0"),
        ({"seed": -1}, "seed = -1"),
        ({"seed": 2**32}, "seed = 4294967296"),
        ({"open_loop": True, "mode": "switch"}, "requires mode phase or timing; got mode switch"),
        (
            {"design": "uniform", "morphology": Morphology(leg_separation_m=0.02)},
            "evolves the body",
        ),
        ({"randomize": {"ambient_c": (20, 90)}}, "ambient < Mf < Ms"),
        ({"design": "uniform", "algorithm": "td3"}, "requires algorithm ppo without open_loop"),
        ({"randomize": {"luck": (0, 1)}}, "randomization has no luck; its fields are friction"),
        ({"randomize": {"mass": (2, 1)}}, "randomization of mass must be .lower, upper."),
    ],
    ids=str,
)
def test_invalid_settings_are_rejected(fields, message):
    with pytest.raises(CaterpillarError, match=message):
        TrainConfig(**fields)


def test_configuration_round_trips_through_json():
    config = TrainConfig(
        "ppo", "timing", seed=3, randomize={"friction": (0.5, 1.0)},
        morphology=Morphology(leg_separation_m=0.02), override=("gamma=0.9",),
    )  # fmt: skip
    assert TrainConfig.from_dict(json.loads(json.dumps(config.to_dict()))) == config
    assert TrainConfig.from_dict({"mode": "timing"}) == TrainConfig(mode="timing")


@pytest.mark.parametrize(
    ("data", "message"),
    [
        ({"luck": 1}, "has no luck"),
        ({"randomize": 3}, "randomize = 3 must be a mapping"),
        ({"physics": {"frictoin": 1}}, "physics has no frictoin; its fields are"),
    ],
    ids=str,
)
def test_invalid_data_is_rejected(data, message):
    with pytest.raises(CaterpillarError, match=message):
        TrainConfig.from_dict(data)


@pytest.mark.parametrize("path", sorted(HYPERPARAMETERS.glob("*.yml")), ids=lambda p: p.stem)
def test_files_follow_rl_zoos_schema(path):
    for env_id, found in yaml.safe_load(path.read_text()).items():
        assert env_id in ENVIRONMENTS.values()
        assert {"policy", "n_timesteps", "n_envs", "vec_env_wrapper"} <= set(found)


def test_bandit_acts_once_per_episode_and_keeps_the_episodes_per_rollout():
    closed = hyperparameters(TrainConfig())
    bandit = hyperparameters(TrainConfig(open_loop=True))
    assert bandit.env_kwargs == {"action_repeat": 6}
    assert bandit.model["n_steps"] * 6 == closed.model["n_steps"]
    assert bandit.model["batch_size"] == bandit.model["n_steps"] * bandit.n_envs == 16
    assert bandit.model["policy_kwargs"] == closed.model["policy_kwargs"]
    # The episode has a single step, so there is nothing to discount.
    assert bandit.model["gamma"] == 0
    td3 = hyperparameters(TrainConfig("td3", open_loop=True)).model
    assert (td3["gamma"], td3["learning_starts"]) == (0, 0)


def test_interface_has_the_mode_and_the_prior():
    found = hyperparameters(TrainConfig(mode="timing", prior="uniform")).interface
    assert found == {"reach": 0.3, "mode": "timing", "prior": "uniform"}


def test_only_policies_with_the_prior_have_a_callback():
    for config in (TrainConfig("td3"), TrainConfig(mode="switch")):
        assert hyperparameters(config).callback
        assert not hyperparameters(replace(config, prior="uniform")).callback


def test_overrides_replace_single_hyperparameters():
    default = hyperparameters(TrainConfig())
    names = ("n_envs=8", "learning_rate=3e-4", "policy_kwargs.net_arch=[32]", "interface.reach=0.2")
    found = hyperparameters(TrainConfig(override=(*names, 'interface.observe=["height"]')))
    assert found.n_envs == 8
    assert found.model["learning_rate"] == 3e-4
    assert found.model["policy_kwargs"] == {"log_std_init": -2.5, "net_arch": [32]}
    assert found.interface == default.interface | {"reach": 0.2, "observe": ["height"]}
    assert found.model.keys() == default.model.keys()


@pytest.mark.parametrize(
    ("fields", "entry", "message"),
    [
        ({}, "", "override '' must be NAME=VALUE, where NAME is one of: n_envs, n_steps"),
        ({}, "luck=1", "where NAME is one of: n_envs, n_steps"),
        ({}, "policy_kwargs=1", "policy_kwargs.log_std_init, policy_kwargs.net_arch, interface.observe"),
        ({}, "policy=CnnPolicy", "must be NAME=VALUE"),
        ({}, "n_envs", "override n_envs = '' must be an integer from 1"),
        ({}, "n_envs=0", "override n_envs = 0 must be an integer from 1"),
        ({}, "batch_size=1", "override batch_size = 1 must be an integer from 2"),
        ({}, "gamma=high", "override gamma = 'high' must be a finite number"),
        ({}, "gamma=NaN", "override gamma = nan must be a finite number"),
        ({}, "gamma=" + 5000 * "1", "override gamma = '1111"),
        ({}, "gamma=2", "override gamma = 2 must be a finite number from 0 to 1"),
        ({}, "learning_rate=-1", "override learning_rate = -1 must be a finite number from 0"),
        (
            {},
            "interface.reach=0.9",
            "interface.reach = 0.9 must be a finite number from 0 to 0.5",
        ),
        ({}, "policy_kwargs.net_arch=[0.5]", "override policy_kwargs.net_arch = 0.5 must be an integer"),
        ({}, "policy_kwargs.net_arch=[1000000]", "must be an integer from 1 to 4096"),
        ({}, "policy_kwargs.net_arch=5", r"must be a list like \[64, 64\] with at most 8 entries"),
        ({}, "interface.observe=height", "must be a list like"),
        ({"mode": "switch"}, "interface.reach=0.1", "must be NAME=VALUE"),
        ({"mode": "switch"}, "interface.action_repeat=1", "must be NAME=VALUE"),
        ({"algorithm": "td3"}, "noise_std=-1", "override noise_std = -1 must be"),
        ({"open_loop": True}, "gamma=0.9", "override of gamma has no effect with open_loop"),
        ({"open_loop": True, "algorithm": "td3"}, "tau=0.5", "override of tau has no effect"),
        ({"design": "body"}, "n_envs=8", "override of n_envs has no effect with design"),
        ({"prior": "uniform"}, "interface.reach=0.2", "has no effect with prior uniform"),
    ],
    ids=lambda value: str(value)[:40],
)
def test_invalid_overrides_are_rejected(fields, entry, message):
    with pytest.raises(CaterpillarError, match=message):
        TrainConfig(**fields, override=(entry,))


def test_repeated_override_is_rejected():
    with pytest.raises(CaterpillarError, match="override has gamma more than once"):
        TrainConfig(override=("gamma=0.9", "gamma=0.5"))


def test_overrides_of_a_bandit_apply_literally():
    model = hyperparameters(TrainConfig(open_loop=True, override=("n_steps=3", "batch_size=32"))).model
    assert (model["n_steps"], model["batch_size"]) == (3, 32)


def test_batch_is_at_most_a_rollout():
    model = hyperparameters(TrainConfig(override=("n_envs=2", "n_steps=3"))).model
    assert model["batch_size"] == 6
    with pytest.raises(CaterpillarError, match=r"a rollout of n_steps \* n_envs = 1 is too short"):
        TrainConfig(override=("n_envs=1", "n_steps=1"))


def test_journal_of_an_earlier_version_matches_the_same_config():
    config = TrainConfig(seed=3)
    recorded = make_configuration(config)
    del recorded["override"]
    assert is_same(recorded, config)
    assert not is_same(recorded, replace(config, override=("gamma=0.9",)))
    assert not is_same(recorded | {"luck": 1}, config)


@pytest.mark.parametrize(
    ("fields", "title"),
    [
        ({"mode": "timing", "open_loop": True}, "ppo timing bandit"),
        ({"mode": "timing", "design": "uniform"}, "ppo timing uniform co-design"),
        ({"morphology": Morphology(leg_separation_m=0.02)}, "ppo phase given body"),
        ({"randomize": {"mass": (0.9, 1.1)}}, "ppo phase randomized"),
        ({"algorithm": "td3", "prior": "uniform"}, "td3 phase without prior"),
        ({"override": ("gamma=0.9",)}, "ppo phase gamma=0.9"),
    ],
    ids=str,
)
def test_title_names_the_settings_that_differ_from_the_defaults(fields, title):
    assert TrainConfig(**fields).title == title
