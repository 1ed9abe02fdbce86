"""The record of a run: contents, reproducibility, interruption and resuming."""

from dataclasses import replace

import numpy as np
import pytest

from caterpillar_env.errors import CaterpillarError
from caterpillar_env.gait import GaitTimings
from caterpillar_env.morphology import NAMES, Morphology
from caterpillar_env.physics import Physics
from caterpillar_env.robot import Robot, simulate
from caterpillar_env.task import Failure
from evolution.config import RunConfig
from evolution.optimizers.cma_es import CmaConfig
from evolution.optimizers.ga import GaConfig
from evolution.optimizers.shade import ShadeConfig
from evolution.run.evaluators import LocalEvaluator
from evolution.run.history import load
from evolution.run.journal import Journal, fingerprint
from evolution.run.loop import evolve, resume

SHORT = Physics(num_segments=2, timestep_s=0.01)
#: Physics so stiff, with so long a timestep, that every simulation diverges at once.
BROKEN = Physics(
    num_segments=2, integrator="implicitfast", timestep_s=0.01,
    axial_stiffness_n_m=1e5, axial_damping_n_s_m=0.0,
)  # fmt: skip
CONFIG = RunConfig(
    seed=3, generations=3, physics=SHORT, ga=GaConfig(population=4, hall_of_fame=2, mutation_rate=0.2)
)
TINY = RunConfig(seed=4, generations=3, physics=SHORT, ga=GaConfig(population=2, hall_of_fame=1))


ONE = LocalEvaluator(threads=1)


def rows(folder):
    return load(folder).table().to_dicts()


def column(folder, name):
    return load(folder).table()[name].to_numpy()


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    folder = tmp_path_factory.mktemp("runs") / "deeper" / "run"
    return folder, evolve(CONFIG, folder, evaluator=ONE)


# The record


def test_each_genome_is_evaluated_only_once(run):
    folder, result = run
    assert CONFIG.evaluations() == 4 + 2 * 2
    assert column(folder, "generation").tolist() == [0] * 4 + [1] * 2 + [2] * 2
    assert column(folder, "evaluation").tolist() == [*range(8)]
    assert result.finished
    assert [g.evaluations for g in result.generations] == [4, 6, 8]


def test_recorded_generations_equal_the_reported_ones(run):
    folder, result = run
    best = (folder / "best.json").stat().st_mtime_ns
    found = load(folder).generations
    assert all(g.replayed for g in found)
    assert found == [g._replace(replayed=True) for g in result.generations]
    assert (folder / "best.json").stat().st_mtime_ns == best


def test_columns_are_the_outcome_and_all_genes_by_name(run):
    folder, _ = run
    assert load(folder).table().columns == [
        "evaluation", "generation", "failure", "stopped", "fitness", "distance_m", "energy_j",
        "simulated_s", "session", *NAMES,
        "gap1_dorsal_on_s", "gap1_dorsal_off_s", "gap1_ventral_on_s", "gap1_ventral_off_s",
    ]  # fmt: skip


def test_simulating_a_recorded_row_again_gives_the_same_outcome(run):
    folder, _ = run
    some = [rows(folder)[i] for i in (0, 7)]
    bodies = [Morphology.of({name: row[name] for name in NAMES}) for row in some]
    on, off = (
        np.array([[r[f"gap1_{h}_{edge}_s"] for h in ("dorsal", "ventral")] for r in some])
        for edge in ("on", "off")
    )
    again = simulate(bodies, GaitTimings(CONFIG.gait_period_s, on, off), SHORT, threads=1)
    assert again.distance_m.tolist() == [row["distance_m"] for row in some]
    assert again.energy_j.tolist() == [row["energy_j"] for row in some]
    assert again.simulated_s.tolist() == [row["simulated_s"] for row in some]


