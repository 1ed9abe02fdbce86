"""Trainings side by side: who belongs together, and what they came to."""

import pytest
from matplotlib.figure import Figure

from baselines import comparison
from baselines.config import TrainConfig, TrainingError
from baselines.records import Point, Record, append, evaluations
from caterpillar_env.errors import CaterpillarError
from caterpillar_env.morphology import Morphology


def kept(folder, points, **fields):
    folder.mkdir(parents=True)
    Record(TrainConfig(**fields), {}, {}, finished=True, wall_s=1.0, simulated_s=2.0).save(folder)
    for place, (distance_m, failure) in enumerate(points):
        append(folder, Point(100.0 * place, distance_m, 1.0, 30.0, failure, Morphology()))
    return folder


@pytest.fixture
def folders(tmp_path):
    return [
        kept(tmp_path / "a", [(0.001, "ok"), (0.05, "ok"), (0.9, "tipped")], seed=0),
        kept(tmp_path / "b", [(0.3, "veered"), (0.02, "ok")], seed=1),
        kept(tmp_path / "c", [(-0.01, "ok")], seed=0, mode="timing"),
    ]


def test_seeds_of_one_training_are_one_row(folders):
    groups = comparison.grouped({f: Record.load(f) for f in folders})
    assert groups == {"ppo switch": folders[:2], "ppo timing": folders[2:]}


def test_summary_is_of_the_best_policies_and_the_untrained_ones(folders):
    row = comparison.summary("x", folders[:2])
    assert (row.runs, row.simulated_s) == (2, 150.0)
    assert (row.least_m, row.median_m, row.most_m) == (0.02, pytest.approx(0.035), 0.05)
    assert row.untrained_m == pytest.approx((0.001 + 0.0) / 2)  # a failure counts as nothing


def test_trainings_of_one_name_and_other_settings_are_told_apart(tmp_path):
    one = kept(tmp_path / "a", [(0.0, "ok")], budget_s=1000.0)
    two = kept(tmp_path / "b", [(0.0, "ok")], budget_s=2000.0)
    groups = comparison.grouped({f: Record.load(f) for f in (one, two)})
    assert groups == {"ppo switch": [one], "ppo switch #2": [two]}


@pytest.mark.parametrize(
    ("fields", "said"),
    [
        ({"mode": "timing", "open_loop": True}, "ppo timing bandit"),
        ({"mode": "timing", "design": "uniform"}, "ppo timing uniform co-design"),
        ({"morphology": Morphology(leg_separation_m=0.02)}, "ppo switch given body"),
        ({"randomize": {"mass": (0.9, 1.1)}}, "ppo switch randomised"),
    ],
    ids=str,
)
def test_titles_say_what_is_special(fields, said):
    assert comparison.title(TrainConfig(**fields)) == said


def test_curves_are_drawn_with_failures_at_nothing(folders, tmp_path, monkeypatch):
    drawn, save = [], Figure.savefig
    monkeypatch.setattr(
        Figure, "savefig", lambda self, *a, **k: (drawn.append(self), save(self, *a, **k))
    )
    comparison.draw(comparison.grouped({f: Record.load(f) for f in folders}), tmp_path / "x.png")
    assert (tmp_path / "x.png").stat().st_size > 10_000
    curves = [curve.get_xydata().tolist() for curve in drawn[0].axes[0].lines]  # 1000 s, mm
    assert curves == [[[0, 1], [0.1, 50], [0.2, 0]], [[0, 0], [0.1, 20]], [[0, -10]]]
    with pytest.raises(CaterpillarError, match="choose another place with --out"):
        comparison.draw({}, tmp_path / "nowhere" / "x.png")


def test_row_that_is_being_written_is_left_out(tmp_path):
    folder = kept(tmp_path / "a", [(0.01, "ok"), (0.02, "ok")])
    text = (folder / "evaluations.csv").read_text()
    (folder / "evaluations.csv").write_text(text[:-40])
    assert [p.distance_m for p in evaluations(folder)] == [0.01]


def test_training_without_evaluations_has_no_row(tmp_path):
    with pytest.raises(TrainingError, match="holds no evaluation yet"):
        comparison.summary("x", [kept(tmp_path / "a", [])])
