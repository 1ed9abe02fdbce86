"""Configuration of a study: reading, defaults, warnings and errors."""

import json
import os
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from caterpillar_env.errors import CaterpillarError
from evolution.study.config import Cell, StudyConfig, begin, load, preset, read_toml

SMALL = {
    "seeds": [0, 1],
    "budget_s": 240,
    "generations": [2],
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


def test_study_round_trips_through_json():
    config = StudyConfig.from_dict(SMALL)
    assert StudyConfig.from_dict(json.loads(json.dumps(config.to_dict()))) == config


def test_settings_of_an_arm_are_merged_into_the_base():
    arms = StudyConfig.from_dict(SMALL).arms
    assert {arm.config.ga.population for arm in arms.values()} == {4}
    assert arms["ga-uniform"].config.prior == "uniform"
    assert arms["cma-es"].config.cma.cma_population == 4
    assert arms["cma-es"].config.physics.num_segments == 2


@pytest.mark.parametrize(
    ("name", "arms"),
    [("paper", 2), ("ablation", 33), ("conjecture", 22), ("search", 2), ("worlds", 7), ("pilot", 6)],
)
def test_presets_are_complete_and_raise_no_warnings(name, arms):
    config = preset(name)
    assert len(config.arms) == arms
    assert config.reference in config.arms
    assert config.warnings() == []


def test_pilot_includes_the_controls():
    controls = {"ga-mirrored", "random-preprocessed", "cma-es-uniform", "cma-es-preprocessed"}
    assert controls <= set(preset("pilot").arms)


def test_all_arms_run_with_one_seed_before_the_next():
    arms = ("ga-uniform", "cma-es")
    assert StudyConfig.from_dict(SMALL).cells() == [Cell(arm, seed) for seed in (0, 1) for arm in arms]


def test_some_runs_of_the_reference_are_longer():
    config = StudyConfig.from_dict(changed(long_seeds=[1, 5], long_budget_s=600))
    assert [config.budget_of(cell) for cell in config.cells()] == [240, 240, 600, 240]


def test_paper_preset_has_the_evaluations_of_the_paper():
    config = preset("paper")
    run = config.arms["ga-uniform"].config
    assert config.budget_s == 30 * replace(run, generations=50).evaluations() == 285_300
    assert config.long_budget_s == 30 * replace(run, generations=114).evaluations() == 650_100
    assert len(config.long_seeds) == len(config.seeds) / 3
    assert len([seed for seed in config.long_seeds if seed < 10]) == 3


def test_arms_can_have_their_own_references():
    arms = {name: {} for name in ("ga-uniform", "a", "b", "c")}
    config = StudyConfig.from_dict(changed(arms=arms, references={"c": "b"}))
    assert [config.reference_of(arm) for arm in arms] == ["ga-uniform", "ga-uniform", "b", "b"]


def test_arms_of_the_conjecture_differ_in_the_prior_from_their_reference():
    config, sizes = preset("conjecture"), set()
    for name, arm in config.arms.items():
        base = config.arms[config.reference_of(name)]
        assert replace(arm.config, prior="uniform") == base.config
        genes = len(arm.config.encoding.genes)
        assert arm.config.ga.mutation_rate == pytest.approx(1 / genes, rel=1e-3)
        sizes.add(genes)
    assert (min(sizes), max(sizes), len(sizes)) == (20, 188, 8)
    assert set(config.arms) - set(config.references) == set(config.references.values())
    assert len(config.comparable()) == len(config.arms)


def test_arms_of_the_ablation_differ_in_one_part_from_their_reference():
    config = preset("ablation")
    parts = ("optimizer", "timing", "prior", "prior_use", "prior_control", "prior_without", "race_share")
    for name in config.arms:
        run, base = (config.arms[arm].config for arm in (name, config.reference_of(name)))
        changes = [part for part in (*parts, "shade") if getattr(run, part) != getattr(base, part)]
        if base.prior == "uniform" and changes[:1] == ["prior"]:
            changes = changes[:1]  # prior_use and prior_control are parts of the prior
        assert len(changes) == (name != config.reference), (name, changes)
        if run.optimizer == "ga":
            assert run.ga.mutation_rate == pytest.approx(1 / len(run.encoding.genes), rel=1e-3)


def test_budget_that_is_too_short_gives_a_warning():
    (warning,) = StudyConfig.from_dict(changed(budget_s=209)).warnings()
    assert warning.startswith("arms.ga-uniform: 2 generations, after which arms are compared, may not")
    # 4 evaluations and 3 more, 30 s each
    assert StudyConfig.from_dict(changed(budget_s=210)).warnings() == []


def test_generations_beyond_the_budget_give_a_warning():
    (warning,) = StudyConfig.from_dict(changed(generations=[1, 50])).warnings()
    assert warning.startswith("arms.ga-uniform: 50 generations, after which arms are compared, may not")
    longer = {"long_seeds": [0], "long_budget_s": 4530}  # 4 evaluations and 49 times 3 more, 30 s each
    assert StudyConfig.from_dict(changed(generations=[1, 50], **longer)).warnings() == []


def test_generations_are_comparable_within_one_algorithm():
    assert StudyConfig.from_dict(SMALL).comparable() == ["ga-uniform"]
    assert preset("pilot").comparable() == ["ga-uniform", "ga-preprocessed", "ga-mirrored"]


def test_arms_and_seeds_can_be_added_to_a_study(tmp_path):
    config = StudyConfig.from_dict(SMALL)
    begin(config, tmp_path)
    arms = {**SMALL["arms"], "random": {"optimizer": "random"}}
    longer = {"long_seeds": [2], "long_budget_s": 300}
    begin(StudyConfig.from_dict(changed(arms=arms, seeds=[0, 1, 2], **longer)), tmp_path)


@pytest.mark.parametrize(
    ("fields", "message"),
    [
        ({"budget_s": 300}, "a study that differs in budget_s"),
        ({"reference": "cma-es"}, "a study that differs in reference"),
        ({"references": {"ga-uniform": "cma-es"}}, "a study that differs in references.ga-uniform"),
        ({"generations": [1]}, "a study that differs in generations"),
        ({"arms": {**SMALL["arms"], "cma-es": {"optimizer": "random"}}}, "that differs in arms.cma-es"),
        (
            {"arms": {"ga-uniform": SMALL["arms"]["ga-uniform"]}},
            "a study with more arms: add arms.cma-es again",
        ),
    ],
    ids=str,
)
def test_other_settings_of_an_existing_study_are_rejected(tmp_path, fields, message):
    begin(StudyConfig.from_dict(SMALL), tmp_path)
    with pytest.raises(CaterpillarError, match=re.escape(message)):
        begin(StudyConfig.from_dict(changed(**fields)), tmp_path)


def test_folder_with_other_files_is_rejected(tmp_path):
    (tmp_path / "notes.txt").write_text("mine")
    with pytest.raises(CaterpillarError, match="is not empty and contains no study"):
        begin(StudyConfig.from_dict(SMALL), tmp_path)


@pytest.mark.parametrize(
    ("data", "message"),
    [
        (changed(arms={}), "a study needs arms"),
        (changed(seeds=[]), "seeds must be a list of one or more distinct integers >= 0; got ()"),
        (changed(seeds=[1, 1]), "seeds must be a list of one or more distinct"),
        (changed(seeds=3), "seeds = 3 must be a list"),
        (changed(pilot_seeds=[8]), "a study has no pilot_seeds; its fields are base, arms, seeds"),
        (changed(long_seeds=[0]), "long_budget_s = 0.0 must be at least budget_s = 240"),
        (changed(references={"x": "cma-es"}), "references: 'x' must be one of the arms ga-uniform"),
        (changed(reference="best"), "reference = 'best' must be one of the arms ga-uniform"),
        (changed(budget_s=0), "budget_s = 0 must be at least 30"),
        (changed(budget_s="long"), "budget_s = 'long' must be a finite number"),
        (
            changed(generations=[]),
            "generations must be a list of one or more distinct integers >= 1; got ()",
        ),
        (changed(generations=["x"]), "an entry of generations = 'x' must be an integer"),
        (changed(arms={**SMALL["arms"], "a/b": {}}), "the name of an arm is used for a folder"),
        (changed(compare_at_s=[0]), "compare_at_s must be a list of distinct numbers between 0 and"),
        (changed(compare_at_s=[1e9]), "compare_at_s must be a list of distinct numbers between 0 and"),
        (changed(compare_at_s=[9, 9]), "compare_at_s must be a list of distinct numbers between 0 and"),
        (changed(thresholds_m=[-1]), "thresholds_m must be a list of positive numbers; got (-1,)"),
        (changed(luck=1), "a study has no luck; its fields are base, arms, seeds"),
        ({k: v for k, v in SMALL.items() if k != "seeds"}, "seeds must be a list of one or more"),
        (changed(arms={"ga-uniform": {"seed": 3}}), "remove seed, which the study sets"),
        (
            changed(arms={"ga-uniform": {"target_m": 0.1}}),
            "arms.ga-uniform: target_m = 0.1 would end runs before their budget",
        ),
        (changed(arms=3), "arms must be a table"),
        (changed(arms={"ga-uniform": 3}), "arms.ga-uniform must be a table"),
        (changed(arms={"ga-uniform": {"prior": "hopeful"}}), "arms.ga-uniform: prior = 'hopeful'"),
        (changed(arms={"ga-uniform": {"hope": 1}}), "arms.ga-uniform: a run's configuration has no"),
    ],
    ids=lambda value: value[:30] if isinstance(value, str) else "",
)
def test_unusable_studies_are_rejected(data, message):
    with pytest.raises(CaterpillarError, match=re.escape(message)):
        StudyConfig.from_dict(data)


def test_search_study_compares_with_the_uniform_genetic_algorithm():
    config = preset("search")
    reference = config.arms["ga-uniform"].config
    assert (reference.prior, reference.timing, reference.race_share) == ("uniform", "on-off", 1.0)
    assert {arm.config.timing for arm in config.arms.values()} >= {"on-off", "wave"}
    assert len(config.seeds) == 30


def test_damaged_settings_are_detected_or_harmless(tmp_path):
    config = StudyConfig.from_dict(SMALL)
    begin(config, tmp_path)
    content, rng = bytearray((tmp_path / "study.json").read_bytes()), np.random.default_rng(0)
    for place in rng.integers(0, len(content), 300):
        altered = content.copy()
        altered[place] ^= 1 << int(rng.integers(0, 7))
        (tmp_path / "study.json").write_bytes(altered)
        try:
            assert load(tmp_path) == config
        except CaterpillarError as error:
            message = str(error)
        else:
            continue
        assert "study.json" in message
    (tmp_path / "study.json").unlink()
    os.mkfifo(tmp_path / "study.json")
    with pytest.raises(CaterpillarError, match="it is not a regular file"):
        load(tmp_path)
