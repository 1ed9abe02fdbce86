"""Figures of all kinds of runs and robots, and the files that they are saved to."""

import re

import numpy as np
import pytest
from matplotlib import _pylab_helpers
from matplotlib.image import imread

from caterpillar_env.gait import GaitTimings
from caterpillar_env.morphology import Morphology
from caterpillar_env.physics import Physics
from caterpillar_env.robot import Robot
from evolution.config import RunConfig
from evolution.genome import Encoding
from evolution.priors import make_priors
from evolution.report import figures
from evolution.run.loop import Generation

PERIOD_S = RunConfig().gait_period_s
REASONS = ("diverged", "flipped", "tipped", "jumped", "veered", "sagged")


def generation(number, best_m=0.01, mean_m=0.005, **failures):
    return Generation(
        number, best_m, mean_m, {r: failures.get(r, 0) for r in REASONS}, 10 * (number + 1), 300.0
    )


def individual(num_segments=4, on_s=0.0, off_s=PERIOD_S / 2):
    shape = 2 * (num_segments - 1)
    timings = GaitTimings(PERIOD_S, np.full(shape, on_s), np.full(shape, off_s))
    return Robot(Morphology(), timings, Physics(num_segments=num_segments))


def picture(path):
    """Return the pixels after checking that something is drawn."""
    pixels = imread(path)
    assert path.read_bytes().startswith(b"\x89PNG")
    assert pixels.shape[0] > 100
    assert pixels.shape[1] > 300
    assert pixels[..., :3].std() > 0.02
    assert not _pylab_helpers.Gcf.figs  # none stays open
    return pixels


@pytest.mark.parametrize(
    "history",
    [
        [generation(0)],
        [generation(0, 0.0, 0.0), generation(1, 0.0, 0.0)],
        [generation(0, 0.0, 0.0, diverged=10), generation(1, 0.0, 0.0, diverged=10)],
        [generation(n, 0.01 + 0.001 * n, 0.005, tipped=3, veered=n) for n in range(20)],
    ],
    ids=["one generation", "no robot moves", "all robots fail", "usual"],
)
def test_convergence_is_drawn(history, tmp_path):
    figures.save(figures.convergence(history, "a run"), tmp_path / "convergence.png")
    picture(tmp_path / "convergence.png")


def test_convergence_shows_millimetres_and_stacked_failures():
    history = [generation(0, 0.01, 0.004, tipped=3), generation(1, 0.02, 0.005, tipped=2, veered=4)]
    upper, lower = figures.convergence(history, "").axes
    best, mean = (line.get_xydata().tolist() for line in upper.lines)
    assert best == [[0, 10], [1, 20]]
    assert mean == [[0, 4], [1, 5]]
    bars = {bar.get_label(): [(p.get_y(), p.get_height()) for p in bar] for bar in lower.containers}
    assert bars == {"tipped": [(0, 3), (0, 2)], "veered": [(3, 0), (2, 4)]}


@pytest.mark.parametrize(
    ("num_segments", "on_s", "off_s"),
    [(2, 0.0, 0.0), (2, 0.75 * PERIOD_S, 0.25 * PERIOD_S), (5, 0.0, PERIOD_S)],
    ids=["never", "wraps around", "always"],
)
def test_gait_is_drawn_for_any_robot_and_timing(num_segments, on_s, off_s, tmp_path):
    figures.save(figures.gait(individual(num_segments, on_s, off_s)), tmp_path / "gait.png")
    picture(tmp_path / "gait.png")


def test_densities_of_all_genes_are_drawn(tmp_path):
    priors = make_priors(Encoding(Physics(num_segments=2), PERIOD_S))
    figures.save(figures.densities(priors), tmp_path / "densities.png")
    picture(tmp_path / "densities.png")


def test_inline_svg_is_deterministic_and_self_contained():
    drawn = [figures.inline_svg(figures.gait(individual(2)), "gait") for _ in range(2)]
    assert drawn[0] == drawn[1]
    assert drawn[0].startswith("<svg")
    assert "gap1" in drawn[0]  # as text
    links = re.findall(r'href="([^"]*)"', drawn[0])
    assert links
    assert all(link.startswith("#") for link in links)


def test_figures_of_one_page_share_no_ids():
    figure = figures.convergence([generation(n, tipped=3) for n in range(3)], "a run")
    ids = [re.findall(r' id="([^"]+)"', figures.inline_svg(figure, name)) for name in ("one", "other")]
    assert all(len(set(part)) == len(part) > 0 for part in ids)
    assert not set(ids[0]) & set(ids[1])


def test_power_is_drawn_where_it_is_on():
    figure = figures.gait(individual(2, 0.5, 1.5))
    for axis in figure.axes:
        corners = axis.collections[0].get_paths()[0].vertices
        on_s = corners[corners[:, 1] > 0.99, 0]
        assert on_s.min() == pytest.approx(0.5, abs=0.011)
        assert on_s.max() == pytest.approx(1.5, abs=0.011)
