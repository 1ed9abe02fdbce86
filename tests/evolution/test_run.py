"""A run's record: what it holds, that it repeats, and that it survives being stopped."""

import csv
import json

import numpy as np
import pytest

from caterpillar_env.errors import CaterpillarError
from caterpillar_env.gait import GaitTimings
from caterpillar_env.model import Physics
from caterpillar_env.morphology import NAMES, Morphology
from caterpillar_env.task import Failure
from evolution.distributions import TruncatedGaussian, Uniform
from evolution.fitness import simulate
from evolution.individual import Individual
from evolution.optimizers.ga import GaConfig, GeneticAlgorithm
from evolution.run import RunConfig, RunError, evolve

SHORT = Physics(num_segments=2, timestep_s=0.01)
#: So stiff, and so coarsely stepped, that every robot's integration breaks down at once.
BROKEN = Physics(
    num_segments=2, integrator="implicitfast", timestep_s=0.01,
    axial_stiffness_n_m=1e9, axial_damping_n_s_m=0.0,
)  # fmt: skip
CONFIG = RunConfig(
    seed=3, generations=3, physics=SHORT, ga=GaConfig(population=4, hall_of_fame=2, mutation_rate=0.2)
)
TINY = RunConfig(seed=4, generations=3, physics=SHORT, ga=GaConfig(population=2, hall_of_fame=1))


def rows(folder):
    with (folder / "evaluations.csv").open(newline="", encoding="utf-8") as file:
        return list(csv.DictReader(file))


def column(folder, name):
    return np.array([float(row[name]) for row in rows(folder)])


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    folder = tmp_path_factory.mktemp("runs") / "deeper" / "run"
    return folder, evolve(CONFIG, folder, threads=1)


# The record


def test_a_run_evaluates_everybody_once_and_elites_never_again(run):
    folder, result = run
    assert CONFIG.evaluations() == 4 + 2 * 2
    generation = [row["generation"] for row in rows(folder)]
    assert generation == ["0"] * 4 + ["1"] * 2 + ["2"] * 2
    assert [row["index"] for row in rows(folder)] == [*"0123", *"01", *"01"]
    assert result.finished
    assert [g.evaluations for g in result.generations] == [4, 6, 8]


def test_columns_are_the_outcome_and_all_genes_by_name(run):
    folder, _ = run
    header = (folder / "evaluations.csv").read_text().splitlines()[0].split(",")
    assert header == [
        "generation", "index", "failure", "fitness_m", "distance_m", "energy_j", "simulated_s", *NAMES,
        "gap1_dorsal_on_s", "gap1_dorsal_off_s", "gap1_ventral_on_s", "gap1_ventral_off_s",
    ]  # fmt: skip


def test_a_row_of_the_record_crawls_exactly_as_far_again(run):
    folder, _ = run
    some = [rows(folder)[i] for i in (0, 7)]
    bodies = [Morphology.of({name: float(row[name]) for name in NAMES}) for row in some]
    on, off = (
        np.array([[float(r[f"gap1_{h}_{edge}_s"]) for h in ("dorsal", "ventral")] for r in some])
        for edge in ("on", "off")
    )
    again = simulate(bodies, GaitTimings(CONFIG.gait_period_s, on, off), SHORT, threads=1)
    assert again.distance_m.tolist() == [float(row["distance_m"]) for row in some]
    assert again.energy_j.tolist() == [float(row["energy_j"]) for row in some]
    assert again.simulated_s.tolist() == [float(row["simulated_s"]) for row in some]


def test_best_robot_is_the_first_of_the_best_rows(run):
    folder, result = run
    best = Individual.load(folder)
    row = max(rows(folder), key=lambda r: float(r["fitness_m"]))
    assert best.fitness_m == float(row["fitness_m"]) > 0
    assert best.generation == int(row["generation"])
    assert best.morphology.to_dict() == {name: float(row[name]) for name in NAMES}
    assert best.timings.on_s[1] == float(row["gap1_ventral_on_s"])
    assert best.physics == SHORT
    assert best.to_dict() == result.best.to_dict()


