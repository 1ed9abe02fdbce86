"""Statistics of published and hand-calculated examples."""

import numpy as np
import pytest
from scipy import stats

from evolution.study import statistics

# Remission of leukaemia in weeks, Freireich et al. 1963: a textbook example of censored times.
TREATED = np.array([6, 6, 6, 6, 7, 9, 10, 10, 11, 13, 16, 17, 19, 20, 22, 23, 25, 32, 32, 34, 35.0])
RELAPSED = np.array([1, 1, 1, 0, 1, 0, 1, 0, 0, 1, 1, 0, 0, 0, 1, 1, 0, 0, 0, 0, 0], dtype=bool)
PLACEBO = np.array([1, 1, 2, 2, 3, 4, 4, 5, 5, 8, 8, 8, 8, 11, 11, 12, 12, 15, 17, 22, 23.0])
ALL = np.ones(21, dtype=bool)


def test_kaplan_meier_of_the_textbook_example():
    curve = statistics.kaplan_meier(TREATED, RELAPSED)
    at = {6: 0.857, 7: 0.807, 10: 0.753, 13: 0.690, 16: 0.627, 22: 0.538, 23: 0.448}
    for week, share in at.items():
        (place,) = np.flatnonzero(curve.time == week)
        assert curve.share[place] == pytest.approx(share, abs=5e-4)
        assert curve.low[place] < share < curve.high[place]
    # Greenwood's log-log interval at week 6, calculated by hand.
    spread = np.sqrt(3 / (21 * 18)) / abs(np.log(18 / 21))
    expected = (18 / 21) ** np.exp(np.array([1, -1]) * stats.norm.ppf(0.975) * spread)
    place = int(np.flatnonzero(curve.time == 6)[0])
    assert [curve.low[place], curve.high[place]] == pytest.approx(expected)
    assert curve.median.value == 23
    assert curve.median.low < 23 < curve.median.high == np.inf
    assert statistics.kaplan_meier(PLACEBO, ALL).median.value == 8


def test_median_has_no_interval_if_no_run_reaches_the_threshold():
    median = statistics.kaplan_meier(np.array([5.0, 5.0]), np.zeros(2, dtype=bool)).median
    assert median.value == np.inf
    assert np.isnan([median.low, median.high]).all()


def test_upper_bound_of_the_median_is_infinite_for_few_runs():
    curve = statistics.kaplan_meier(np.array([10.0, 20.0, 30.0]), np.ones(3, dtype=bool))
    assert curve.median == (20.0, 10.0, np.inf)
    assert curve.high[-1] == curve.high[-2] > 0.5


def test_median_is_infinite_if_most_runs_are_censored():
    curve = statistics.kaplan_meier(np.array([5.0, 5.0, 3.0]), np.array([False, False, True]))
    assert curve.median.value == np.inf


def test_median_of_the_survival_curve():
    assert statistics.find_median(TREATED, RELAPSED) == 23
    assert statistics.find_median(PLACEBO, ALL) == 8
    assert statistics.find_median(np.array([5.0, 5.0, 3.0]), np.array([False, False, True])) == np.inf


@pytest.mark.parametrize("seed", range(5))
def test_both_medians_agree_if_runs_are_censored_when_others_arrive(seed):
    rng = np.random.default_rng(seed)
    time, reached = rng.integers(1, 4, 9).astype(float), rng.random(9) < 0.6
    assert statistics.find_median(time, reached) == statistics.kaplan_meier(time, reached).median.value


def test_log_rank_of_the_textbook_example():
    time, reached = np.concatenate([TREATED, PLACEBO]), np.concatenate([RELAPSED, ALL])
    treated = np.arange(42) < 21
    found = statistics.log_rank_statistic(time, reached, treated)
    assert found**2 == pytest.approx(16.79, abs=5e-3)
    assert found == pytest.approx(statistics.log_rank_statistic(time, reached, ~treated))
    both = stats.CensoredData.right_censored
    theirs = stats.logrank(both(TREATED, ~RELAPSED), both(PLACEBO, ~ALL))
    assert found == pytest.approx(abs(theirs.statistic))


@pytest.mark.parametrize("reached", [[False] * 4, [True] * 4])
def test_log_rank_is_zero_if_no_run_or_all_runs_arrive_at_once(reached):
    first = np.array([True, True, False, False])
    assert statistics.log_rank_statistic(np.ones(4), np.array(reached), first) == 0.0


def test_permutations_are_exact_for_small_groups():
    values = np.array([5.0, 6.0, 7.0, 1.0, 2.0, 3.0])

    def difference(first):
        return abs(values[first].mean() - values[~first].mean())

    assert statistics.permutation_p(difference, 3, 6) == pytest.approx(2 / 20)
    assert statistics.permutation_p(lambda first: 0.0, 3, 6) == 1.0