def test_best_robot_is_the_first_of_the_best_rows(run):
    folder, result = run
    best = Robot.load(folder)
    row = max(rows(folder), key=lambda r: r["fitness"])
    assert best.fitness_m == row["fitness"] > 0
    assert best.generation == row["generation"]
    assert best.morphology.to_dict() == {name: row[name] for name in NAMES}
    assert best.timings.on_s[1] == row["gap1_ventral_on_s"]
    assert best.physics == SHORT
    assert best.to_dict() == result.best_robot.to_dict()


def test_missing_file_of_the_best_robot_is_written_again(tmp_path, invented):
    evolve(replace(CONFIG, generations=9), tmp_path, evaluator=invented)
    written = (tmp_path / "best.json").read_bytes()
    assert Robot.load(tmp_path).generation > 0
    (tmp_path / "best.json").unlink()
    resume(tmp_path, evaluator=invented)
    assert (tmp_path / "best.json").read_bytes() == written


def test_best_fitness_never_gets_worse(run):
    folder, result = run
    best_m = [g.best_m for g in result.generations]
    fitness, generation = column(folder, "fitness"), column(folder, "generation")
    assert best_m == [fitness[generation <= g].max() for g in range(3)]


def test_generation_summaries_match_the_recorded_rows(run):
    folder, result = run
    fitness, generation = column(folder, "fitness"), column(folder, "generation")
    labels = np.array([row["failure"] for row in rows(folder)])
    for summary in result.generations:
        mine = generation == summary.number
        assert summary.mean_m == pytest.approx(fitness[mine].mean(), rel=1e-12)
        assert sum(summary.failures.values()) == (labels[mine] != "ok").sum()
        stepped = column(folder, "simulated_s")[generation <= summary.number].sum()
        assert summary.simulated_s == pytest.approx(stepped)
    assert set(result.generations[0].failures) == {f.label for f in Failure if f}


def test_complete_configuration_is_recorded(run):
    folder, _ = run
    history = load(folder)
    assert history.config == CONFIG
    assert history.own_optimizer is None
    assert history.own_objective is None


def test_run_writes_only_its_record(run):
    folder, _ = run
    assert {p.name for p in folder.iterdir()} == {"journal.sqlite", ".lock", "best.json"}


# Reproducibility


def test_equal_seeds_give_equal_results_for_any_number_of_threads(run, tmp_path):
    folder, _ = run
    evolve(CONFIG, tmp_path, evaluator=LocalEvaluator(2))
    assert load(tmp_path).table().equals(load(folder).table())
    assert (tmp_path / "best.json").read_bytes() == (folder / "best.json").read_bytes()


# Interruption


def test_interrupt_keeps_the_finished_generations(tmp_path, invented):
    def stop(summary):
        if summary.number == 1:
            raise KeyboardInterrupt

    result = evolve(TINY, tmp_path, evaluator=invented, on_generation=stop)
    assert not result.finished
    assert [g.number for g in result.generations] == [0, 1]
    assert column(tmp_path, "generation").tolist() == [0, 0, 1]
    assert Robot.load(tmp_path).to_dict() == result.best_robot.to_dict()


def test_interrupt_within_a_generation_records_no_part_of_it(tmp_path):
    whole = 0

    def count(summary):
        nonlocal whole
        whole += 1

    def stop(share):
        if whole == 1 and share > 0.05:
            raise KeyboardInterrupt

    result = evolve(TINY, tmp_path, evaluator=ONE, on_generation=count, on_progress=stop)
    assert not result.finished
    assert len(result.generations) == 1
    assert len(rows(tmp_path)) == 2


def test_interrupt_before_the_first_generation_leaves_an_empty_record(tmp_path):
    def stop(share):
        raise KeyboardInterrupt

    result = evolve(TINY, tmp_path, evaluator=ONE, on_progress=stop)
    assert (result.best_robot, result.generations, result.finished) == (None, [], False)
    assert rows(tmp_path) == []
    assert not (tmp_path / "best.json").exists()


