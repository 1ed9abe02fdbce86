"""The history of a run: its leaders, its best robot, and reading it while it is written."""

from dataclasses import replace

import numpy as np
import polars
import pytest

from caterpillar_env.errors import CaterpillarError
from caterpillar_env.physics import Physics
from caterpillar_env.robot import Outcomes, Robot
from caterpillar_env.task import Failure
from evolution.config import RunConfig
from evolution.optimizers.ga import GaConfig
from evolution.run.history import History, load
from evolution.run.journal import Journal

CONFIG = RunConfig(
    seed=4, generations=2, physics=Physics(num_segments=2, timestep_s=0.01),
    ga=GaConfig(population=3, hall_of_fame=1),
)  # fmt: skip


def test_leaders_are_the_best_so_far_and_crawl_as_recorded(runs):
    rows = load(runs / "done").table()
    found = load(runs / "done").leaders()
    assert len(found) == CONFIG.generations
    for number, leader in enumerate(found):
        so_far = rows.filter(polars.col("generation") <= number)
        assert leader.fitness_m == so_far["fitness"].max()
        best = so_far.row(so_far["fitness"].arg_max(), named=True)
        assert leader.generation == best["generation"]
        assert leader.morphology.segment_length_m == best["segment_length_m"]
    assert found[-1].simulate(threads=1).fitness()[0] == found[-1].fitness_m


def test_farthest_robot_leads_until_a_robot_qualifies_as_the_best(tmp_path):
    rng = np.random.default_rng(0)
    genomes = rng.random((6, len(CONFIG.encoding.genes)))
    outcomes = Outcomes(
        np.array([Failure.VEERED, Failure.DIVERGED, Failure.TIPPED, 0, 0, 0]),
        np.array([0.01, 0.0, 0.05, -0.01, 0.002, 0.001]),
        np.ones(6), np.full(6, 30.0),
    )  # fmt: skip
    config = replace(CONFIG, failed_fitness=0.1)  # must not make a failed robot the best
    with Journal.create(tmp_path, config.to_dict()) as journal:
        journal.begin()
        history = History(journal)
        for generation in range(3):
            part = slice(2 * generation, 2 * generation + 2)
            history.append(genomes[part], Outcomes(*(field[part] for field in outcomes)))
            history.complete()
    fitness_m = [leader.fitness_m for leader in load(tmp_path).leaders()]
    assert fitness_m == [0.0, 0.0, 0.002]
    assert [leader.generation for leader in load(tmp_path).leaders()] == [0, 1, 2]


def test_ties_for_the_best_go_to_the_robot_evaluated_first(tmp_path):
    genomes = np.random.default_rng(0).random((3, len(CONFIG.encoding.genes)))
    outcomes = Outcomes(np.zeros(1, dtype=np.int8), np.array([0.1]), np.ones(1), np.full(1, 30.0))
    with Journal.create(tmp_path, CONFIG.to_dict()) as journal:
        journal.begin()
        history = History(journal)
        for genome in genomes:
            history.append(genome[None], outcomes)
            history.complete()
        assert history.best.number == 0
    assert Robot.load(tmp_path).evaluation == load(tmp_path).best.number == 0


def test_a_generation_completed_during_reading_is_excluded(tmp_path, monkeypatch):
    genomes = np.random.default_rng(0).random((2, len(CONFIG.encoding.genes)))
    outcomes = Outcomes(np.zeros(1, dtype=np.int8), np.array([0.1]), np.ones(1), np.full(1, 30.0))
    read_evaluations, calls = Journal.evaluations, []

    def read_slowly(journal):
        yield from read_evaluations(journal)
        calls.append(journal)
        if len(calls) == 1:
            writer.append(genomes[1:], outcomes)
            writer.complete()

    with Journal.create(tmp_path, CONFIG.to_dict()) as journal:
        journal.begin()
        writer = History(journal)
        writer.append(genomes[:1], outcomes)
        writer.complete()
        monkeypatch.setattr(Journal, "evaluations", read_slowly)
        assert len(load(tmp_path).generations) == 1
        assert len(load(tmp_path).generations) == 2


def test_run_without_evaluations_has_no_leaders(tmp_path):
    Journal.create(tmp_path, {**CONFIG.to_dict(), "own_optimizer": None}).close()
    with pytest.raises(CaterpillarError, match=r"has no completed generation; .* `caterpillar resume"):
        load(tmp_path).leaders()
