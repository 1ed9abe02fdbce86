"""Figures and page of a study show the right numbers in the right units."""

import re
from dataclasses import replace

import numpy as np
import pytest

from evolution.study import figures, report
from evolution.study.analysis import Analysis, Distances, Gain
from evolution.study.config import StudyConfig
from evolution.study.results import Run
from evolution.study.statistics import Estimate
from evolution.study.times import Threshold, Times
from evolution.study.trends import Trend
from evolution.study.winners import Comparison, Crawling, Retest, Winner

CONFIG = StudyConfig.from_dict(
    {"seeds": [0, 1], "budget_s": 100, "arms": {"ga-uniform": {"prior": "uniform"}}}
)
SPENT_S = np.array([30.0, 60.0])


def make_run(seed, best_m, failure=("ok", "ok")):
    return Run(seed, SPENT_S, np.array(best_m), np.array(failure), np.array([0, 0]), 1, 100.0)


NEVER = Estimate(1600.0, np.nan, np.nan)
RATIO = Estimate(2.0, 1.5, np.inf)
TIMES = Times(
    arm="ga-uniform", threshold_m=0.05, defined_by=None, runs=2, completed=52, reached=1,
    median_s=Estimate(60.0, 50.0, 70.0), median_generations=Estimate(3.0, 2.0, np.inf),
    acceleration=Estimate(1.67, 0.0, 2.5), running_time_s=NEVER, speed_up=RATIO, log_rank_p=0.0162,
)  # fmt: skip
STUDY = Analysis(
    config=CONFIG, missing=(), times={Threshold(0.05): [TIMES]}, distances={}, gains={}, speed_ups={},
    runs={"ga-uniform": [make_run(0, [0.0, 0.02]), make_run(1, [0.01, 0.06], ("ok", "tipped"))]},
    trends=[], ecdf={"ga-uniform": np.array([0.0, 0.5])}, grid_s=np.array([0.0, 29.0, 30.0, 61.0]),
)  # fmt: skip


def test_best_distance_steps_when_an_evaluation_ends():
    (axis,) = figures.draw_best(STUDY).axes
    *runs, median, threshold = axis.lines
    assert [run.get_ydata().tolist() for run in runs] == [[0, 0, 0, 20], [0, 0, 10, 60]]  # mm
    assert median.get_ydata().tolist() == [0, 0, 5, 40]
    assert median.get_xdata().tolist() == [0.0, 0.029, 0.030, 0.061]  # 1000 s
    assert set(threshold.get_ydata()) == {50.0}
    (band,) = axis.collections
    (outline,) = band.get_paths()
    assert {30.0, 50.0} < {y for x, y in outline.vertices if x == 0.061}  # quartiles of 20 and 60


def test_survival_ends_at_the_budget():
    curve, censored = figures.draw_survival(STUDY).axes[0].lines
    assert (censored.get_xdata().tolist(), censored.get_ydata().tolist()) == ([0.1], [0.5])
    assert curve.get_xdata()[[0, 1, -1]].tolist() == [0.0, 0.06, 0.1]
    assert curve.get_ydata()[[0, 1, -1]].tolist() == [1.0, 0.5, 0.5]
    unknown = {Threshold(generations=9): [TIMES._replace(threshold_m=np.nan)]}
    assert figures.draw_survival(replace(STUDY, times=unknown)) is None


def test_medians_over_generations_end_with_the_shortest_run():
    def run(*best_m):
        count = len(best_m)
        spent_s = 30.0 * np.arange(1, count + 1)
        return Run(0, spent_s, np.array(best_m), np.full(count, "ok"), np.arange(count), count, 99.0)

    runs = [run(0.0, 0.01), run(0.02, 0.02, 0.05), run(0.03, 0.04, 0.06, 0.1), run(0.01, 0.02, 0.03)]
    (axis,) = figures.draw_generations(replace(STUDY, runs={"ga-uniform": runs})).axes
    *single, median = axis.lines
    assert median.get_xdata().tolist() == [1, 2]
    assert median.get_ydata() == pytest.approx([15, 20])
    assert [np.isfinite(line.get_ydata()).sum() for line in single] == [2, 3, 4, 3]


def test_speed_ups_beyond_the_axis_are_triangles():
    rows = [(0.01, Estimate(2.0, 1.0, np.inf)), (0.02, Estimate(np.inf, np.nan, np.nan)),
            (0.03, Estimate(0.0, np.nan, np.nan))]  # fmt: skip
    (axis,) = figures.draw_speed_ups(replace(STUDY, speed_ups={"ga-uniform": rows})).axes
    inside, infinite, zero, _ = axis.lines
    assert (inside.get_xdata().tolist(), inside.get_ydata().tolist()) == ([10.0], [2.0])
    assert (infinite.get_xdata().tolist(), zero.get_xdata().tolist()) == ([20.0], [30.0])
    assert figures.draw_speed_ups(STUDY) is None


def test_speed_ups_of_a_prior_are_drawn_over_the_number_of_genes():
    trend = Trend("genome shared", (20, 36), (RATIO, RATIO), (RATIO, NEVER), RATIO, RATIO)
    pooled = trend._replace(name="all genomes", groups=2)
    distances, speed_ups = figures.draw_genes(replace(STUDY, trends=[trend, pooled])).axes
    assert speed_ups.lines[0].get_xdata().tolist() == [20, 36]
    assert speed_ups.lines[0].get_ydata().tolist() == [2.0, 100.0]  # 1,600 is clipped
    assert distances.lines[0].get_ydata().tolist() == [2.0, 2.0]
    assert all(line.get_label() != "all genomes" for line in distances.lines)
    assert figures.draw_genes(STUDY) is None


