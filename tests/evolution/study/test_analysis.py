"""Tables and sentences of artificial runs with known results."""

from dataclasses import replace
from functools import partial

import numpy as np
import polars
import pytest

from evolution.study import statistics
from evolution.study.analysis import (
    analyse,
    format_acceleration,
    format_estimate,
    format_p,
    summarize,
)
from evolution.study.config import Cell, StudyConfig
from evolution.study.figures import draw_generations
from evolution.study.results import Results, Run, read_runs
from evolution.study.statistics import Estimate
from evolution.study.times import Threshold, _log_rank, arrivals, compare

CONFIG = StudyConfig.from_dict(
    {
        "seeds": [0, 1, 2, 3],
        "budget_s": 100,
        "generations": [2],
        "thresholds_m": [0.09],
        "base": {"ga": {"population": 5, "hall_of_fame": 1}},
        "arms": {
            "ga-uniform": {"prior": "uniform"},
            "ga-preprocessed": {},
            "random-preprocessed": {"optimizer": "random"},
        },
    }
)


def runs(arm, distances, failures=()):
    """Rows of one arm: one run per seed, one evaluation per 10 s, five evaluations per generation."""
    rows = []
    for seed, course in enumerate(distances):
        for number, distance in enumerate(course):
            rows.append(
                {
                    "arm": arm, "seed": seed, "evaluation": number,
                    "generation": number // 5, "distance_m": distance, "simulated_s": 10.0,
                    "failure": "tipped" if (seed, number) in failures else "ok",
                    "stopped": False,
                }
            )  # fmt: skip
    return polars.DataFrame(rows)


def ramp(first, step, count=10):
    return [first + step * k for k in range(count)]


@pytest.fixture(scope="module")
def analysis(few_draws):
    frame = polars.concat(
        [
            # Ends at 90, 91, 92, 93 mm; the first two reach 90 mm at 100 s and 100 s.
            runs(
                "ga-uniform", [ramp(0.0, 0.01), ramp(0.001, 0.01), ramp(0.002, 0.01), ramp(0.003, 0.01)]
            ),
            # Twice as fast: 90 mm after 50 s in all runs.
            runs("ga-preprocessed", [ramp(0.01 + d, 0.02) for d in (0.0, 0.001, 0.002, 0.003)]),
            # Never arrives within the budget; half of the evaluations of the first run fail.
            runs(
                "random-preprocessed",
                [[0.01] * 10 + [9.9]] * 4,
                failures={(0, 0), (0, 1), (0, 2), (0, 3), (0, 4), (1, 10)},
            ),
        ]
    )
    return analyse(CONFIG, Results(frame, []))


def test_arrivals_are_timed_and_censored(analysis):
    time, reached = arrivals(analysis.runs["random-preprocessed"], 0.09)
    assert time.tolist() == [100.0] * 4
    assert not reached.any()
    time, reached = arrivals(analysis.runs["ga-preprocessed"], 0.09)
    assert time.tolist() == [50.0] * 4
    assert reached.all()


def test_times_to_the_threshold(analysis):
    rows = {row.arm: row for row in analysis.times[Threshold(0.09)]}
    assert {arm: row.reached for arm, row in rows.items()} == {
        "ga-uniform": 4, "ga-preprocessed": 4, "random-preprocessed": 0,
    }  # fmt: skip
    assert rows["ga-preprocessed"].median_s.value == 50.0
    assert rows["ga-preprocessed"].median_generations.value == 1
    assert rows["ga-uniform"].median_generations.value == 2
    assert rows["random-preprocessed"].median_generations is None
    assert rows["ga-preprocessed"].running_time_s.value == 50.0
    assert rows["ga-preprocessed"].speed_up.value == pytest.approx(2.0)
    assert rows["ga-uniform"].speed_up is None
    assert rows["random-preprocessed"].running_time_s.value == np.inf
    assert rows["random-preprocessed"].speed_up.value == 0.0
    assert np.isnan(rows["random-preprocessed"].speed_up.low)
    # No other assignment of the eight runs is as extreme, except for its mirror image: 2 / C(8, 4).
    # Holm doubles it for two tests.
    assert rows["ga-preprocessed"].log_rank_p == pytest.approx(4 / 70)
    assert rows["random-preprocessed"].log_rank_p == pytest.approx(4 / 70)