def test_random_permutations_agree_with_the_exact_test(monkeypatch):
    values = np.array([1.0, 4.0, 3.0, 8.0, 6.0, 2.0, 7.0, 9.0, 12.0, 10.0])

    def difference(first):
        return abs(values[first].mean() - values[~first].mean())

    exact = statistics.permutation_p(difference, 5, 10)
    monkeypatch.setattr(statistics, "PERMUTATIONS", 250)  # fewer than the 252 assignments
    assert statistics.permutation_p(difference, 5, 10) == pytest.approx(exact, abs=0.04)


def test_random_permutations_never_give_a_p_value_of_0(monkeypatch):
    monkeypatch.setattr(statistics, "PERMUTATIONS", 199)
    p = statistics.permutation_p(lambda first: float(first[:20].all()), 20, 40)
    assert p == 1 / 200


def test_mann_whitney_is_exact_for_small_groups_with_ties():
    assert statistics.mann_whitney(np.arange(4.0), np.arange(4.0) + 9) == pytest.approx(2 / 70)
    assert statistics.mann_whitney(np.zeros(3), np.ones(3)) == pytest.approx(2 / 20)
    assert statistics.mann_whitney(np.arange(30.0), np.arange(30.0) + 30) < 1e-16
    assert statistics.mann_whitney(np.zeros(12), np.repeat([0.0, 1.0], 6)) == pytest.approx(
        stats.mannwhitneyu(np.zeros(12), np.repeat([0.0, 1.0], 6)).pvalue
    )


def test_expected_running_time_includes_unsuccessful_runs():
    time, reached = np.array([10.0, 20.0, 30.0]), np.array([True, False, True])
    assert statistics.expected_running_time(time, reached) == 30.0
    assert statistics.expected_running_time(time, ~ALL[:3]) == np.inf


def test_speed_up_is_the_ratio_of_expected_running_times():
    yes = np.ones(2, dtype=bool)
    fast, slow = np.array([1.0, 3.0]), np.array([6.0, 10.0])
    assert statistics.speed_up(fast, yes, slow, yes) == 4.0
    assert statistics.speed_up(fast, yes, slow, ~yes) == np.inf
    assert np.isnan(statistics.speed_up(fast, ~yes, slow, ~yes))


def test_bootstrap_of_a_mean_agrees_with_students_interval():
    values = np.random.default_rng(0).normal(5.0, 2.0, 60)
    found = statistics.bootstrap(lambda x: float(x.mean()), (values,))
    low, high = stats.t.interval(0.95, 59, values.mean(), stats.sem(values))
    assert found.value == values.mean()
    assert found.low == pytest.approx(low, abs=0.08)
    assert found.high == pytest.approx(high, abs=0.08)


def test_bootstrap_resamples_the_arrays_of_a_group_together_and_is_seeded(few_draws):
    def paired(a, b, c):
        assert np.array_equal(b, 10 * a)
        assert len(c) == 6
        return float(a.sum())

    groups = [(np.arange(5.0), 10 * np.arange(5.0)), (np.zeros(6),)]
    one, two = (statistics.bootstrap(paired, *groups) for _ in range(2))
    assert one == two


def test_bootstrap_of_fewer_than_five_runs_has_no_interval():
    found = statistics.median(np.array([1.0, 2.0, 3.0, 4.0]))
    assert found.value == 2.5
    assert np.isnan([found.low, found.high]).all()


@pytest.mark.slow
@pytest.mark.parametrize(("runs", "least"), [(5, 0.85), (10, 0.88), (30, 0.91)])
def test_bootstrap_intervals_nearly_have_their_nominal_coverage(runs, least, monkeypatch):
    monkeypatch.setattr(statistics, "RESAMPLES", 499)
    rng, covered, truth = np.random.default_rng(3), 0, np.exp(0.5**2 / 2)
    for _ in range(500):
        time, reached = rng.lognormal(0.0, 0.5, runs), np.ones(runs, dtype=bool)
        found = statistics.bootstrap(statistics.expected_running_time, (time, reached))
        covered += found.low <= truth <= found.high
    assert least < covered / 500 < 0.99


def test_bootstrap_of_an_infinite_statistic_has_no_interval():
    time, never = np.array([10.0, 20.0]), np.array([False, False])
    found = statistics.bootstrap(statistics.expected_running_time, (time, never))
    assert found.value == np.inf
    assert np.isnan([found.low, found.high]).all()


def test_bootstrap_leaves_out_undefined_resamples():
    once = np.array([True, False, False, False, False])
    found = statistics.bootstrap(
        statistics.speed_up,
        (np.array([5.0, 10.0, 10.0, 10.0, 10.0]), once),
        (np.array([8.0, 10.0, 10.0, 10.0, 10.0]), once),
    )
    assert found.value == pytest.approx(48 / 45)
    assert (found.low, found.high) == (0.0, np.inf)


def test_a12_counts_wins_and_half_the_ties():
    assert statistics.a12(np.array([1.0, 2.0, 3.0]), np.array([2.0, 0.0])).value == pytest.approx(
        4.5 / 6
    )


