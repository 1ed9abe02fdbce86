"""`caterpillar evolve`: presets, printed output and written files."""

from dataclasses import replace

import pytest

from caterpillar_env.physics import Physics
from evolution import cli
from evolution.cli import running
from evolution.cli.evolve import PRESETS
from evolution.config import RunConfig
from evolution.optimizers.ga import GaConfig
from evolution.run.evaluators import LocalEvaluator
from evolution.run.history import load
from evolution.run.loop import evolve
from evolution.study.config import preset

CONFIG = RunConfig(
    seed=4, generations=1, physics=Physics(num_segments=2, timestep_s=0.01, friction=0.7),
    ga=GaConfig(population=3, hall_of_fame=1),
)  # fmt: skip

#: Physics in which every simulation diverges immediately.
BROKEN = ["--integrator", "implicitfast", "--axial-stiffness-n-m", "1e5", "--axial-damping-n-s-m", "0"]


def test_paper_preset_has_the_default_configuration():
    assert PRESETS["paper"] == RunConfig()
    assert PRESETS["paper"].evaluations() == 9_510


def test_quick_preset_has_the_search_method_of_the_published_study():
    quick, study = PRESETS["quick"], preset("search").arms["shade"].config
    assert quick.evaluations() < 200
    budget = {"generations": quick.generations, "budget_s": quick.budget_s}
    assert replace(study, ga=quick.ga, **budget) == quick


@pytest.mark.parametrize(
    ("flags", "generations", "population"),
    [
        (["--preset", "quick"], 4, 15),
        (["--preset=quick", "--seed", "3"], 4, 15),
        (["--generations", "2", "--preset", "quick"], 2, 15),
        (["--preset", "quick", "--shade-population", "8"], 4, 8),
        (["--preset", "paper", "--population", "10"], 50, 10),
        ([], 50, 200),
    ],
    ids=str,
)
def test_preset_gives_the_defaults_of_the_other_flags(monkeypatch, flags, generations, population):
    configs = []

    def record(config, folder, **kwargs):
        configs.append(config)
        raise KeyboardInterrupt

    monkeypatch.setattr("evolution.cli.evolve.evolve", record)
    assert cli.main(["evolve", *flags]) == 130
    assert configs[0].generations == generations
    chosen = configs[0]
    shade = chosen.optimizer == "shade"
    assert (chosen.shade.shade_population if shade else chosen.ga.population) == population


def test_evolve_uses_the_given_workers(elsewhere, monkeypatch):
    used = []

    def record(config, folder, *, evaluator, **others):
        used.append(evaluator)
        raise KeyboardInterrupt

    monkeypatch.setattr("evolution.cli.evolve.evolve", record)
    monkeypatch.setattr(running, "LocalEvaluator", lambda threads: f"{threads} threads")
    monkeypatch.setattr(running, "RayEvaluator", lambda address: f"Ray at {address}")
    assert cli.main(["evolve", "--threads", "3"]) == 130
    assert cli.main(["evolve", "--evaluator", "ray", "--ray-address", "here:1"]) == 130
    assert used == ["3 threads", "Ray at here:1"]


def test_flags_override_the_preset(run):
    folder, _, _ = run
    assert load(folder).config == CONFIG
    assert PRESETS["paper"].generations != CONFIG.generations


def test_evolve_command_and_function_record_the_same_run(run, tmp_path):
    folder, _, _ = run
    evolve(CONFIG, tmp_path, evaluator=LocalEvaluator(1))
    assert load(folder).table().equals(load(tmp_path).table())
    assert (folder / "best.json").read_bytes() == (tmp_path / "best.json").read_bytes()


def test_progress_is_printed_on_stderr_and_the_result_on_stdout(run):
    folder, out, err = run
    generation, ending = err.splitlines()
    assert generation.startswith("generation   0  best ")
    assert f"simulated {load(folder).table()['simulated_s'].sum():.0f} s  100 % done" in generation
    assert ending == "finished: all 1 generations are complete"
    best = load(folder).best
    result, page, *commands = out.splitlines()
    assert result == (
        f"best: {1000 * best.distance_m:.1f} mm in 30 s, evaluation {best.number} in generation 0"
    )
    assert page == f"page: {folder / 'report.html'}"
    assert [line.partition("  # ")[0] for line in commands] == [
        f"next: caterpillar replay {folder}", f"next: caterpillar view {folder}",
        f"next: caterpillar resume {folder} --generations 2",
    ]  # fmt: skip


def test_brackets_in_a_folder_name_are_printed_literally(flags, elsewhere, capsys, without_page):
    assert cli.main([*flags, *BROKEN, "--out", "a[red]b[/x]"]) == 0
    captured = capsys.readouterr()
    assert "a[red]b[/x]" in (captured.err + captured.out).replace("\n", "")


def test_runs_without_out_get_separate_folders(flags, elsewhere, without_page):
    (elsewhere / "runs" / "ga-uniform-seed4").mkdir(parents=True)
    for _ in range(2):
        assert cli.main([*flags, *BROKEN, "--prior", "uniform", "--seed", "4"]) == 0
    names = sorted(p.name for p in (elsewhere / "runs").iterdir())
    assert names == ["ga-uniform-seed4", "ga-uniform-seed4-2", "ga-uniform-seed4-3"]


def test_run_without_a_best_robot_is_reported(flags, elsewhere, capsys):
    assert cli.main([*flags, *BROKEN, "--out", "run"]) == 0
    captured = capsys.readouterr()
    assert "3 diverged" in captured.err
    assert "best: none, no robot crawled forwards without failing" in captured.out