def test_final_distances(analysis):
    rows = {row.arm: row for row in analysis.distances[CONFIG.budget_s]}
    assert rows["ga-uniform"].median_m.value == pytest.approx(0.0915)
    assert np.isnan(rows["ga-uniform"].median_m.low)  # four runs are too few for an interval
    assert rows["ga-uniform"].a12 is None
    assert rows["ga-preprocessed"].best_m == pytest.approx(0.193)
    assert rows["ga-preprocessed"].a12.value == 1.0
    assert rows["random-preprocessed"].a12.value == 0.0
    assert rows["random-preprocessed"].failed == pytest.approx(5 / 40)
    # 4 against 4 separate values: exactly 2 / C(8, 4), with and without ties. Holm doubles it.
    assert rows["random-preprocessed"].mann_whitney_p == pytest.approx(4 / 70)
    assert rows["ga-preprocessed"].mann_whitney_p == pytest.approx(4 / 70)


def test_generations_are_compared_within_one_algorithm(analysis):
    base, gain = analysis.gains[2]
    assert (base.arm, base.ratio, base.a12) == ("ga-uniform", None, None)
    assert base.median_m.value == pytest.approx(0.0915)
    assert (gain.arm, gain.runs, gain.a12.value) == ("ga-preprocessed", 4, 1.0)
    assert gain.ratio.value == pytest.approx(0.1915 / 0.0915)


def test_share_of_targets_never_decreases(analysis):
    assert analysis.ecdf["ga-preprocessed"][0] == 0.0
    assert analysis.ecdf["ga-preprocessed"][-1] > 0.95
    assert analysis.ecdf["random-preprocessed"][-1] < 0.1
    for share in analysis.ecdf.values():
        assert (np.diff(share) >= 0).all()


def test_summary_states_the_results(analysis):
    lines = summarize(analysis)
    text = "\n".join(lines)
    name = "ga-preprocessed"
    assert (
        f"{name}: 4 of 4 runs reached 90 mm, the median run after 1 (1 to ∞) generations; ratio of "
        "expected running times, ga-uniform to ga-preprocessed, 2.00, log-rank p 0.057." in lines
    )
    assert (
        "random-preprocessed: 0 of 4 runs reached 90 mm; ratio of expected running times, ga-uniform to "
        "random-preprocessed, 0.00, log-rank p 0.057." in lines
    )
    assert f"{name}: +109 % distance after 2 generations against ga-uniform" in text
    assert "ga-uniform: fewer than half of the runs reached the median distance of" in text
    assert "UNFINISHED" not in text


def test_reference_needs_more_generations_for_the_distance_of_the_arm(few_draws):
    config = with_own_thresholds(generations=[1, 2], seeds=[0, 1, 2, 3, 4])
    table = polars.concat(
        [runs("ga-uniform", [ramp(0.0, 0.01)] * 5), runs("ga-preprocessed", [ramp(0.03, 0.01)] * 5)]
    )
    found = analyse(config, Results(table, []))
    first, last = (found.gains[count][1].reference_generations for count in (1, 2))
    assert first == Estimate(2, 2, 2)  # 70 mm
    assert last.value == np.inf  # 120 mm
    assert (
        "ga-uniform: the median run needed 2 (2 to 2) generations to reach the median distance of "
        "ga-preprocessed after 1 generation." in summarize(found)
    )


