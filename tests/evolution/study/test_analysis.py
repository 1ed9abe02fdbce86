"""Tables and sentences of artificial runs with known results."""

import numpy as np
import polars
import pytest
from scipy import stats

from evolution.study import statistics
from evolution.study.analysis import analyse, format_estimate, format_p, summarize
from evolution.study.config import Cell, StudyConfig
from evolution.study.results import Results
from evolution.study.statistics import Estimate
from evolution.study.times import Threshold, arrivals

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
    # Four of eight runs arrive at once, all of one arm: (4 - 2)^2 / (4 / 7). Doubled for two tests.
    twice = 2 * stats.chi2.sf(7, 1)
    assert rows["ga-preprocessed"].log_rank_p == pytest.approx(twice)
    assert rows["random-preprocessed"].log_rank_p == pytest.approx(twice)


def test_final_distances(analysis):
    rows = {row.arm: row for row in analysis.distances[CONFIG.budget_s]}
    assert rows["ga-uniform"].median_m.value == pytest.approx(0.0915)
    assert 0.09 <= rows["ga-uniform"].median_m.low < 0.0915 < rows["ga-uniform"].median_m.high <= 0.093
    assert rows["ga-uniform"].a12 is None
    assert rows["ga-preprocessed"].best_m == pytest.approx(0.193)
    assert rows["ga-preprocessed"].a12.value == 1.0
    assert rows["random-preprocessed"].a12.value == 0.0
    assert rows["random-preprocessed"].failed == pytest.approx(5 / 40)
    # 4 against 4 separate values: exactly 2 / C(8, 4). The other arm has ties, so its p value is a
    # normal approximation. It is the smaller p value. Holm's correction doubles it for both arms.
    tied = 2 * stats.norm.sf((8 - 0.5) / np.sqrt(16 / 12 * (9 - 60 / 56)))
    assert tied < 2 / 70
    assert rows["random-preprocessed"].mann_whitney_p == pytest.approx(2 * tied)
    assert rows["ga-preprocessed"].mann_whitney_p == pytest.approx(2 * tied)


def test_generations_are_compared_within_one_algorithm(analysis):
    base, gain = analysis.gains[2]
    assert (base.arm, base.ratio, base.a12) == ("ga-uniform", None, None)
    assert base.median_m.value == pytest.approx(0.0915)
    assert (gain.arm, gain.runs, gain.a12.value) == ("ga-preprocessed", 4, 1.0)
    assert gain.ratio.value == pytest.approx(0.1915 / 0.0915)
    assert gain.ratio.low < gain.ratio.value < gain.ratio.high


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
        f"{name}: 4 of 4 runs reach 90 mm, the median run after 1 (1 to ∞) generations; speed-up over "
        "ga-uniform 2.00 (2.00 to 2.00), log-rank p 0.016." in lines
    )
    assert (
        "random-preprocessed: 0 of 4 runs reach 90 mm; speed-up over ga-uniform 0.00, log-rank p" in text
    )
    assert f"{name}: +109 % distance after 2 generations against ga-uniform" in text
    assert "UNFINISHED" not in text


THRESHOLD = Threshold(generations=2)


def with_own_thresholds(**fields):
    """The study with thresholds from its reference, after two generations."""
    return StudyConfig.from_dict({**CONFIG.to_dict(), "thresholds_m": [], **fields})


def test_threshold_is_the_median_of_the_reference(few_draws):
    uniform = runs("ga-uniform", [ramp(0.0, step) for step in (0.01, 0.02, 0.03, 0.04)])
    fast = runs("ga-preprocessed", [ramp(step, step) for step in (0.02, 0.03, 0.04, 0.05)])
    found = analyse(with_own_thresholds(), Results(polars.concat([uniform, fast]), []))
    base, row = found.times[THRESHOLD]
    assert base.threshold_m == row.threshold_m == pytest.approx(0.225)  # median of 90, 180, 270, 360 mm
    assert (base.reached, row.reached) == (2, 3)
    # 100 + 100 + 90 + 70 s, against 100 + 80 + 60 + 50 s
    assert row.speed_up.value == pytest.approx(360 / 2 / (290 / 3))
    # Each resample has its own threshold: the interval is wider than with a fixed one.
    fixed = analyse(
        with_own_thresholds(thresholds_m=[0.225]), Results(polars.concat([uniform, fast]), [])
    )
    other = fixed.times[Threshold(0.225)][1].speed_up
    assert other.value == row.speed_up.value
    assert other != row.speed_up
    assert "the reference's distance after 2 generations (225 mm)" in summarize(found)[0]


def test_threshold_is_unknown_until_the_reference_has_runs(few_draws):
    table = runs("ga-preprocessed", [ramp(0.0, 0.01)] * 4)
    found = analyse(with_own_thresholds(), Results(table, []))
    (row,) = found.times[THRESHOLD]
    assert np.isnan(row.threshold_m)
    assert (row.reached, row.speed_up, found.speed_ups) == (0, None, {})
    assert "after 2 generations is 0 or not known yet." in summarize(found)[0]


@pytest.mark.slow
def test_log_rank_test_keeps_its_level_with_the_median_of_the_reference():
    rng, rejected, trials = np.random.default_rng(4), 0, 2000
    for _ in range(trials):
        # Two groups of ten runs with equal distributions. Each crawls at its own speed for 50 steps.
        speed = rng.lognormal(sigma=0.5, size=(2, 10))
        threshold = 50 * np.median(speed[0])
        time = np.ceil(threshold / speed)
        reached = time <= 50
        time = np.minimum(time, 50.0)
        rejected += statistics.log_rank(time[0], reached[0], time[1], reached[1]) < 0.05
    assert 0.02 < rejected / trials < 0.07


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


def test_speed_up_is_known_for_all_distances_that_the_reference_reached(analysis):
    levels_m, estimates = zip(*analysis.speed_ups["ga-preprocessed"], strict=True)
    assert levels_m[-1] == pytest.approx(0.093)
    assert np.diff(levels_m) == pytest.approx(0.093 / 10)
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


def test_speed_up_is_infinite_if_no_reference_run_reaches_the_threshold(few_draws):
    table = polars.concat(
        [runs("ga-uniform", [[0.01] * 10] * 4), runs("ga-preprocessed", [ramp(0.01, 0.02)] * 4)]
    )
    text = "\n".join(summarize(analyse(CONFIG, Results(table, []))))
    assert (
        "4 of 4 runs reach 90 mm, the median run after 1 (1 to ∞) generations; speed-up over "
        "ga-uniform ∞" in text
    )


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
