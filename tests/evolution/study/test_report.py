"""Figures and page of a study show the numbers that they are given, in the units that they name."""

import re
from dataclasses import replace

import numpy as np
import polars
import pytest

from evolution.study import report
from evolution.study.analysis import Analysis, Finals, Gain, Times
from evolution.study.config import StudyConfig
from evolution.study.results import Course
from evolution.study.statistics import Estimate
from evolution.study.winners import Winner

CONFIG = StudyConfig.from_dict(
    {"seeds": [0, 1], "pilot_seeds": [9], "budget_s": 100, "arms": {"ga-uniform": {"prior": "uniform"}}}
)
SPENT_S = np.array([30.0, 60.0])
RUNS = [
    Course(0, SPENT_S, np.array([0.0, 0.02]), np.array([0, 0]), 1),
    Course(1, SPENT_S, np.array([0.01, 0.06]), np.array([0, 0]), 1),
]
STUDY = Analysis(
    config=CONFIG, missing=(), thresholds_m=[0.05], courses={"ga-uniform": RUNS}, times={}, finals=[],
    gains=[], ecdf={"ga-uniform": np.array([0.0, 0.5])}, grid_s=np.array([0.0, 29.0, 30.0, 61.0]),
)  # fmt: skip


def test_courses_step_when_an_evaluation_is_through():
    *runs, median, threshold = report.courses(STUDY).axes[0].lines
    assert [run.get_ydata().tolist() for run in runs] == [[0, 0, 0, 20], [0, 0, 10, 60]]  # mm
    assert median.get_ydata().tolist() == [0, 0, 5, 40]
    assert median.get_xdata().tolist() == [0.0, 0.029, 0.030, 0.061]  # 1000 s
    assert set(threshold.get_ydata()) == {50.0}


def test_survival_ends_at_the_budget_with_those_that_never_arrive():
    (curve,) = report.survival(STUDY).axes[0].lines
    assert curve.get_xdata()[[0, 1, -1]].tolist() == [0.0, 0.06, 0.1]
    assert curve.get_ydata()[[0, 1, -1]].tolist() == [1.0, 0.5, 0.5]
    assert report.survival(replace(STUDY, thresholds_m=None)) is None


def test_failures_are_shares_of_the_evaluations_in_their_tenth_of_the_budget():
    rows = [
        {"arm": "ga-uniform", "seed": seed, "evaluation": n, "simulated_s": 30.0, "failure": failure}
        for seed in (0, 1, 9)  # the last one is a pilot's
        for n, failure in enumerate(("ok", "tipped" if seed else "ok", "veered", "jumped"))
    ]
    bars = report.failures(STUDY, polars.DataFrame(rows)).axes[0].containers
    heights = {b.get_label(): [bar.get_height() for bar in b] for b in bars}
    assert np.flatnonzero(heights["tipped"]).tolist() == [5]  # from 50 to 60 s
    assert heights["tipped"][5] == 0.5
    assert heights["veered"][8] == 1.0
    assert not np.any(heights["jumped"])  # beyond the budget


def test_page_tells_every_number_in_its_unit(tmp_path):
    ratio = Estimate(2.0, 1.5, np.inf)
    times = Times(
        "ga-uniform", 2, 1, Estimate(60.0, 50.0, 70.0), Estimate(80.0, 75.0, 85.0),
        Estimate(1600.0, np.nan, np.nan), ratio, 0.0162,
    )  # fmt: skip
    finals = Finals("ga-uniform", 2, 0.04, (0.03, 0.05), 0.041, 0.06, 0.25, ratio, 0.0421, 0.0001, 61.5)
    winner = Winner("ga-uniform", 1, 0.06, 0.0301, "ok", (0.0, 0.07), (0.055, 0.065), 0.005, 0.8)
    told = replace(
        STUDY, courses={}, times={0.05: [times]}, finals=[finals],
        gains=[Gain("ga-uniform", 50, 2, ratio)],
    )  # fmt: skip
    page = report.write(told, polars.DataFrame(), [winner], tmp_path).read_text("utf-8")
    rows = [row.split("<td>")[1:] for row in re.findall(r"<tr>(<td>.*)</tr>", page)]
    fast = "2.00 (1.50 to ∞)"
    assert rows == [
        ["ga-uniform", "1 of 2", "60 (50 to 70)", "80 (75 to 85)", "1,600", fast, "0.016"],
        [
            "ga-uniform", "2", "40.0", "30.0 to 50.0", "41.0", "60.0", "25 %", fast, "0.042",
            "&lt; 0.001", "62",
        ],
        ["ga-uniform (2 runs)", fast],
        ["ga-uniform", "1", "60.0", "30.1", "0.0 to 70.0", "55.0 to 65.0", "artefact of the timestep"],
    ]  # fmt: skip
    assert "Time to 50.0 mm" in page


@pytest.mark.parametrize("value", [np.nan, None])
def test_what_has_no_value_has_no_interval(value):
    estimate = None if value is None else Estimate(value, np.nan, np.nan)
    assert report._interval(estimate, str) == ("" if value is None else "undefined")