def test_arm_that_does_not_move_is_not_compared_by_generations(few_draws):
    table = polars.concat(
        [runs("ga-uniform", [ramp(0.0, 0.01)] * 5), runs("ga-preprocessed", [[0.0] * 10] * 5)]
    )
    found = analyse(with_own_thresholds(seeds=[0, 1, 2, 3, 4]), Results(table, []))
    assert np.isnan(found.gains[2][1].reference_generations.value)
    assert not any("the median distance of ga-preprocessed" in line for line in summarize(found))


THRESHOLD = Threshold(generations=2)


def test_generations_of_different_optimizers_give_no_acceleration(few_draws):
    arms = {**CONFIG.to_dict()["arms"], "shade": {"optimizer": "shade"}}
    config = with_own_thresholds(arms=arms, references={"ga-preprocessed": "shade"})
    table = polars.concat([runs(arm, [ramp(0.01, 0.02)] * 4) for arm in ("shade", "ga-preprocessed")])
    rows = {row.arm: row for row in analyse(config, Results(table, [])).times[THRESHOLD]}
    assert rows["ga-preprocessed"].speed_up.value == 1.0
    assert rows["ga-preprocessed"].acceleration is None


def test_arm_with_half_the_generations_has_an_acceleration_of_2(few_draws):
    config = with_own_thresholds(seeds=[0, 1, 2, 3, 4])
    table = polars.concat(
        [runs("ga-uniform", [ramp(0.0, 0.01)] * 5), runs("ga-preprocessed", [ramp(0.01, 0.02)] * 5)]
    )
    base, row = analyse(config, Results(table, [])).times[THRESHOLD]
    assert row.median_generations.value == 1  # 90 mm, the reference's distance after two
    assert row.acceleration == Estimate(2, 2, 2)
    assert base.acceleration == Estimate(1, 1, 1)


def test_reference_may_reach_its_own_threshold_early(few_draws):
    table = runs("ga-uniform", [[0.09] * 10] * 5)  # all of the distance in the first generation
    config = with_own_thresholds(seeds=[0, 1, 2, 3, 4])
    found = analyse(config, Results(table, []))
    (base,) = found.times[THRESHOLD]
    assert base.acceleration == Estimate(2, 2, 2)
    assert found.gains[2][0].reference_generations == Estimate(1, 1, 1)


def test_slower_arm_has_an_upper_bound(few_draws):
    config = with_own_thresholds(seeds=[0, 1, 2, 3, 4])
    table = polars.concat(
        [runs("ga-uniform", [ramp(0.0, 0.01)] * 5), runs("ga-preprocessed", [ramp(0.0, 0.005)] * 5)]
    )
    found = analyse(config, Results(table, []))
    row = found.times[THRESHOLD][1]
    assert (row.acceleration.value, row.completed) == (0.0, 2)
    shorter = table.filter((polars.col("seed") != 0) | (polars.col("generation") == 0))
    assert analyse(config, Results(shorter, [])).times[THRESHOLD][1].completed == 1
    assert format_acceleration(THRESHOLD, row) == "< 1.00"
    assert (
        "ga-preprocessed: 0 of 5 runs reached the reference's distance after 2 generations (90 mm), the "
        "median run after more than 2 generations, < 1.00 times as fast as ga-uniform"
        in "\n".join(summarize(found))
    )


@pytest.mark.parametrize("defining", [4, 5])
def test_threshold_of_few_runs_gives_no_interval_and_no_p_value(few_draws, defining):
    config = with_own_thresholds(seeds=[0, 1, 2, 3, 4, 5])
    count = [10] * defining + [5] * (6 - defining)  # five evaluations per generation
    uniform = [ramp(0.001 * seed, 0.01, n) for seed, n in enumerate(count)]
    fast = [ramp(0.01 + 0.001 * seed, 0.02) for seed in range(6)]
    table = polars.concat([runs("ga-uniform", uniform), runs("ga-preprocessed", fast)])
    found = analyse(config, Results(table, []))
    row = found.times[THRESHOLD][1]
    assert row.defined_by == defining
    assert row.speed_up.value > 1
    has_interval = [np.isfinite(e.low) for e in (row.acceleration, row.running_time_s, row.speed_up)]
    assert has_interval == [defining == 5] * 3
    assert (row.log_rank_p is not None) == (defining == 5)
    assert ("from only 4 runs)" in "".join(summarize(found))) == (defining == 4)


