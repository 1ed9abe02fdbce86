"""Configurations of runs: defaults, distributions, optimizers and errors."""

from dataclasses import replace

import numpy as np
import pytest

from caterpillar_env.errors import CaterpillarError
from caterpillar_env.physics import Physics
from evolution.config import RunConfig
from evolution.optimizers.cma_es import CmaConfig, CmaEs
from evolution.optimizers.ga import GaConfig
from evolution.optimizers.random_search import RandomSearch
from evolution.optimizers.shade import Shade, ShadeConfig
from evolution.priors.distributions import ClippedGaussian, Uniform
from evolution.priors.gait import advance


def test_default_configuration_matches_the_paper():
    config = RunConfig()
    assert (config.generations, config.ga.population, config.ga.hall_of_fame) == (50, 200, 10)
    assert (config.prior, config.floor_ratio) == ("body", 3.0)
    assert config.evaluations() == 9_510  # 200 + 49 * 190
    assert RunConfig(generations=114).evaluations() == 21_670


def test_prior_decides_the_distributions():
    assert set(RunConfig(prior="uniform").distributions()) == {Uniform()}
    prepared = RunConfig().distributions()
    assert sum(isinstance(d, ClippedGaussian) for d in prepared) == 6
    assert len(prepared) == 20


def kinds(config, use="init"):
    return {type(d) for d in config.distributions(use)}


def test_prior_can_apply_to_initialization_or_mutation_only():
    assert kinds(RunConfig(prior_use="init")) == {Uniform, ClippedGaussian}
    assert kinds(RunConfig(prior_use="init"), "mutation") == {Uniform}
    assert kinds(RunConfig(prior_use="mutation")) == {Uniform}
    assert kinds(RunConfig(prior_use="mutation"), "mutation") == {Uniform, ClippedGaussian}


@pytest.mark.parametrize(("use", "informed"), [("init", 0), ("mutation", 1)])
def test_optimizer_gets_the_prior_for_initialization_or_mutation(use, informed):
    everything_mutates = GaConfig(population=300, hall_of_fame=1, mutation_rate=1.0)
    optimizer = RunConfig(prior_use=use, ga=everything_mutates).make_optimizer()
    asked = [optimizer.ask()]
    optimizer.tell(asked[0], np.ones(300))
    asked.append(optimizer.ask())
    means = [genomes[:, 0].mean() for genomes in asked]  # leg separation; its prior peaks at 1
    assert means[informed] > 0.58
    assert means[1 - informed] == pytest.approx(0.5, abs=0.06)


def test_mirrored_prior_puts_every_peak_at_the_other_end():
    pairs = zip(
        RunConfig().distributions(), RunConfig(prior_control="mirrored").distributions(), strict=True
    )
    for one, other in pairs:
        if one == Uniform():
            assert other == Uniform()
        else:
            assert (other.mu, other.sigma) == (1 - one.mu, one.sigma)


def test_clamped_prior_keeps_peaks_and_widths():
    clamped = RunConfig(clipping="clamped").distributions()
    for one, other in zip(RunConfig().distributions(), clamped, strict=True):
        if one != Uniform():
            assert other == ClippedGaussian(one.mu, one.sigma, "clamped")


def test_name_selects_the_optimizer():
    assert isinstance(RunConfig(optimizer="cma-es").make_optimizer(), CmaEs)
    assert isinstance(RunConfig(optimizer="random").make_optimizer(), RandomSearch)
    assert isinstance(RunConfig(optimizer="shade").make_optimizer(), Shade)


def test_configurations_without_a_world_have_flat_ground():
    data = RunConfig(seed=3).to_dict()
    assert data["physics"].pop("world") == {"kind": "flat"}
    assert RunConfig.from_dict(data) == RunConfig(seed=3)


def test_candidates_of_shade_are_chosen_by_their_advance():
    config = RunConfig(optimizer="shade", timing="wave", prior="gait", shade=ShadeConfig(8, 6))
    plain = replace(config, shade=ShadeConfig(8))
    one, many = (
        advance(*config.encoding.decode(each.make_optimizer().ask()), config.physics)
        for each in (plain, config)
    )
    assert np.median(many) > np.quantile(one, 0.75)