def test_progress_rises_from_zero_to_one_in_each_generation(tmp_path):
    shares = []
    config = RunConfig(generations=1, physics=SHORT, ga=GaConfig(population=2, hall_of_fame=0))
    evolve(config, tmp_path, evaluator=ONE, on_progress=shares.append)
    assert len(shares) == 30  # one per simulated second
    assert shares == sorted(shares)
    assert shares[-1] == pytest.approx(1.0)


def test_progress_counts_the_chunks_that_were_evaluated_before(tmp_path, monkeypatch):
    monkeypatch.setattr("evolution.run.evaluators.CHUNK", 2)
    shares = []
    config = RunConfig(generations=1, physics=SHORT, ga=GaConfig(population=3, hall_of_fame=0))
    evolve(config, tmp_path, evaluator=ONE, on_progress=shares.append)
    assert shares == pytest.approx([*np.linspace(0, 2 / 3, 31)[1:], *np.linspace(2 / 3, 1, 31)[1:]])


# Failures


@pytest.mark.parametrize("failed_fitness", [0.0, 0.001])
def test_run_in_which_all_robots_fail_finishes(tmp_path, monkeypatch, failed_fitness):
    monkeypatch.chdir(tmp_path)  # MuJoCo writes its log to the working directory
    ga = GaConfig(population=4, hall_of_fame=1)
    config = RunConfig(generations=3, failed_fitness=failed_fitness, physics=BROKEN, ga=ga)
    result = evolve(config, tmp_path / "run", evaluator=ONE)
    record = rows(tmp_path / "run")
    assert result.finished
    assert [row["failure"] for row in record] == ["diverged"] * 10
    assert {row["fitness"] for row in record} == {failed_fitness}
    assert max(row["simulated_s"] for row in record) < 30.0
    assert [g.failures["diverged"] for g in result.generations] == [4, 3, 3]


