"""Settings of trainings, and hyper-parameters in rl_zoo3's schema."""

import json

import pytest
import yaml
from stable_baselines3.common.utils import LinearSchedule

from baselines import config as settings
from baselines.config import ENVIRONMENTS, HYPERPARAMETERS, TrainConfig, TrainingError, hyperparameters
from caterpillar_env.errors import CaterpillarError
from caterpillar_env.morphology import Morphology


@pytest.mark.parametrize(
    ("fields", "message"),
    [
        ({"algorithm": "dqn"}, "algorithm = 'dqn' must be one of ppo"),
        ({"mode": "hope"}, "mode = 'hope' must be one of timing, switch"),
        ({"design": "x"}, "design = 'x' must be one of fixed, uniform, preprocessed"),
        ({"algorithm": "sac"}, "sac cannot learn in mode 'switch'; it can in timing"),
        ({"budget_s": 0}, "budget_s = 0 must be at least 30, the simulated seconds of one episode"),
        ({"evaluations": 0}, "evaluations = 0"),
        ({"seed": -1}, "seed = -1"),
        ({"seed": 2**32}, "seed = 4294967296"),
        ({"open_loop": True}, "needs mode timing"),
        (
            {"design": "uniform", "morphology": Morphology(leg_separation_m=0.02)},
            "evolves the body: leave out the given one",
        ),
        ({"randomize": {"ambient_c": (20, 90)}}, "must end below 56 degC"),
        ({"design": "uniform", "algorithm": "a2c"}, "around ppo's closed-loop policy only"),
        ({"randomize": {"luck": (0, 1)}}, "randomization has no luck; its fields are friction"),
        ({"randomize": {"mass": (2, 1)}}, "randomization of mass must be two numbers, the lesser"),
    ],
    ids=str,
)
def test_unusable_settings_are_refused(fields, message):
    with pytest.raises(CaterpillarError, match=message):
        TrainConfig(**fields)


def test_a_configuration_survives_json():
    config = TrainConfig(
        "ppo", "timing", seed=3, randomize={"friction": (0.5, 1.0)},
        morphology=Morphology(leg_separation_m=0.02),
    )  # fmt: skip
    assert TrainConfig.from_dict(json.loads(json.dumps(config.to_dict()))) == config
    assert TrainConfig.from_dict({"mode": "timing"}) == TrainConfig(mode="timing")


@pytest.mark.parametrize(
    ("data", "message"),
    [
        ({"luck": 1}, "a training has no luck"),
        ({"randomize": 3}, "randomization takes a mapping of its fields; got 3"),
        ({"physics": {"frictoin": 1}}, "physics has no frictoin; its fields are"),
    ],
    ids=str,
)
def test_what_cannot_be_read_is_told(data, message):
    with pytest.raises(CaterpillarError, match=message):
        TrainConfig.from_dict(data)


@pytest.mark.parametrize("path", sorted(HYPERPARAMETERS.glob("*.yml")), ids=lambda p: p.stem)
def test_files_follow_rl_zoos_schema(path):
    for env_id, found in yaml.safe_load(path.read_text()).items():
        assert env_id in ENVIRONMENTS.values()
        assert {"policy", "n_timesteps", "n_envs", "normalize"} <= set(found)


def test_an_open_loop_is_a_step_an_episode_and_learns_from_as_many_episodes():
    closed = hyperparameters(TrainConfig(mode="timing"))
    bandit = hyperparameters(TrainConfig(mode="timing", open_loop=True))
    assert bandit.env_kwargs == {"frame_skip": 6}
    assert bandit.model["n_steps"] * 6 == closed.model["n_steps"]
    assert bandit.model["policy_kwargs"] == closed.model["policy_kwargs"]
    # What follows a step that is the whole episode must not be guessed at.
    assert bandit.model["gamma"] == bandit.normalize["gamma"] == 0
    sac = hyperparameters(TrainConfig("sac", "timing", open_loop=True)).model["learning_starts"]
    assert sac == hyperparameters(TrainConfig("sac", "timing")).model["learning_starts"] // 6


def test_schedules_and_normalisation_are_rl_zoos(tmp_path, monkeypatch):
    monkeypatch.setattr(settings, "HYPERPARAMETERS", tmp_path)
    text = (
        "CaterpillarSMA-v0: {n_timesteps: 1, policy: MlpPolicy, learning_rate: lin_0.001, gamma: 0.7, "
        "normalize: {norm_reward: false}}"
    )
    (tmp_path / "ppo.yml").write_text(text)
    found = hyperparameters(TrainConfig(mode="timing"))
    assert isinstance(found.model["learning_rate"], LinearSchedule)
    assert found.model["learning_rate"](0.5) == pytest.approx(0.0005)
    assert found.normalize == {"gamma": 0.7, "norm_reward": False}
    assert found.n_envs == 1


def test_mode_that_an_algorithm_does_not_know_names_those_that_it_does():
    with pytest.raises(TrainingError, match="a2c cannot learn in mode 'timing'; it can in switch"):
        TrainConfig("a2c", "timing")
