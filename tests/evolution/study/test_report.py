"""Figures and page of a study show the right numbers in the right units."""

import re
from dataclasses import replace

import numpy as np

from evolution.study import report
from evolution.study.analysis import Analysis, Finals, Gain, Times
from evolution.study.config import StudyConfig
from evolution.study.results import Run
from evolution.study.statistics import Estimate
from evolution.study.winners import Comparison, Winner

CONFIG = StudyConfig.from_dict(
    {"seeds": [0, 1], "pilot_seeds": [9], "budget_s": 100, "arms": {"ga-uniform": {"prior": "uniform"}}}
)
SPENT_S = np.array([30.0, 60.0])


def make_run(seed, best_m, failure=("ok", "ok")):
    return Run(seed, SPENT_S, np.array(best_m), np.array(failure), np.array([0, 0]), 1)


STUDY = Analysis(
    config=CONFIG, missing=(), thresholds_m=[0.05], times={}, finals=[], gains=[],
    runs={"ga-uniform": [make_run(0, [0.0, 0.02]), make_run(1, [0.01, 0.06], ("ok", "tipped"))]},
    ecdf={"ga-uniform": np.array([0.0, 0.5])}, grid_s=np.array([0.0, 29.0, 30.0, 61.0]),
)  # fmt: skip


def test_best_distance_steps_when_an_evaluation_ends():
    (axis,) = report.draw_best(STUDY).axes
    *runs, median, threshold = axis.lines
    assert [run.get_ydata().tolist() for run in runs] == [[0, 0, 0, 20], [0, 0, 10, 60]]  # mm
    assert median.get_ydata().tolist() == [0, 0, 5, 40]
    assert median.get_xdata().tolist() == [0.0, 0.029, 0.030, 0.061]  # 1000 s
    assert set(threshold.get_ydata()) == {50.0}
    (band,) = axis.collections
    (outline,) = band.get_paths()
    assert {y for x, y in outline.vertices if x == 0.061} == {30.0, 50.0}  # quartiles of 20 and 60


def test_survival_ends_at_the_budget():
    (curve,) = report.draw_survival(STUDY).axes[0].lines
    assert curve.get_xdata()[[0, 1, -1]].tolist() == [0.0, 0.06, 0.1]
    assert curve.get_ydata()[[0, 1, -1]].tolist() == [1.0, 0.5, 0.5]
    assert report.draw_survival(replace(STUDY, thresholds_m=None)) is None


def test_page_shows_every_number_in_its_unit(tmp_path):
    ratio = Estimate(2.0, 1.5, np.inf)
    never = Estimate(1600.0, np.nan, np.nan)
    times = Times("ga-uniform", 2, 1, Estimate(60.0, 50.0, 70.0), never, ratio, 0.0162)
    median = Estimate(0.04, 0.03, 0.05)
    finals = Finals("ga-uniform", 2, median, 0.06, 0.25, ratio, 0.0001)
    winner = Winner("ga-uniform", 1, 0.06, 0.0301, "ok")
    analysis = replace(
        STUDY, runs={}, times={0.05: [times]}, finals=[finals], gains=[Gain("ga-uniform", 2, ratio)]
    )
    compared = Comparison("ga-uniform", "Runge-Kutta", 2, 1, 0.0214, 0.05)
    page = report.write(analysis, [winner], tmp_path, [compared]).read_text("utf-8")
    rows = [row.split("<td>")[1:] for row in re.findall(r"<tr>(<td>.*)</tr>", page)]
    fast = "2.00 (1.50 to ∞)"
    assert rows == [
        ["ga-uniform", "1 of 2", "60 (50 to 70)", "1,600", fast, "0.016"],
        ["ga-uniform", "2", "40.0 (30.0 to 50.0)", "60.0", "25 %", fast, "&lt; 0.001"],
        ["ga-uniform", "2", fast],
        ["ga-uniform", "1", "60.0", "30.1", "artefact of the timestep"],
        ["ga-uniform", "Runge-Kutta", "2", "1", "2.1 %", "5.0 %"],
    ]
    assert "Time to 50.0 mm" in page
    assert "over the pilot seeds" in page


def test_page_does_not_derive_given_thresholds_from_pilot_runs(tmp_path):
    config = replace(CONFIG, pilot_seeds=(), thresholds_m=(0.05,))
    page = report.write(
        replace(STUDY, config=config, runs={}, thresholds_m=None), [], tmp_path
    ).read_text("utf-8")
    assert "over the pilot seeds" not in page
