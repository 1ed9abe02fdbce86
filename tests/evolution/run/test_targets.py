"""Runs end with the first generation that reaches the target, also if they are resumed."""

import re
import shutil
from dataclasses import replace
from functools import cache
from itertools import pairwise

import numpy as np
import polars
import pytest

from caterpillar_env.physics import Physics
from caterpillar_env.robot import Outcomes
from caterpillar_env.task import Failure
from evolution import cli
from evolution.config import RunConfig
from evolution.optimizers.cma_es import CmaConfig
from evolution.optimizers.ga import GaConfig
from evolution.report import run_page
from evolution.run.evaluators import LocalEvaluator, Result
from evolution.run.history import load
from evolution.run.journal import Journal
from evolution.run.loop import evolve, resume

SHORT = Physics(num_segments=2, timestep_s=0.01)
ASKED = RunConfig(
    generations=5, prior="uniform", physics=SHORT,
    ga=GaConfig(population=4, hall_of_fame=1, mutation_rate=0.3), cma=CmaConfig(cma_population=4),
)  # fmt: skip
KINDS = {
    "ga": {},
    "cma-es": {"optimizer": "cma-es"},
    "random": {"optimizer": "random"},
    "per-energy": {"objective": "distance-per-energy"},
}
every_kind = pytest.mark.parametrize("kind", KINDS)


class Whole:
    """A complete run, and its first middle generation that gets farther than all earlier generations."""

    def __init__(self, folder, config, generations):
        self.folder, self.config, self.generations = folder, config, generations
        grown = [b for a, b in pairwise(generations[:-1]) if b.farthest_m > a.farthest_m]
        self.number = grown[0].number if grown else None
        self.targeted = replace(config, target_m=grown[0].farthest_m) if grown else None

    @property
    def until_target(self):
        return recorded(self.folder).filter(polars.col("generation") <= self.number)


def recorded(folder):
    return load(folder).table().drop("session")


@pytest.fixture(scope="module")
def whole(tmp_path_factory, invented):
    """Return a function that gives the first run of a kind whose robots get farther in the middle."""

    @cache
    def run(kind):
        for seed in range(1, 20):
            folder, config = tmp_path_factory.mktemp("whole"), replace(ASKED, seed=seed, **KINDS[kind])
            found = Whole(folder, config, evolve(config, folder, evaluator=invented).generations)
            if found.targeted is not None and found.generations[0].farthest_m > 0:
                return found
        raise AssertionError("no robot gets farther after the first generation")

    return run


@every_kind
def test_a_run_ends_with_the_first_generation_that_reaches_its_target(whole, tmp_path, kind, invented):
    found = whole(kind)
    result = evolve(found.targeted, tmp_path, evaluator=invented)
    assert result.finished
    assert [g.number for g in result.generations] == [*range(found.number + 1)]
    assert recorded(tmp_path).equals(found.until_target)
    assert load(tmp_path).finished
    assert load(tmp_path).config == found.targeted
    ended = found.targeted.stop_reason(found.number + 1, 0.0, result.generations[-1].farthest_m)
    assert f"was reached in generation {found.number}, " in ended


def test_unreached_target_changes_only_the_message(whole, tmp_path, invented):
    found = whole("ga")
    farthest_m = found.generations[-1].farthest_m
    config = replace(found.config, target_m=float(np.nextafter(farthest_m, 1.0)))
    assert evolve(config, tmp_path, evaluator=invented).finished
    assert recorded(tmp_path).equals(recorded(found.folder))
    ended = config.stop_reason(5, 0.0, farthest_m)
    assert re.fullmatch(r"all \d+ generations are complete; the target of \S+ mm was not reached", ended)


@every_kind
def test_a_run_resumed_before_its_target_ends_like_an_uninterrupted_run(whole, tmp_path, kind, invented):
    found = whole(kind)

    def stop(generation):
        if generation.number == found.number - 1:
            raise KeyboardInterrupt

    assert not evolve(found.targeted, tmp_path, evaluator=invented, on_generation=stop).finished
    again = resume(tmp_path, evaluator=invented)
    assert again.finished
    assert [g.replayed for g in again.generations] == [True] * found.number + [False]
    assert recorded(tmp_path).equals(found.until_target)


@pytest.mark.parametrize("kind", ["ga", "cma-es"])
def test_a_generation_in_which_the_target_is_reached_is_completed(
    whole, tmp_path, monkeypatch, kind, invented
):
    """The run stops after every genome, also after the one that reaches the target."""
    monkeypatch.setattr("evolution.run.evaluators.CHUNK", 1)
    found = whole(kind)

    class Stops(LocalEvaluator):
        def map(self, encoding, jobs, on_progress=None):
            yield from invented.map(encoding, jobs[:1])
            if len(jobs) > 1:
                raise KeyboardInterrupt

    result = evolve(found.targeted, tmp_path, evaluator=Stops(1))
    while not result.finished:
        before = len(recorded(tmp_path))
        result = resume(tmp_path, evaluator=Stops(1))
        assert len(recorded(tmp_path)) > before
    assert load(tmp_path).table()["session"].n_unique() > 4
    assert recorded(tmp_path).equals(found.until_target)
    assert [g.number for g in result.generations] == [*range(found.number + 1)]