def test_a_robot_that_failed_is_never_the_best(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    config = RunConfig(
        generations=1, failed_fitness=0.001, physics=BROKEN, ga=GaConfig(population=2, hall_of_fame=0)
    )
    assert evolve(config, tmp_path / "run", evaluator=ONE).best is None
    assert not (tmp_path / "run" / "best.json").exists()


# Folders


def test_non_empty_folder_is_refused_and_not_changed(tmp_path):
    (tmp_path / "notes.txt").write_text("mine")
    with pytest.raises(CaterpillarError, match="is not empty; choose another"):
        evolve(TINY, tmp_path)
    assert [p.name for p in tmp_path.iterdir()] == ["notes.txt"]


def test_folder_below_a_file_is_refused(tmp_path):
    (tmp_path / "file").write_text("")
    for folder in (tmp_path / "file", tmp_path / "file" / "run"):
        with pytest.raises(CaterpillarError, match="cannot write") as refused:
            evolve(TINY, folder)
        assert "\n" not in str(refused.value)


# Resuming


KINDS = [
    {"optimizer": "ga"},
    {"optimizer": "cma-es", "cma": CmaConfig(cma_population=4)},
    {"optimizer": "shade", "genome": "full", "timing": "phase", "shade": ShadeConfig(4, 2)},
]
MORE_KINDS = [
    {"optimizer": "random"},
    {"optimizer": "random", "sampling": "sobol"},
    {"optimizer": "ga", "objective": "distance-per-energy"},
    {"optimizer": "ga", "genome": "full"},
    {"optimizer": "cma-es", "genome": "per-segment", "cma": CmaConfig(cma_population=4)},
]


@pytest.mark.parametrize(
    "settings",
    [*KINDS, *(pytest.param(kind, marks=pytest.mark.slow) for kind in MORE_KINDS)],
    ids=lambda kind: "-".join(map(str, kind.values()))[:30],
)
def test_resumed_run_equals_an_uninterrupted_run(tmp_path, settings):
    config = RunConfig(
        seed=5, generations=4, physics=SHORT, ga=GaConfig(population=4, hall_of_fame=1), **settings
    )  # fmt: skip

    def stop(summary):
        if summary.number == 1:
            raise KeyboardInterrupt

    whole = evolve(config, tmp_path / "whole", evaluator=ONE)
    assert not evolve(config, tmp_path / "broken", evaluator=ONE, on_generation=stop).finished
    again = resume(tmp_path / "broken", evaluator=ONE)
    assert again.finished
    assert [g.replayed for g in again.generations] == [True, True, False, False]
    assert (
        load(tmp_path / "broken")
        .table()
        .drop("session")
        .equals(load(tmp_path / "whole").table().drop("session"))
    )
    assert again.best_robot.to_dict() == whole.best_robot.to_dict()


def test_resuming_a_finished_run_evaluates_nothing(run, tmp_path):
    folder, result = run
    before = load(folder).table()
    again = resume(folder, evaluator=None)
    assert all(g.replayed for g in again.generations)
    assert load(folder).table().equals(before)
    assert again.best_robot.to_dict() == result.best_robot.to_dict()


def test_a_run_can_be_made_longer_but_not_shorter(tmp_path, invented):
    evolve(TINY, tmp_path / "short", evaluator=invented)
    longer = resume(tmp_path / "short", generations=5, evaluator=invented)
    evolve(replace(TINY, generations=5), tmp_path / "long", evaluator=invented)
    assert (
        load(tmp_path / "short")
        .table()
        .drop("session")
        .equals(load(tmp_path / "long").table().drop("session"))
    )
    assert len(longer.generations) == 5
    with pytest.raises(CaterpillarError, match="a run can only be made longer: it has 5 generations"):
        resume(tmp_path / "short", generations=3)
    with pytest.raises(CaterpillarError, match="and budget_s = 30 is less"):
        resume(tmp_path / "short", budget_s=30)


def test_budget_of_an_unfinished_run_may_be_reduced_to_what_is_left(tmp_path, invented):
    def stop(generation):
        raise KeyboardInterrupt

    config = replace(TINY, generations=9, budget_s=9000.0)
    run = evolve(config, tmp_path, evaluator=invented, on_generation=stop)
    assert not run.finished
    run = resume(tmp_path, budget_s=run.simulated_s + 1, evaluator=invented)
    assert run.finished
    assert len(run.generations) == 2


def test_every_chunk_is_recorded_with_its_own_genomes(tmp_path, monkeypatch, invented):
    monkeypatch.setattr("evolution.run.evaluators.CHUNK", 2)
    proposed = CONFIG.make_optimizer().ask()
    evolve(replace(CONFIG, generations=1), tmp_path, evaluator=invented)
    recorded = [e.genome for e in load(tmp_path).evaluations]
    assert np.array_equal(recorded, proposed)


def test_partly_evaluated_generation_is_completed_on_resume(tmp_path, monkeypatch, invented):
    monkeypatch.setattr("evolution.run.evaluators.CHUNK", 2)
    whole = evolve(CONFIG, tmp_path / "whole", evaluator=invented)
    seen = []

    class Dies(LocalEvaluator):
        def map(self, encoding, jobs, on_progress=None):
            for result in invented.map(encoding, jobs):
                yield result
                seen.append(len(result.outcomes.failure))
                raise KeyboardInterrupt

    assert not evolve(CONFIG, tmp_path / "part", evaluator=Dies(1)).finished
    assert seen == [2]
    assert len(load(tmp_path / "part").table()) == 2
    again = resume(tmp_path / "part", evaluator=invented)
    assert again.best_robot.to_dict() == whole.best_robot.to_dict()
    assert load(tmp_path / "part").table()["session"].to_list() == [1, 1, 2, 2, 2, 2, 2, 2]


def test_genome_that_differs_in_replay_is_an_error(tmp_path, invented):
    evolve(TINY, tmp_path, evaluator=invented)
    with Journal(tmp_path) as journal:
        journal.begin((), {**replace(TINY, seed=9).to_dict(), "own_optimizer": None})
    with pytest.raises(CaterpillarError, match=r"evaluation 0 in .* has a different genome") as error:
        resume(tmp_path)
    assert "start a new run" in str(error.value)


class Sampler:
    """A custom optimizer whose first genomes do not depend on the number of genomes."""

    def __init__(self, count):
        self.count, self.rng = count, np.random.default_rng(0)

    def ask(self):
        return self.rng.random((self.count, len(TINY.encoding.genes)))

    def tell(self, genomes, fitness):
        assert len(genomes) == len(fitness)


@pytest.mark.parametrize("count", [2, 4])
def test_other_number_of_genomes_is_an_error_and_leaves_the_journal_as_it_is(tmp_path, invented, count):
    evolve(TINY, tmp_path, optimizer=Sampler(3), evaluator=invented)
    content = load(tmp_path).table()
    message = rf"generation 0 in .* has 3 genomes, but the optimizer proposes {count} genomes now"
    with pytest.raises(CaterpillarError, match=message):
        resume(tmp_path, generations=3, optimizer=Sampler(count), evaluator=invented)
    assert load(tmp_path).table().equals(content)
    assert resume(tmp_path, generations=3, optimizer=Sampler(3), evaluator=invented).finished


@pytest.mark.parametrize("given", [{"optimizer": Sampler(3)}, {"objective": lambda ends: ends.energy_j}])
def test_own_part_of_a_run_without_one_is_an_error(tmp_path, invented, given):
    evolve(TINY, tmp_path, evaluator=invented)
    (what,) = given
    with pytest.raises(CaterpillarError, match=f"was run without your own {what}; resume the run"):
        resume(tmp_path, evaluator=invented, **given)


def test_best_value_of_minus_zero_is_recorded(tmp_path, invented):
    def penalty(outcomes):
        return -np.maximum(outcomes.distance_m - 1.0, 0.0)  # -0.0 for all robots

    result = evolve(TINY, tmp_path, objective=penalty, evaluator=invented)
    assert load(tmp_path).best.number == result.best.number
    assert load(tmp_path).finished


def test_objective_may_change_its_argument(tmp_path):
    def in_place(outcomes):
        values = outcomes.distance_m
        values -= 0.001 * outcomes.energy_j
        return values

    def pure(outcomes):
        return outcomes.distance_m - 0.001 * outcomes.energy_j

    config, tables = replace(TINY, race_share=0.5), []
    for name, objective in (("one", in_place), ("other", pure)):
        evolve(config, tmp_path / name, objective=objective, evaluator=ONE)
        tables.append(load(tmp_path / name).table())
    assert tables[0].equals(tables[1])


@pytest.mark.parametrize("generations", [None, 9])
def test_run_whose_replay_is_stopped_stays_finished(tmp_path, invented, generations):
    evolve(TINY, tmp_path, evaluator=invented)
    before = (tmp_path / "journal.sqlite").read_bytes()

    def stop(generation):
        raise KeyboardInterrupt

    stopped = resume(tmp_path, generations=generations, evaluator=invented, on_generation=stop)
    assert stopped.stop_reason() is None
    assert (tmp_path / "journal.sqlite").read_bytes() == before


@pytest.mark.parametrize("value", [np.nan, np.inf])
def test_outcomes_that_are_not_finite_are_refused_at_once(tmp_path, invented, value):
    class Broken(LocalEvaluator):
        def map(self, encoding, jobs, on_progress=None):
            for result in invented.map(encoding, jobs):
                energy_j = np.full_like(result.outcomes.energy_j, value)
                yield result._replace(outcomes=result.outcomes._replace(energy_j=energy_j))

    with pytest.raises(CaterpillarError, match=r"energy_j = .* must be a finite number"):
        evolve(TINY, tmp_path, evaluator=Broken())
    assert len(load(tmp_path).evaluations) == 0


def test_outcomes_of_integers_are_recorded(tmp_path, invented):
    class Whole(LocalEvaluator):
        def map(self, encoding, jobs, on_progress=None):
            for result in invented.map(encoding, jobs):
                energy_j = np.ones(len(result.outcomes.energy_j), dtype=int)
                yield result._replace(outcomes=result.outcomes._replace(energy_j=energy_j))

    evolve(TINY, tmp_path, evaluator=Whole())
    assert set(load(tmp_path).table()["energy_j"]) == {1.0}


def test_extension_that_fails_leaves_a_finished_run_as_it_is(tmp_path, invented):
    evolve(TINY, tmp_path, optimizer=Sampler(3), evaluator=invented)
    before = (tmp_path / "journal.sqlite").read_bytes()
    with pytest.raises(CaterpillarError, match="has 3 genomes, but the optimizer proposes 4"):
        resume(tmp_path, generations=9, optimizer=Sampler(4), evaluator=invented)
    assert (tmp_path / "journal.sqlite").read_bytes() == before
    longer = resume(tmp_path, generations=4, optimizer=Sampler(3), evaluator=invented)
    assert load(tmp_path).finished
    assert len(load(tmp_path).generations) == load(tmp_path).config.generations == 4
    assert longer.finished


def test_own_optimizer_may_be_empty_and_change_its_genomes(tmp_path, invented):
    class InPlace(Sampler):
        def __len__(self):
            return 0

        def ask(self):
            self.genomes = super().ask()
            return self.genomes

        def tell(self, genomes, fitness):
            self.genomes[:] = 0.0
            genomes[:] = 0.0

    history = evolve(TINY, tmp_path, optimizer=InPlace(3), evaluator=invented)
    assert len(history.evaluations) == 3 * TINY.generations
    for ours, recorded in zip(history.evaluations, load(tmp_path).evaluations, strict=True):
        np.testing.assert_array_equal(ours.genome, recorded.genome)


def test_optimizer_without_genomes_is_an_error(tmp_path, invented):
    with pytest.raises(CaterpillarError, match="the optimizer proposed no genomes"):
        evolve(TINY, tmp_path, optimizer=Sampler(0), evaluator=invented)


def test_resume_reports_other_versions(tmp_path, monkeypatch, invented):
    evolve(TINY, tmp_path, evaluator=invented)
    warnings = []
    resume(tmp_path, evaluator=invented, on_warning=warnings.append)
    assert warnings == []
    now = {**fingerprint(), "mujoco": "9.9.9"}
    monkeypatch.setattr("evolution.run.loop.fingerprint", lambda packages: now)
    resume(tmp_path, evaluator=invented, on_warning=warnings.append)
    assert len(warnings) == 2
    assert "session 1 (evaluations 0 to 3) ran with mujoco 4." in warnings[0]
    assert "(now 9.9.9)" in warnings[0]


def test_journal_without_target_m_continues_with_breeding_elites(tmp_path, invented):
    config = replace(CONFIG, ga=replace(CONFIG.ga, elites_breed=True))
    evolve(config, tmp_path / "whole", evaluator=invented)
    evolve(replace(config, generations=1), tmp_path / "part", evaluator=invented)
    with Journal(tmp_path / "part") as journal:
        before = journal.configuration
        assert before["ga"]["elites_breed"] is True
        del before["target_m"]
        journal.begin((), before)
    assert resume(tmp_path / "part", generations=3, evaluator=invented).finished
    part, whole = load(tmp_path / "part").table(), load(tmp_path / "whole").table()
    assert part.drop("session").equals(whole.drop("session"))
    evolve(CONFIG, tmp_path / "now", evaluator=invented)
    assert not whole.equals(load(tmp_path / "now").table())  # here, elites do not breed


class Halves:
    """A custom optimizer that asks for the middle first and then approaches a corner."""

    def __init__(self, num_genes):
        self.at = np.full((2, num_genes), 0.5)

    def ask(self):
        return self.at

    def tell(self, genomes, fitness):
        assert fitness.shape == (2,)
        self.at = self.at / 2


def test_custom_optimizer_runs_and_resumes(tmp_path, invented):
    config = RunConfig(generations=3, physics=SHORT)
    evolve(config, tmp_path / "whole", evaluator=invented, optimizer=Halves(12))
    evolve(replace(config, generations=2), tmp_path / "part", evaluator=invented, optimizer=Halves(12))
    with pytest.raises(CaterpillarError, match=r"your own optimizer \(Halves\)"):
        resume(tmp_path / "part")
    resume(tmp_path / "part", generations=3, evaluator=invented, optimizer=Halves(12))
    assert (
        load(tmp_path / "part")
        .table()
        .drop("session")
        .equals(load(tmp_path / "whole").table().drop("session"))
    )


def thrift(outcomes):
    """A custom objective that prefers the robot with the lowest energy."""
    return 1000 - outcomes.energy_j


def test_custom_objective_selects_the_best_robot(tmp_path, invented):
    result = evolve(CONFIG, tmp_path / "run", evaluator=invented, objective=thrift)
    data = load(tmp_path / "run").table().filter(failure="ok")
    laziest = data.sort("energy_j", "evaluation").to_dicts()[0]
    assert data["distance_m"].max() > laziest["distance_m"]
    assert result.best_robot.fitness_m == laziest["distance_m"]
    assert result.best_robot.generation == laziest["generation"]


def test_optimizer_receives_values_of_a_custom_objective(tmp_path, invented):
    received = []

    class Hears(Halves):
        def tell(self, genomes, fitness):
            received.extend(fitness)

    config = RunConfig(generations=2, physics=SHORT, failed_fitness=7.0)
    evolve(config, tmp_path / "run", evaluator=invented, optimizer=Hears(12), objective=thrift)
    data = load(tmp_path / "run").table()
    expected = [1000 - r["energy_j"] if r["failure"] == "ok" else 7.0 for r in data.to_dicts()]
    assert received == expected


def test_resuming_a_run_with_a_custom_objective_requires_the_objective(tmp_path, invented):
    evolve(CONFIG, tmp_path / "whole", evaluator=invented, objective=thrift)
    evolve(replace(CONFIG, generations=2), tmp_path / "part", evaluator=invented, objective=thrift)
    with pytest.raises(CaterpillarError, match=r"your own objective \(thrift\); .*objective=\.\.\."):
        resume(tmp_path / "part", generations=3)
    resume(tmp_path / "part", generations=3, evaluator=invented, objective=thrift)
    part, whole = load(tmp_path / "part").table(), load(tmp_path / "whole").table()
    assert part.drop("session").equals(whole.drop("session"))
    assert part["fitness"].null_count() == len(part)
    history = load(tmp_path / "part")
    assert history.config == CONFIG
    assert (history.own_optimizer, history.own_objective) == (None, "thrift")


@pytest.mark.parametrize(
    "objective",
    [
        lambda outcomes: outcomes.energy_j * np.nan,
        lambda outcomes: outcomes.energy_j.sum(),
    ],
)
def test_an_objective_that_returns_invalid_values_is_refused(tmp_path, objective, invented):
    with pytest.raises(
        CaterpillarError, match=r"must return shape \(4,\), with a finite number for every .* got shape"
    ):
        evolve(CONFIG, tmp_path / "run", evaluator=invented, objective=objective)


def test_an_objective_may_be_negative(tmp_path, invented):
    def cost(outcomes):
        return -outcomes.energy_j

    config = replace(CONFIG, failed_fitness=-1e6)
    history = evolve(config, tmp_path / "run", evaluator=invented, objective=cost)
    healthy = history.table().filter(failure="ok")
    assert history.best.energy_j == healthy["energy_j"].min()