def with_own_thresholds(**fields):
    """The study with thresholds from its reference, after two generations."""
    return StudyConfig.from_dict({**CONFIG.to_dict(), "thresholds_m": [], **fields})


def test_threshold_is_the_median_of_the_reference(few_draws):
    steps = (0.01, 0.02, 0.03, 0.04, 0.05)
    uniform = runs("ga-uniform", [ramp(0.0, step) for step in steps])
    fast = runs("ga-preprocessed", [ramp(step, step) for step in steps])
    config = with_own_thresholds(seeds=[0, 1, 2, 3, 4])
    found = analyse(config, Results(polars.concat([uniform, fast]), []))
    base, row = found.times[THRESHOLD]
    assert base.threshold_m == row.threshold_m == pytest.approx(0.27)  # median of 90, 180, ... 450 mm
    assert (base.reached, row.reached) == (3, 3)
    # 100 + 100 + 100 + 80 + 70 s, against 100 + 100 + 90 + 70 + 60 s
    assert row.speed_up.value == pytest.approx(450 / 420)
    # The median run needs two generations, as many as the threshold.
    assert row.acceleration.value == 1.0
    assert row.acceleration.low <= 1.0 <= row.acceleration.high
    assert base.acceleration.value == 1.0
    # Each resample has its own threshold: the interval is wider than with a fixed one.
    config = replace(config, thresholds_m=(0.27,))
    fixed = analyse(config, Results(polars.concat([uniform, fast]), []))
    assert fixed.times[Threshold(0.27)][1].acceleration is None
    other = fixed.times[Threshold(0.27)][1].speed_up
    assert other.value == row.speed_up.value
    assert other != row.speed_up
    assert "the reference's distance after 2 generations (270 mm)" in summarize(found)[0]


def test_threshold_is_unknown_until_the_reference_has_runs(few_draws):
    table = runs("ga-preprocessed", [ramp(0.0, 0.01)] * 4)
    found = analyse(with_own_thresholds(), Results(table, []))
    (row,) = found.times[THRESHOLD]
    assert np.isnan(row.threshold_m)
    assert (row.reached, row.speed_up, found.speed_ups) == (0, None, {})
    assert "after 2 generations is 0 or not known yet." in summarize(found)[0]


def test_unknown_threshold_is_not_tested(few_draws):
    arms = ("ga-uniform", "ga-preprocessed")
    table = polars.concat([runs(arm, [ramp(0.0, 0.01, 5)] * 4) for arm in arms])
    found = analyse(with_own_thresholds(), Results(table, []))  # one generation of two
    assert [row.log_rank_p for row in found.times[THRESHOLD]] == [None, None]


def test_runs_without_an_evaluation_within_the_budget_reach_nothing(few_draws):
    table = runs("ga-uniform", [[0.1] * 5] * 5).with_columns(simulated_s=200.0)
    found = analyse(CONFIG, Results(table, []))
    assert [row.reached for row in found.times[Threshold(0.09)]] == [0]
    assert [row.median_m.value for row in found.distances[CONFIG.budget_s]] == [0.0]
    assert draw_generations(found) is None