def test_best_fitness_never_gets_worse(run):
    folder, result = run
    told = [g.best_m for g in result.generations]
    fitness, generation = column(folder, "fitness_m"), column(folder, "generation")
    assert told == [fitness[generation <= g].max() for g in range(3)]


def test_generations_are_told_as_they_are_recorded(run):
    folder, result = run
    fitness, generation = column(folder, "fitness_m"), column(folder, "generation")
    labels = np.array([row["failure"] for row in rows(folder)])
    for told in result.generations:
        mine = generation == told.number
        assert told.mean_m == pytest.approx(fitness[mine].mean(), rel=1e-12)
        assert sum(told.failures.values()) == (labels[mine] != "ok").sum()
        stepped = column(folder, "simulated_s")[generation <= told.number].sum()
        assert told.simulated_s == pytest.approx(stepped)
    assert set(result.generations[0].failures) == {f.label for f in Failure if f}
    elapsed = [g.elapsed_s for g in result.generations]
    assert elapsed == sorted(elapsed)


def test_configuration_is_kept_whole(run):
    folder, _ = run
    data = json.loads((folder / "config.json").read_text())
    physics, ga = data.pop("physics"), data.pop("ga")
    assert RunConfig(**data, physics=Physics.of(physics), ga=GaConfig(**ga)) == CONFIG


def test_a_run_leaves_just_its_record(run):
    folder, _ = run
    assert {p.name for p in folder.iterdir()} == {"config.json", "evaluations.csv", "best.json"}


# Repeating


@pytest.mark.parametrize("threads", [1, 2])
def test_equal_seeds_give_equal_bytes_at_any_number_of_threads(run, tmp_path, threads):
    folder, _ = run
    evolve(CONFIG, tmp_path, threads=threads)
    for name in ("evaluations.csv", "best.json", "config.json"):
        assert (tmp_path / name).read_bytes() == (folder / name).read_bytes()


def first_population(**settings):
    config = RunConfig(**settings)
    rng = np.random.default_rng(config.seed)
    return GeneticAlgorithm(config.distributions(), config.ga, rng).ask()


def test_seed_changes_the_genomes_and_not_the_robot():
    assert not np.array_equal(first_population(seed=0), first_population(seed=1))
    one, two = RunConfig(seed=0).physics.strengths(), RunConfig(seed=1).physics.strengths()
    assert one.tolist() == two.tolist()


def test_arms_of_one_seed_draw_the_genes_without_a_prior_alike():
    prepared, uniform = first_population(), first_population(prior="uniform")
    free = [3, 4, *range(8, 20)]  # mass, joint limit, timings
    peaked = [0, 1, 2, 5, 6, 7]
    np.testing.assert_array_equal(prepared[:, free], uniform[:, free])
    assert not np.any(prepared[:, peaked] == uniform[:, peaked])
    # One uniform number a draw: the peaked genes are the same quantiles of another distribution.
    order = np.argsort(uniform[:, 0])
    assert np.all(np.diff(prepared[order, 0]) > 0)


# Being stopped


def test_interrupt_keeps_the_finished_generations(tmp_path):
    def stop(told):
        if told.number == 1:
            raise KeyboardInterrupt

    result = evolve(TINY, tmp_path, threads=1, on_generation=stop)
    assert not result.finished
    assert [g.number for g in result.generations] == [0, 1]
    assert [row["generation"] for row in rows(tmp_path)] == ["0", "0", "1"]
    assert Individual.load(tmp_path).to_dict() == result.best.to_dict()


def test_interrupt_within_a_generation_leaves_no_part_of_it(tmp_path):
    whole = 0

    def count(told):
        nonlocal whole
        whole += 1

    def stop(share):
        if whole == 1 and share > 0.05:
            raise KeyboardInterrupt

    result = evolve(TINY, tmp_path, threads=1, on_generation=count, on_progress=stop)
    assert not result.finished
    assert len(result.generations) == 1
    assert len(rows(tmp_path)) == 2


def test_interrupt_before_the_first_generation_leaves_an_empty_record(tmp_path):
    def stop(share):
        raise KeyboardInterrupt

    result = evolve(TINY, tmp_path, threads=1, on_progress=stop)
    assert result == (None, [], False)
    assert rows(tmp_path) == []
    assert not (tmp_path / "best.json").exists()