def test_a12_of_separate_groups_has_an_interval():
    high = statistics.a12(np.arange(10.0) + 100, np.arange(10.0))
    low = statistics.a12(np.arange(10.0), np.arange(10.0) + 100)
    assert (high.value, high.high) == (1.0, 1.0)
    assert 0.6 < high.low < 0.95
    assert low.high == pytest.approx(1 - high.low)
    assert statistics.a12(np.ones(4), np.ones(4)).value == 0.5


@pytest.mark.parametrize("shift", [0.0, 1.0, 2.0])
def test_a12_intervals_have_their_nominal_coverage(shift):
    rng = np.random.default_rng(7)
    truth = stats.norm.cdf(shift / np.sqrt(2))
    covered = 0
    for _ in range(1000):
        found = statistics.a12(rng.normal(shift, 1, 15), rng.normal(0, 1, 15))
        covered += found.low <= truth <= found.high
    assert 0.93 <= covered / 1000 <= 0.985


def test_holm_of_a_worked_example():
    p = {"a": 0.01, "b": 0.04, "c": 0.03, "d": 0.005}
    assert statistics.holm(p) == pytest.approx({"a": 0.03, "b": 0.06, "c": 0.06, "d": 0.02})
    assert statistics.holm({"a": 0.9, "b": 0.8}) == pytest.approx({"a": 1.0, "b": 1.0})
    assert statistics.holm({}) == {}
    assert statistics.holm({"a": 0.01, "b": 0.02}, planned=5) == pytest.approx({"a": 0.05, "b": 0.08})


def test_target_ecdf_counts_pairs():
    times = np.array([[1.0, 5.0], [2.0, np.inf]])
    grid = np.array([0.5, 1.0, 2.0, 9.0])
    assert statistics.target_ecdf(times, grid) == pytest.approx([0, 0.25, 0.5, 0.75])


# Other packages. They are too large for the extra `test`: pip install lifelines rliable


def draw_censored(seed, scale, runs=21):
    """Times of runs, some censored at one of two budgets. The share is never exactly one half."""
    rng = np.random.default_rng(seed)
    time = np.ceil(rng.exponential(scale, runs))  # with ties
    budget = np.where(np.arange(runs) % 3 == 0, 120.0, 60.0)
    return np.minimum(time, budget), time <= budget


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize("scale", [15.0, 40.0, 90.0])
def test_survival_agrees_with_lifelines(scale):
    lifelines = pytest.importorskip("lifelines")
    from lifelines.statistics import logrank_test
    from lifelines.utils import median_survival_times

    for seed in range(10):
        time, reached = draw_censored(seed, scale)
        ours = statistics.kaplan_meier(time, reached)
        theirs = lifelines.KaplanMeierFitter().fit(time, reached)
        inside = (ours.share > 0) & (ours.share < 1)
        at = ours.time[inside]
        assert ours.share[inside] == pytest.approx(theirs.predict(at).to_numpy())
        band = theirs.confidence_interval_.loc[at].to_numpy().T
        assert ours.low[inside] == pytest.approx(band[0])
        assert ours.high[inside] == pytest.approx(band[1])
        assert ours.median.value == theirs.median_survival_time_
        low, high = median_survival_times(theirs.confidence_interval_).to_numpy()[0]
        assert ours.median.low == low
        if (
            ours.share[-1] > 0
        ):  # at a share of 0, the upper bound of lifelines is 0, and ours keeps the last defined bound
            assert ours.median.high == high
        other = draw_censored(100 + seed, 40.0)
        expected = logrank_test(time, other[0], reached, other[1]).test_statistic
        first = np.arange(2 * len(time)) < len(time)
        both = (np.concatenate(pair) for pair in zip((time, reached), other, strict=True))
        assert statistics.log_rank_statistic(*both, first) ** 2 == pytest.approx(expected)


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore")
def test_intervals_agree_with_rliable(monkeypatch):
    monkeypatch.setattr(statistics, "RESAMPLES", 4_999)
    library = pytest.importorskip("rliable.library")
    from rliable import metrics

    rng = np.random.default_rng(5)
    a, b = rng.lognormal(0.0, 0.4, 30), rng.lognormal(0.3, 0.4, 30)
    value = metrics.probability_of_improvement(a[:, None], b[:, None])
    assert statistics.a12(a, b).value == pytest.approx(value)
    points, intervals = library.get_interval_estimates(
        {"a": a[:, None]}, lambda scores: np.array([np.median(scores)]), reps=5000
    )
    ours = statistics.bootstrap(lambda x: float(np.median(x)), (a,))
    assert ours.value == points["a"][0]
    assert [ours.low, ours.high] == pytest.approx(intervals["a"][:, 0], rel=0.02)
    _, pairs = library.get_interval_estimates(
        {"a, b": (a[:, None], b[:, None])},
        lambda *scores: np.array([metrics.probability_of_improvement(*scores)]),
        reps=2000,
    )
    newcombe = statistics.a12(a, b)
    assert [newcombe.low, newcombe.high] == pytest.approx(pairs["a, b"][:, 0], abs=0.05)