@pytest.mark.slow
def test_log_rank_test_keeps_its_level_with_the_median_of_the_reference(monkeypatch):
    monkeypatch.setattr(statistics, "PERMUTATIONS", 199)
    rng, rejected, trials = np.random.default_rng(4), 0, 400
    config = with_own_thresholds(budget_s=500, generations=[10], seeds=[0, 1, 2, 3, 4, 5])
    for _ in range(trials):
        # Two arms of six runs with equal distributions. Each run crawls at its own speed for 50 steps.
        frames = [
            runs(arm, [ramp(speed, speed, 50) for speed in rng.lognormal(-5, 0.5, 6)])
            for arm in ("ga-uniform", "ga-preprocessed")
        ]
        found = read_runs(polars.concat(frames), config)
        threshold = Threshold(generations=10)
        p = compare(config, found, partial(_log_rank, threshold, budget_s=500.0))["ga-preprocessed"]
        rejected += p <= 0.05
    assert 0.02 < rejected / trials < 0.075


def test_arm_is_compared_with_its_own_reference(few_draws):
    config = with_own_thresholds(references={"random-preprocessed": "ga-preprocessed"})
    table = polars.concat(
        [
            runs("ga-uniform", [ramp(0.0, 0.01)] * 4),
            runs("ga-preprocessed", [ramp(0.0, 0.02)] * 4),
            runs("random-preprocessed", [ramp(0.02, 0.02)] * 4),
        ]
    )
    rows = {row.arm: row for row in analyse(config, Results(table, [])).times[THRESHOLD]}
    levels_m = [row.threshold_m for row in rows.values()]
    assert levels_m == pytest.approx([0.09, 0.18, 0.18])
    assert rows["ga-preprocessed"].speed_up is None
    assert rows["random-preprocessed"].speed_up.value == pytest.approx(10 / 9)


def test_speed_up_is_known_for_distances_that_some_runs_of_the_reference_reached(analysis):
    levels_m, estimates = zip(*analysis.speed_ups["ga-preprocessed"], strict=True)
    assert levels_m[-1] == pytest.approx(0.09225)  # three quarters of the runs end below it
    assert np.diff(levels_m) == pytest.approx(0.009225)
    assert estimates[-1].value == pytest.approx(400 / (230 / 4))  # 400 s for one run of four
    assert [estimate.value for _, estimate in analysis.speed_ups["random-preprocessed"]][-1] == 0.0


def test_distances_are_compared_at_earlier_times_too(few_draws):
    config = with_own_thresholds(compare_at_s=[50, 25])
    table = polars.concat(
        [
            runs("ga-uniform", [ramp(0.0, 0.01)] * 4, failures={(0, 0), (0, 9)}),
            runs("ga-preprocessed", [ramp(0.03, 0.001)] * 4),
        ]
    )
    found = analyse(config, Results(table, []))
    assert list(found.distances) == [25, 50, 100]
    early, _, late = ({row.arm: row for row in rows} for rows in found.distances.values())
    assert early["ga-uniform"].median_m.value == pytest.approx(0.01)  # two evaluations of 10 s
    assert early["ga-uniform"].failed == pytest.approx(1 / 8)
    assert late["ga-uniform"].failed == pytest.approx(2 / 40)
    assert early["ga-preprocessed"].a12.value == 1.0
    assert late["ga-preprocessed"].a12.value == 0.0
    assert any("after 25 simulated seconds 31 mm, against 10 mm" in line for line in summarize(found))


def test_longer_runs_are_censored_at_their_own_budget(few_draws):
    config = with_own_thresholds(long_seeds=[1], long_budget_s=200)
    table = runs("ga-uniform", [ramp(0.0, 0.01), ramp(0.0, 0.01, 20), ramp(0.0, 0.01)])
    found = analyse(config, Results(table, []))
    time, reached = arrivals(found.runs["ga-uniform"], 0.15)
    assert (time.tolist(), reached.tolist()) == ([100, 160, 100], [False, True, False])
    assert found.distances[config.budget_s][0].best_m == pytest.approx(
        0.09
    )  # when the budget of all arms is spent


def test_summary_of_an_unfinished_study_names_what_is_missing(few_draws):
    table = runs("ga-uniform", [[0.01]])
    lines = summarize(analyse(CONFIG, Results(table, [Cell("ga-preprocessed", 1)])))
    assert lines[0].startswith("UNFINISHED: 1 of 12 runs are missing (ga-preprocessed seed 1)")
    assert lines[1].startswith("ga-uniform: 0 of 1 run reached 90 mm")