def test_page_shows_every_number_in_its_unit(tmp_path):
    median = Estimate(0.04, 0.03, 0.05)
    row = Distances("ga-uniform", 2, median, 0.06, 0.25, RATIO, 0.0001)
    analysis = replace(
        STUDY,
        runs={},
        distances={100.0: [row]},
        gains={50: [Gain("ga-uniform", 2, median, RATIO, None, Estimate(114.0, 90.0, np.inf))]},
    )
    retest = Retest(
        [Winner("ga-uniform", 1, 0.06, 0.0301, "ok")],
        [Comparison("ga-uniform", "Runge-Kutta", 2, 1, 0.979, 0.95, 1.02, 0.03)],
        [Crawling("ga-uniform", "body load", 2, 0.03, 0.01, 0.05)],
    )
    page = report.write(analysis, retest, tmp_path).read_text("utf-8")
    rows = [row.split("<td>")[1:] for row in re.findall(r"<tr>(<td>.*)</tr>", page)]
    fast = "2.00 (1.50 to ∞)"
    assert rows == [
        [
            "ga-uniform",
            "50.0",
            "1 of 2",
            "60 (50 to 70)",
            "3 (2 to ∞)",
            "1.67 (0.00 to 2.50)",
            "1,600",
            fast,
            "0.016",
        ],
        ["ga-uniform", "2", "40.0 (30.0 to 50.0)", "60.0", "25 %", fast, "&lt; 0.001"],
        ["ga-uniform", "2", "40.0 (30.0 to 50.0)", fast, "", "114 (90 to ∞)"],
        ["ga-uniform", "1", "60.0", "30.1", "artefact of the timestep"],
        ["ga-uniform", "Runge-Kutta", "2", "1", "97.9 %", "95.0 % to 102.0 %", "30.0"],
        ["ga-uniform", "2", "body load", "3.0 %", "1.0 % to 5.0 %"],
    ]  # fmt: skip
    assert "Time to 50 mm" in page
    assert "After 50 generations" in page
    assert "A threshold is the median\ndistance of the reference" in page


def test_page_shows_a_bound_if_the_median_run_misses_the_threshold(tmp_path):
    threshold = Threshold(generations=50)
    times = TIMES._replace(defined_by=5, acceleration=Estimate(0.0, 0.0, 1.25))
    analysis = replace(STUDY, times={threshold: [times]}, runs={})
    page = report.write(analysis, Retest([], [], []), tmp_path).read_text("utf-8")
    assert "<td>50.0 (5)<td>" in page
    assert "<td>&lt; 0.96 (up to 1.25)<td>" in page  # 50 / 52


def test_page_counts_the_longer_runs_of_its_seeds(tmp_path):
    config = StudyConfig.from_dict(CONFIG.to_dict() | {"long_seeds": [1, 999], "long_budget_s": 1e6})
    assert 1 in config.seeds
    assert 999 not in config.seeds
    page = report.write(replace(STUDY, config=config, runs={}), Retest([], [], []), tmp_path)
    assert "1 run of ga-uniform: 1,000,000 simulated seconds" in page.read_text("utf-8")


def test_page_does_not_derive_given_thresholds_from_the_reference(tmp_path):
    config = replace(CONFIG, thresholds_m=(0.05,))
    page = report.write(replace(STUDY, config=config, runs={}), Retest([], [], []), tmp_path)
    text = page.read_text("utf-8")
    assert "A threshold is the median" not in text
    assert "times as fast<br>" not in text


def test_page_of_policies_has_no_table_of_gaits(tmp_path):
    retest = Retest([], [Comparison("ppo", "Runge-Kutta", 2, 1, 0.979, 0.95, 1.02, 0.03)], [])
    page = report.write(replace(STUDY, runs={}), retest, tmp_path).read_text("utf-8")
    assert "simulated again</h2>" in page
    assert "How the best robots crawl" not in page


def test_page_says_that_all_robots_failed(tmp_path):
    nan = float("nan")
    retest = Retest([], [Comparison("ga-uniform", "friction 0.4", 2, 2, nan, nan, nan, 0.0)], [])
    page = report.write(replace(STUDY, runs={}), retest, tmp_path).read_text("utf-8")
    assert "<td>2<td>2<td>unknown<td>unknown to unknown<td>0.0</tr>" in page


@pytest.mark.parametrize("count", [12, 13])
def test_figures_of_many_arms_have_a_legend_below_and_no_bands(count):
    runs = {f"arm{number}": STUDY.runs["ga-uniform"] for number in range(count)}
    figure = figures.draw_best(replace(STUDY, runs=runs, times={}))
    (axis,), (legend,) = figure.axes, figure.legends
    assert len(legend.get_texts()) == count
    assert len(axis.collections) == (count if count == 12 else 0)
    assert len(axis.lines) == (3 * count if count == 12 else count)
    figure.draw_without_rendering()
    is_below = legend.get_window_extent().y1 < axis.get_window_extent().y0
    assert is_below == (count == 13)


@pytest.mark.parametrize("count", [10, 20, 36])
def test_every_arm_has_its_own_colour(count):
    runs = {f"arm{number}": [] for number in range(count)}
    colours = figures._colours(replace(STUDY, runs=runs))
    assert len({tuple(colour) for colour in colours.values()}) == count


def test_page_names_a_threshold_that_the_reference_does_not_define(tmp_path):
    unknown = {Threshold(generations=9): [TIMES._replace(threshold_m=np.nan)]}
    page = report.write(replace(STUDY, times=unknown, runs={}), Retest([], [], []), tmp_path)
    assert "<td>ga-uniform<td>unknown</tr>" in page.read_text("utf-8")
