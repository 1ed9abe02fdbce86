"""Tables and sentences of made-up runs whose answers are known."""

from dataclasses import dataclass, field, replace

import numpy as np
import polars
import pytest
from scipy import stats

from caterpillar_env.physics import Physics
from caterpillar_env.robot import Outcomes
from caterpillar_env.task import Failure
from evolution.study.analysis import analyse, arrival
from evolution.study.config import StudyConfig
from evolution.study.headline import headline
from evolution.study.winners import Winner, winners

CONFIG = StudyConfig.from_dict(
    {
        "seeds": [0, 1, 2, 3],
        "pilot_seeds": [9],
        "budget_s": 100,
        "generation": 1,
        "base": {"ga": {"population": 5, "hall_of_fame": 1}},
        "arms": {
            "ga-uniform": {"prior": "uniform"},
            "ga-preprocessed": {},
            "random-preprocessed": {"optimizer": "random"},
        },
    }
)


def runs(arm, distances, failures=()):
    """Rows of one arm: a run a seed, an evaluation every 10 s, five to a generation."""
    rows = []
    for seed, course in enumerate(distances):
        for number, distance in enumerate(course):
            rows.append(
                {
                    "arm": arm, "seed": seed, "wall_s": 60.0 + seed, "evaluation": number,
                    "generation": number // 5, "distance_m": distance, "simulated_s": 10.0,
                    "failure": "tipped" if (seed, number) in failures else "ok",
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
    return analyse(CONFIG, frame, [], [0.09])


def test_arrivals_are_timed_and_censored(analysis):
    time, reached = arrival(analysis.courses["random-preprocessed"], 0.09, 100.0)
    assert time.tolist() == [100.0] * 4
    assert not reached.any()
    time, reached = arrival(analysis.courses["ga-preprocessed"], 0.09, 100.0)
    assert time.tolist() == [50.0] * 4
    assert reached.all()


def test_times_to_the_threshold(analysis):
    rows = {row.arm: row for row in analysis.times[0.09]}
    assert {arm: row.reached for arm, row in rows.items()} == {
        "ga-uniform": 4, "ga-preprocessed": 4, "random-preprocessed": 0,
    }  # fmt: skip
    assert rows["ga-preprocessed"].median_s.value == 50.0
    assert rows["ga-preprocessed"].running_time_s.value == 50.0
    assert rows["ga-preprocessed"].speed_up.value == pytest.approx(2.0)
    assert rows["ga-uniform"].speed_up is None
    assert rows["random-preprocessed"].restricted_mean_s.value == 100.0
    assert rows["random-preprocessed"].running_time_s.value == np.inf
    assert rows["random-preprocessed"].speed_up.value == 0.0
    assert np.isnan(rows["random-preprocessed"].speed_up.low)
    # Four of eight arrive at once, all of one arm: (4 - 2)^2 / (4 / 7); twice, for there are two tests.
    twice = 2 * stats.chi2.sf(7, 1)
    assert rows["ga-preprocessed"].log_rank_p == pytest.approx(twice)
    assert rows["random-preprocessed"].log_rank_p == pytest.approx(twice)


def test_distances_at_the_end(analysis):
    rows = {row.arm: row for row in analysis.finals}
    assert rows["ga-uniform"].median_m == pytest.approx(0.0915)
    assert rows["ga-uniform"].a12 is None
    assert rows["ga-preprocessed"].best_m == pytest.approx(0.193)
    assert rows["ga-preprocessed"].a12.value == 1.0
    assert rows["random-preprocessed"].a12.value == 0.0
    assert rows["random-preprocessed"].failed == pytest.approx(5 / 40)
    assert rows["ga-preprocessed"].wall_s == 61.5
    # Exact for 4 against 4 apart, 2 / C(8, 4), and by the normal for the ties of the other arm, which is
    # the smaller one of the family's two tests: Holm's correction doubles it, and holds for both.
    tied = 2 * stats.norm.sf((8 - 0.5) / np.sqrt(16 / 12 * (9 - 60 / 56)))
    assert tied < 2 / 70
    assert rows["random-preprocessed"].mann_whitney_p == pytest.approx(2 * tied)
    assert rows["ga-preprocessed"].mann_whitney_p == pytest.approx(2 * tied)


def test_runs_are_paired_by_their_seeds(few_draws):
    # Seed by seed 2 to 5 mm farther, of which any other pairing knows nothing; seed 2 is not finished.
    base = runs("ga-uniform", [[0.01], [0.05], [0.03], [0.02]])
    other = runs("random-preprocessed", [[0.012], [0.053], [0.9], [0.025]])
    frame = polars.concat([base, other.filter(polars.col("seed") != 2).reverse()])
    (row,) = (f for f in analyse(CONFIG, frame, [], None).finals if f.wilcoxon_p is not None)
    assert row.wilcoxon_p == pytest.approx(2 / 2**3)  # all three of one sign


def test_generations_compare_within_one_optimizer(analysis):
    (gain,) = analysis.gains
    assert gain.arm == "ga-preprocessed"
    assert gain.ratio.value == pytest.approx(0.1915 / 0.0915)
    assert gain.ratio.low < gain.ratio.value < gain.ratio.high


def test_shares_of_targets_rise_to_what_was_reached(analysis):
    assert analysis.ecdf["ga-preprocessed"][0] == 0.0
    assert analysis.ecdf["ga-preprocessed"][-1] > 0.95
    assert analysis.ecdf["random-preprocessed"][-1] < 0.1
    for share in analysis.ecdf.values():
        assert (np.diff(share) >= 0).all()


def test_the_answers_in_words(analysis):
    said = "\n".join(headline(analysis))
    assert "Preprocessing (ga-preprocessed): 4 of 4 runs reach 90 mm, 2.00 times as fast" in said
    assert (
        "Random search from the prior (random-preprocessed): 0 of 4 runs reach 90 mm, as against" in said
    )
    assert "Least simulated time to 90 mm: ga-preprocessed, 50 s a success." in said
    assert "+109 % of distance at generation 1" in said
    assert "UNFINISHED" not in said


def test_reference_that_never_arrives_is_said_to(few_draws):
    frame = polars.concat(
        [runs("ga-uniform", [[0.01] * 10] * 4), runs("ga-preprocessed", [ramp(0.01, 0.02)] * 4)]
    )
    said = "\n".join(headline(analyse(CONFIG, frame, [], [0.09])))
    assert "4 of 4 runs reach 90 mm, and the reference never does; log-rank" in said


@pytest.mark.parametrize(
    ("reference_m", "failure", "artefact"),
    [(0.095, "ok", False), (0.089, "ok", True), (0.111, "ok", True), (0.1, "tipped", True)],
)
def test_a_winner_that_does_not_hold_at_the_fine_timestep_is_an_artefact(reference_m, failure, artefact):
    winner = Winner("ga", 0, 0.1, reference_m, failure, (0.0, 0.1), None, 0.005, 0.8)
    assert winner.artefact is artefact


@dataclass(frozen=True)
class Made:
    """A robot that crawls farther on slippery ground, and falls at a friction of 0.9."""

    fitness_m: float
    physics: Physics = field(default_factory=Physics)

    def simulate(self, timestep_s=None):
        physics = self.physics
        crawled_m = self.fitness_m + 0.8 - physics.friction + 1e-6 * physics.mismatch_seed
        failure = Failure.TIPPED if physics.friction == 0.9 else Failure.NONE
        return Outcomes(np.array([failure]), *np.array([[crawled_m - (timestep_s or 0)], [1.0], [30.0]]))

    def save(self, path):
        path.write_text(str(self.fitness_m))


@dataclass(frozen=True)
class MadeArm:
    """Runs whose best robots are known."""

    best_m: dict

    def is_finished(self, folder, seed, budget_s):
        return seed in self.best_m

    def best(self, folder, budget_s):
        (seed,) = (s for s in self.best_m if folder.name == f"seed-{s}")
        return self.best_m[seed] and Made(self.best_m[seed])


def test_best_robot_of_an_arm_is_looked_at_again_under_other_conditions(tmp_path):
    def found(best_m):
        return winners(replace(CONFIG, arms={"a": MadeArm(best_m)}, reference="a"), tmp_path)

    first = found({0: 0.25, 1: 0.3, 2: None})
    assert first == [
        Winner(
            "a", 1, 0.3, pytest.approx(0.3 - 0.00025), "ok", (0.0, pytest.approx(0.5)),
            (pytest.approx(0.301001), pytest.approx(0.301004)), 0.0025, 0.8,
        )
    ]  # fmt: skip
    assert (tmp_path / "winners" / "a.json").read_text() == "0.3"
    assert found({}) == first  # the runs themselves are not there any more
    ((_, seed, recorded_m, reference_m, *_),) = found({0: 0.25, 1: 0.3, 3: 0.4})
    assert (seed, recorded_m, reference_m) == (3, 0.4, pytest.approx(0.4 - 0.00025))