@pytest.fixture(scope="module")
def reached(whole, tmp_path_factory, invented):
    """A run whose first generation reaches the target."""
    folder, found = tmp_path_factory.mktemp("reached"), whole("ga")
    config = replace(found.config, target_m=found.generations[0].farthest_m)
    assert len(evolve(config, folder, evaluator=invented).generations) == 1
    return folder


@pytest.mark.parametrize("noted", [True, False], ids=["recorded", "killed before recording"])
@pytest.mark.parametrize("generations", [None, 9])
def test_a_run_at_its_target_evaluates_nothing_more(reached, tmp_path, generations, noted, invented):
    folder = tmp_path / "run"
    shutil.copytree(reached, folder)
    best = (folder / "best.json").read_bytes()
    if not noted:
        with Journal(folder) as journal:
            journal.begin()  # a session without an end
        (folder / "best.json").unlink()
    again = resume(folder, generations=generations, evaluator=invented)
    assert again.finished
    assert [g.replayed for g in again.generations] == [True]
    assert load(folder).table().equals(load(reached).table())
    assert (folder / "best.json").read_bytes() == best
    assert load(folder).finished


def test_resuming_at_the_target_reports_that_nothing_is_left(reached, tmp_path, capsys):
    shutil.copytree(reached, tmp_path / "run")
    assert cli.main(["resume", str(tmp_path / "run"), "--no-video"]) == 0
    lines = capsys.readouterr().err.splitlines()
    assert len(lines) == 1
    assert re.fullmatch(
        r"already finished: the target of \S+ mm was reached in generation 0, where a robot crawled "
        r"\S+ mm",
        lines[0],
    )


def test_evolve_and_the_page_say_why_a_run_ended(tmp_path, capsys):
    flags = [
        "evolve", "--num-segments", "2", "--timestep-s", "0.01", "--population", "4", "--hall-of-fame",
        "1", "--seed", "4", "--generations", "2", "--no-video", "--out", str(tmp_path / "run"),
    ]  # fmt: skip
    assert cli.main([*flags, "--target-m", "0.000001"]) == 0
    why = "the target of 0.001 mm was reached in generation 0, where a robot crawled "
    assert f"\nfinished: {why}" in capsys.readouterr().err
    page = (tmp_path / "run" / "report.html").read_text("utf-8")
    assert "2 generations or a target of 0.001 mm," in page
    assert f"<p>Why the run ended: {why}" in page
    assert "caterpillar resume" not in page  # it would do nothing
    assert "<tr><td>target_m<td>1e-06<td>null</tr>" in page


def test_run_that_missed_its_target_reports_it_and_can_continue(tmp_path, whole, invented):
    config = replace(whole("ga").config, generations=1, target_m=9.0)
    evolve(config, tmp_path / "run", evaluator=invented)
    page = run_page.page(load(tmp_path / "run"), {})
    assert "generations are complete; the target of 9000 mm was not reached" in page
    assert "caterpillar resume run --generations 2" in page


@pytest.mark.parametrize(
    ("value", "message"),
    [
        ("-0.1", "target_m = -0.1 must be a positive number"),
        ("0", "target_m = 0.0 must be a positive number"),
        ("nan", "target_m = nan must be a finite number"),
        ("far", "--target-m"),
    ],
)
def test_an_invalid_target_is_refused_and_leaves_no_folder(tmp_path, capsys, value, message):
    assert cli.main(["evolve", "--target-m", value, "--out", str(tmp_path / "run")]) in (1, 2)
    assert message in capsys.readouterr().err
    assert not (tmp_path / "run").exists()


class Told(LocalEvaluator):
    """An evaluator that returns the given outcomes."""

    def __init__(self, outcomes):
        super().__init__(1)
        self.outcomes = outcomes

    def map(self, encoding, jobs, on_progress=None):
        for _ in jobs:
            yield Result(self.outcomes, None)


def test_targets_ignore_failed_robots_and_the_objective(tmp_path):
    failure = np.array([Failure.VEERED, 0, 0], dtype=np.int8)
    # The first robot veered beyond the target. The second is the best, and the third gets farthest.
    outcomes = Outcomes(
        failure, np.array([0.9, 0.1, 0.2]), np.array([10.0, 10.0, 90.0]), np.full(3, 30.0)
    )
    ga = GaConfig(population=3, hall_of_fame=0)
    asked = RunConfig(generations=2, objective="distance-per-energy", physics=SHORT, ga=ga)
    for target_m, expected in ((0.2, 1), (0.21, 2)):
        config = replace(asked, target_m=target_m)
        result = evolve(config, tmp_path / str(target_m), evaluator=Told(outcomes))
        assert len(result.generations) == expected
        assert result.best_robot.fitness_m == 0.1
        assert result.generations[-1].farthest_m == 0.2


def test_first_of_budget_and_target_ends_a_run():
    both = RunConfig(budget_s=100.0, target_m=0.25)
    assert both.stop_reason(0, 0.0, 0.0) is None
    assert both.stop_reason(3, 99.0, 0.24) is None
    budget = "the budget of 100 simulated seconds is spent; the target of 250 mm was not reached"
    assert both.stop_reason(3, 100.0, 0.24) == budget
    reached = "the target of 250 mm was reached in generation 2, where a robot crawled 260.0 mm"
    assert both.stop_reason(3, 100.0, 0.26) == both.stop_reason(3, 60.0, 0.26) == reached
    assert RunConfig().stop_reason(50, 0.0, 9.0) == "all 50 generations are complete"
