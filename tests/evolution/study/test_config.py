"""What a study asks."""

import json
import re
from pathlib import Path

import pytest

from caterpillar_env.errors import CaterpillarError
from evolution.study.config import (
    Cell,
    StudyConfig,
    preset,
    read_toml,
)

SMALL = {
    "seeds": [0, 1],
    "pilot_seeds": [8],
    "budget_s": 240,
    "generation": 1,
    "base": {
        "ga": {"population": 4, "hall_of_fame": 1},
        "physics": {"num_segments": 2, "timestep_s": 0.01},
    },
    "arms": {
        "ga-uniform": {"prior": "uniform"},
        "cma-es": {"optimizer": "cma-es", "cma": {"cma_population": 4}},
    },
}
TOML = Path(__file__).with_name("small.toml")


def changed(**fields):
    return {**SMALL, **fields}


def test_toml_and_plain_data_describe_the_same_study():
    assert read_toml(TOML) == StudyConfig.from_dict(SMALL)


def test_a_study_survives_json():
    config = StudyConfig.from_dict(SMALL)
    assert StudyConfig.from_dict(json.loads(json.dumps(config.to_dict()))) == config


def test_arms_are_what_they_have_in_common_and_what_is_special():
    arms = StudyConfig.from_dict(SMALL).arms
    assert {arm.config.ga.population for arm in arms.values()} == {4}
    assert arms["ga-uniform"].config.prior == "uniform"
    assert arms["cma-es"].config.cma.cma_population == 4
    assert arms["cma-es"].config.physics.num_segments == 2


@pytest.mark.parametrize("name", ["paper", "ablation", "pilot"])
def test_presets_are_whole(name):
    config = preset(name)
    assert {"ga-uniform", "ga-preprocessed"} <= set(config.arms)
    assert not set(config.seeds) & set(config.pilot_seeds)


def test_pilot_holds_the_controls():
    assert {"ga-mirrored", "random-preprocessed", "cma-es-uniform", "cma-es-preprocessed"} <= set(
        preset("pilot").arms
    )


def test_cells_of_a_seed_differ_in_their_arm_alone():
    config = StudyConfig.from_dict(SMALL)
    assert len(config.cells()) == 1 + 2 * 2
    assert config.cells()[0] == Cell("ga-uniform", 8)
    run = config.arms["cma-es"].run_config(1, config.budget_s)
    assert (run.seed, run.budget_s, run.optimizer) == (1, 240, "cma-es")


@pytest.mark.parametrize(
    ("data", "message"),
    [
        (changed(arms={}), "a study needs arms"),
        (changed(seeds=[]), "seeds must be different whole numbers from 0, at least one; got []"),
        (changed(seeds=[1, 1]), "seeds must be different"),
        (changed(seeds=3), "seeds must be a list; got 3"),
        (changed(pilot_seeds=[0]), "seeds [0] are pilot seeds too"),
        (changed(reference="best"), "reference = 'best' is no arm; arms are ga-uniform"),
        (
            changed(budget_s=0),
            "budget_s = 0 must be at least 30",
        ),
        (changed(threshold_shares=[]), "threshold_shares must be positive"),
        (changed(generation="x"), "generation = 'x' must be a whole number"),
        (changed(arms={"a/b": {}}), "reference = 'ga-uniform' is no arm"),
        (changed(arms={**SMALL["arms"], "a/b": {}}), "an arm's name is a folder's too"),
        (changed(luck=1), "a study has no luck; it has base, arms, budget_s"),
        ({k: v for k, v in SMALL.items() if k != "seeds"}, "a study needs seeds"),
        (changed(arms={"ga-uniform": {"seed": 3}}), "seed is the study's to say"),
        (
            changed(arms={"ga-uniform": {"target_m": 0.1}}),
            "arms.ga-uniform: target_m = 0.1 would end runs early",
        ),
        (changed(arms={"ga-uniform": 3}), "arms.ga-uniform must be a table"),
        (changed(arms={"ga-uniform": {"prior": "hopeful"}}), "arms.ga-uniform: prior = 'hopeful'"),
        (
            changed(arms={"ga-uniform": {"hope": 1}}),
            "arms.ga-uniform: a run's configuration has no",
        ),
    ],
    ids=lambda value: value[:30] if isinstance(value, str) else "",
)
def test_unusable_studies_are_refused(data, message):
    with pytest.raises(CaterpillarError, match=re.escape(message)):
        StudyConfig.from_dict(data)