def test_progress_runs_from_nothing_to_all_in_each_generation(tmp_path):
    shares = []
    config = RunConfig(generations=1, physics=SHORT, ga=GaConfig(population=2, hall_of_fame=0))
    evolve(config, tmp_path, threads=1, on_progress=shares.append)
    assert len(shares) == 300
    assert shares == sorted(shares)
    assert shares[-1] == pytest.approx(1.0)


# Failures


@pytest.mark.parametrize("failed_fitness", [0.0, 0.001])
def test_a_whole_population_of_failures_runs_to_the_end(tmp_path, monkeypatch, failed_fitness):
    monkeypatch.chdir(tmp_path)  # MuJoCo leaves its log where it runs
    ga = GaConfig(population=4, hall_of_fame=1)
    config = RunConfig(generations=3, failed_fitness=failed_fitness, physics=BROKEN, ga=ga)
    result = evolve(config, tmp_path / "run", threads=1)
    record = rows(tmp_path / "run")
    assert result.finished
    assert [row["failure"] for row in record] == ["diverged"] * 10
    assert {float(row["fitness_m"]) for row in record} == {failed_fitness}
    assert max(float(row["simulated_s"]) for row in record) < 30.0
    assert [g.failures["diverged"] for g in result.generations] == [4, 3, 3]


def test_a_robot_that_failed_is_never_the_best(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    config = RunConfig(
        generations=1, failed_fitness=0.001, physics=BROKEN, ga=GaConfig(population=2, hall_of_fame=0)
    )
    assert evolve(config, tmp_path / "run", threads=1).best is None
    assert not (tmp_path / "run" / "best.json").exists()


# Folders


def test_folder_that_holds_something_is_refused_and_left_alone(tmp_path):
    (tmp_path / "notes.txt").write_text("mine")
    with pytest.raises(RunError, match="is not empty; choose another"):
        evolve(TINY, tmp_path)
    assert [p.name for p in tmp_path.iterdir()] == ["notes.txt"]


def test_folder_below_a_file_is_refused(tmp_path):
    (tmp_path / "file").write_text("")
    for folder in (tmp_path / "file", tmp_path / "file" / "run"):
        with pytest.raises(RunError, match="cannot write the run folder") as refused:
            evolve(TINY, folder)
        assert "\n" not in str(refused.value)


# Configuration


def test_default_run_is_the_papers():
    config = RunConfig()
    assert (config.generations, config.ga.population, config.ga.hall_of_fame) == (50, 200, 10)
    assert (config.prior, config.floor_ratio) == ("preprocessed", 3.0)
    assert config.evaluations() == 9_510  # 200 + 49 * 190
    assert RunConfig(generations=114).evaluations() == 21_670


def test_prior_decides_the_distributions():
    assert set(RunConfig(prior="uniform").distributions()) == {Uniform()}
    prepared = RunConfig().distributions()
    assert sum(isinstance(d, TruncatedGaussian) for d in prepared) == 6
    assert len(prepared) == 20


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"seed": -1}, "seed = -1"),
        ({"generations": 0}, "generations = 0"),
        ({"generations": -5}, "generations = -5"),
        ({"prior": "hopeful"}, "prior = 'hopeful'"),
        ({"floor_ratio": 1.0}, "floor_ratio = 1.0"),
        ({"floor_ratio": np.inf}, "floor_ratio = inf"),
        ({"failed_fitness": -0.1}, "failed_fitness = -0.1"),
        ({"failed_fitness": np.nan}, "failed_fitness = nan"),
        ({"failed_fitness": np.inf}, "failed_fitness = inf"),
        ({"gait_period_s": 0.0}, "gait_period_s"),
        ({"gait_period_s": -3.0}, "gait_period_s"),
        ({"gait_period_s": 0.25}, "gait_period_s"),
        ({"gait_period_s": np.nan}, "gait_period_s"),
        ({"gait_period_s": np.inf}, "gait_period_s"),
    ],
    ids=str,
)
def test_unusable_settings_are_refused_in_one_line(settings, message):
    with pytest.raises(CaterpillarError, match=message) as refused:
        RunConfig(**settings)
    assert "\n" not in str(refused.value)