def test_speed_up_is_infinite_if_no_reference_run_reaches_the_threshold(few_draws):
    table = polars.concat(
        [runs("ga-uniform", [[0.01] * 10] * 4), runs("ga-preprocessed", [ramp(0.01, 0.02)] * 4)]
    )
    text = "\n".join(summarize(analyse(CONFIG, Results(table, []))))
    assert (
        "4 of 4 runs reached 90 mm, the median run after 1 (1 to ∞) generations; ratio of expected "
        "running times, ga-uniform to ga-preprocessed, ∞" in text
    )


def test_robots_that_never_move_reach_no_target(few_draws):
    still = runs("ga-uniform", [[0.0] * 10] * 4, failures={(0, 0)})
    found = analyse(
        CONFIG, Results(polars.concat([still, runs("ga-preprocessed", [[0.0] * 10] * 4)]), [])
    )
    assert found.speed_ups == {}
    assert found.ecdf["ga-uniform"][-1] == 0.0


def test_p_values_are_corrected_for_all_planned_comparisons(few_draws):
    uniform, fast = (
        runs("ga-uniform", [ramp(0.0, 0.01)] * 4),
        runs("ga-preprocessed", [ramp(0.1, 0.02)] * 4),
    )
    distances = analyse(CONFIG, Results(polars.concat([uniform, fast]), [])).distances[CONFIG.budget_s]
    # One of two comparisons has runs so far.
    assert distances[1].mann_whitney_p == pytest.approx(2 * 2 / 70)


def test_longer_runs_do_not_change_ratios_of_running_times(few_draws):
    config = with_own_thresholds(long_seeds=[0, 1, 2, 3], long_budget_s=200, thresholds_m=[0.15])
    table = polars.concat(
        [runs("ga-uniform", [ramp(0.0, 0.01, 20)] * 4), runs("ga-preprocessed", [ramp(0.06, 0.01)] * 4)]
    )
    base, row = analyse(config, Results(table, [])).times[Threshold(0.15)]
    assert (base.reached, base.median_s.value) == (0, 160.0)  # reached after the budget of all arms
    assert row.speed_up.value == np.inf


def test_racing_delays_distances_until_the_other_robots_are_stopped():
    rows = polars.DataFrame(
        {
            "generation": [0, 0, 0, 1, 1], "failure": ["ok", "tipped", "ok", "ok", "ok"],
            "stopped": [False, False, True, True, False], "distance_m": [0.1, 0.2, 0.3, 0.4, 0.5],
            "simulated_s": [30.0, 4.0, 10.0, 10.0, 30.0],
        }
    )  # fmt: skip
    run = Run.of(rows, 0, 1000.0)
    # All robots of a generation crawl for up to 10 s (24 s and 20 s), then one goes on for 20 s.
    assert run.spent_s.tolist() == [44.0, 44.0, 44.0, 64.0, 84.0]
    assert run.best_m.tolist() == [0.1, 0.1, 0.1, 0.1, 0.5]
    assert run.failure.tolist() == ["ok", "tipped", "stopped", "stopped", "ok"]
    assert (run.time_to(0.1), run.time_to(0.2)) == (44.0, 84.0)


@pytest.mark.parametrize(
    ("estimate", "text"),
    [
        (Estimate(2.0, 1.5, np.inf), "2.00 (1.50 to ∞)"),
        (Estimate(2.0, np.nan, np.nan), "2.00"),
        (Estimate(np.nan, np.nan, np.nan), "undefined"),
        (None, ""),
    ],
)
def test_estimates_are_formatted_with_their_interval(estimate, text):
    assert format_estimate(estimate) == text


def test_small_p_values_are_bounded():
    assert [format_p(p) for p in (0.0162, 0.0001, None)] == ["0.016", "< 0.001", ""]