def test_configuration_round_trips_through_json():
    cma, physics = CmaConfig(cma_population=9), Physics(num_segments=2)
    config = RunConfig(optimizer="cma-es", prior="uniform", cma=cma, physics=physics)
    assert RunConfig.from_dict(config.to_dict()) == config
    with pytest.raises(CaterpillarError, match="a run's configuration has no luck; its fields are seed"):
        RunConfig.from_dict({**config.to_dict(), "luck": 1})


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"seed": -1}, "seed = -1"),
        ({"optimizer": "hopes"}, "optimizer = 'hopes' must be one of ga, cma-es, shade, random"),
        ({"optimizer": "cma-es", "prior_use": "init"}, "prior_use = 'init' needs the genetic algorithm"),
        ({"race_share": 0.0}, "race_share = 0.0 must lie in"),
        ({"race_share": 0.5, "race_periods": 6}, "race_periods = 6 must be at least 1, and"),
        ({"timing": "wave", "genome": "full"}, "choose timing = 'phase' or genome = 'shared'"),
        ({"genome": "half"}, "genome = 'half' must be one of shared, full, per-segment"),
        ({"objective": "speed"}, "objective = 'speed'"),
        ({"clipping": "cut"}, "clipping = 'cut'"),
        ({"sampling": "grid"}, "sampling = 'grid'"),
        ({"sampling": "sobol", "optimizer": "shade"}, "sampling = 'sobol' needs random search"),
        ({"prior": "uniform", "prior_control": "mirrored"}, "needs another prior than 'uniform'"),
        ({"generations": 0}, "generations = 0"),
        *(
            ({"target_m": value}, f"target_m = {value!r} must be a positive number")
            for value in (-0.1, 0)
        ),
        *(
            ({"target_m": value}, f"target_m = {value!r} must be a finite number")
            for value in (np.nan, np.inf, "far", True)
        ),
        ({"budget_s": 0.0}, "budget_s = 0.0 must be a positive number"),
        ({"budget_s": "long"}, "budget_s = 'long' must be a finite number"),
        ({"generations": -5}, "generations = -5"),
        ({"prior": "hopeful"}, "prior = 'hopeful'"),
        ({"floor_ratio": 1.0}, "floor_ratio = 1.0"),
        ({"floor_ratio": np.inf}, "floor_ratio = inf"),
        ({"failed_fitness": float("inf")}, "failed_fitness = inf"),
        ({"failed_fitness": np.nan}, "failed_fitness = nan"),
        ({"failed_fitness": np.inf}, "failed_fitness = inf"),
        ({"gait_period_s": 0.0}, "gait_period_s"),
        ({"gait_period_s": -3.0}, "gait_period_s"),
        ({"gait_period_s": 0.25}, "gait_period_s"),
        ({"gait_period_s": np.nan}, "gait_period_s"),
        ({"gait_period_s": np.inf}, "gait_period_s"),
    ],
    ids=str,
)
def test_invalid_settings_raise_a_one_line_error(settings, message):
    with pytest.raises(CaterpillarError, match=message) as refused:
        RunConfig(**settings)
    assert "\n" not in str(refused.value)


def first_population(**settings):
    return RunConfig(**settings).make_optimizer().ask()


def test_seed_changes_the_genomes_but_not_the_robot():
    assert not np.array_equal(first_population(seed=0), first_population(seed=1))
    one, two = RunConfig(seed=0).physics.strengths(), RunConfig(seed=1).physics.strengths()
    assert one.tolist() == two.tolist()


def test_arms_with_the_same_seed_draw_the_same_uniform_genes():
    prepared, uniform = first_population(), first_population(prior="uniform")
    free = [3, 4, *range(8, 20)]  # mass, joint limit, timings
    peaked = [0, 1, 2, 5, 6, 7]
    np.testing.assert_array_equal(prepared[:, free], uniform[:, free])
    assert not np.any(prepared[:, peaked] == uniform[:, peaked])
    # Each draw uses one uniform number: peaked genes are equal quantiles of another distribution.
    order = np.argsort(uniform[:, 0])
    assert np.all(np.diff(prepared[order, 0]) > 0)
