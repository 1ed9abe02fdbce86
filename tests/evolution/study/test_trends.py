"""Speed-ups of artificial robots with different numbers of genes follow a known power of the number."""

from dataclasses import replace

import numpy as np
import polars
import pytest

from evolution.study.analysis import analyse, summarize
from evolution.study.config import StudyConfig, preset
from evolution.study.results import Results


def course(arm, evaluations, runs=5, distance_m=0.09):
    """Return runs that reach a distance after a number of evaluations of 10 s."""
    before = np.arange(40) < evaluations - 1
    rows = {
        "arm": arm, "evaluation": np.arange(40), "generation": np.arange(40) // 4, "failure": "ok",
        "stopped": False, "simulated_s": 10.0, "distance_m": np.where(before, 0.0, distance_m),
    }  # fmt: skip
    return polars.concat(polars.DataFrame(rows).with_columns(seed=seed) for seed in range(runs))


def compare(evaluations, runs=None):
    """Compare robots with 4 and 8 segments; `evaluations` has those of each arm to 90 mm.

    `runs` has the number of runs of arms with fewer than five.
    """
    arms = {
        f"{count}-{prior}": {"prior": prior, "physics": {"num_segments": count}}
        for count in (8, 4)
        for prior in ("uniform", "body")
    }
    config = StudyConfig.from_dict(
        {
            "seeds": list(range(5)), "budget_s": 400, "thresholds_m": [0.05, 0.09],
            "arms": {**arms, "other": {"optimizer": "random"}}, "reference": "4-uniform",
            "references": {"4-body": "4-uniform", "8-body": "8-uniform", "other": "4-uniform"},
        }
    )  # fmt: skip
    table = polars.concat(
        [course(arm, count, (runs or {}).get(arm, 5)) for arm, count in evaluations.items()]
    )
    return analyse(config, Results(table, []))


def test_speed_ups_of_2_and_4_give_a_power_law(few_draws):
    found = compare({"4-uniform": 20, "4-body": 10, "8-uniform": 40, "8-body": 10, "other": 5})
    (trend,) = found.trends
    assert trend.genes == (20, 36)
    assert [estimate.value for estimate in trend.speed_ups] == pytest.approx([2.0, 4.0])
    assert trend.speed_up_per_doubling == pytest.approx([2 ** (1 / np.log2(36 / 20))] * 3)
    assert [estimate.value for estimate in trend.distances] == [1.0, 1.0]  # 90 mm in all runs
    assert trend.distance_per_doubling == (1.0, 1.0, 1.0)
    assert summarize(found)[-1] == (
        "ga, prior body, timing on-off, genome shared: when the number of genes doubles (20 to 36 "
        "genes), the ratio of the median distances changes by a factor of 1.00 (1.00 to 1.00), and the "
        "ratio of expected running times by a factor of 2.26 (2.26 to 2.26)."
    )


def test_trends_have_an_intercept_for_each_kind_of_genome_or_robot(few_draws):
    arms, references, rows = {}, {}, []
    # The prior multiplies the distance by a factor of the kind of genome, and by 2 with each doubling.
    robots = [("shared", 4, 20, 1.5), ("shared", 8, 36, 1.5), ("full", 4, 32, 3.0), ("full", 8, 64, 3.0)]
    for genome, segments, genes, factor in robots:
        uniform, body = (f"{segments}-{genome}-{prior}" for prior in ("uniform", "body"))
        for arm, prior in ((uniform, "uniform"), (body, "body")):
            arms[arm] = {"prior": prior, "genome": genome, "physics": {"num_segments": segments}}
        references[body] = uniform
        rows += [
            course(uniform, 5, distance_m=0.01),
            course(body, 5, distance_m=0.01 * factor * genes / 20),
        ]
    config = StudyConfig.from_dict(
        {
            "seeds": list(range(5)), "budget_s": 400, "thresholds_m": [0.01], "arms": arms,
            "reference": "4-shared-uniform", "references": references,
        }
    )  # fmt: skip
    trends = {
        t.name.split(", ")[-1]: t for t in analyse(config, Results(polars.concat(rows), [])).trends
    }
    assert {name: (trend.genes, trend.groups) for name, trend in trends.items()} == {
        "genome shared": ((20, 36), 1),
        "genome full": ((32, 64), 1),
        "all genomes": ((20, 32, 36, 64), 2),
        "same robots": ((20, 32, 36, 64), 2),
    }
    for name in ("genome shared", "genome full", "all genomes"):
        assert trends[name].distance_per_doubling == pytest.approx([2.0] * 3)
    # From "shared" to "full", the ratio also doubles because of the kind of the genome.
    low, high = (1 + 1 / np.log2(ratio) for ratio in (64 / 36, 32 / 20))
    assert 2**low < trends["same robots"].distance_per_doubling.value < 2**high


def test_trend_of_thresholds_of_few_runs_has_no_interval(few_draws):
    evaluations = {"4-uniform": 20, "4-body": 10, "8-uniform": 40, "8-body": 10}
    fixed = compare(evaluations)
    config = replace(fixed.config, thresholds_m=(), generations=(10,))
    table = polars.concat([course(arm, count) for arm, count in evaluations.items()])
    is_late = (polars.col("arm") == "8-uniform") & (polars.col("generation") == 9)
    few = table.filter(~(is_late & (polars.col("seed") == 0)))
    for rows, has_interval in ((table, True), (few, False)):
        (trend,) = analyse(config, Results(rows, [])).trends
        assert np.isfinite(trend.speed_up_per_doubling.low) == has_interval
        assert np.isfinite(trend.distance_per_doubling.low)


def test_trend_is_known_while_an_arm_lacks_runs(few_draws):
    evaluations = {"4-uniform": 20, "4-body": 10, "8-uniform": 40, "8-body": 10}
    (trend,) = compare(evaluations, {"4-body": 2, "8-uniform": 3}).trends
    assert trend.speed_up_per_doubling.value == pytest.approx(2 ** (1 / np.log2(36 / 20)))


def test_robot_that_never_arrives_bounds_the_trend(few_draws):
    (trend,) = compare({"4-uniform": 20, "4-body": 20, "8-uniform": 99, "8-body": 10}).trends
    assert trend.speed_ups[1].value == np.inf
    assert trend.speed_up_per_doubling.value == pytest.approx(100 ** (1 / np.log2(36 / 20)))


def test_trend_is_unknown_if_both_arms_of_a_robot_never_arrive(few_draws):
    (trend,) = compare({"4-uniform": 20, "4-body": 20, "8-uniform": 99, "8-body": 99}).trends
    assert np.isnan(trend.speed_up_per_doubling.value)
    assert np.isnan(trend.distance_per_doubling.value)


def test_one_robot_has_no_trend(few_draws):
    assert compare({"4-uniform": 20, "4-body": 20, "other": 10}).trends == []


@pytest.mark.parametrize("name", ["paper", "ablation", "conjecture", "search", "worlds", "pilot"])
def test_arms_of_every_preset_can_be_analysed(name, few_draws):
    config, rows = preset(name), []
    for arm in config.arms:
        for seed in (0, 1):
            rows += [
                {
                    "arm": arm, "seed": seed, "evaluation": number, "generation": number // 10,
                    "distance_m": 0.001 * number, "simulated_s": 30.0, "failure": "ok", "stopped": False,
                }
                for number in range(20)
            ]  # fmt: skip
    found = analyse(config, Results(polars.DataFrame(rows), []))
    assert {row.arm for row in found.distances[config.budget_s]} == set(config.arms)
