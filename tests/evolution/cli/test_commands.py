"""The subcommands: presets, printed output and written files."""

import contextlib
import io
import json
import re
import shutil
import time
from dataclasses import replace

import pytest
from rich.console import Console

from caterpillar_env.physics import Physics
from evolution import cli
from evolution.cli import running
from evolution.cli.evolve import PRESETS
from evolution.cli.running import Reporter
from evolution.config import RunConfig
from evolution.optimizers.ga import GaConfig
from evolution.run.evaluators import LocalEvaluator
from evolution.run.history import Generation, load
from evolution.run.loop import evolve
from evolution.study.config import preset

CONFIG = RunConfig(
    seed=4, generations=1, physics=Physics(num_segments=2, timestep_s=0.01, friction=0.7),
    ga=GaConfig(population=3, hall_of_fame=1),
)  # fmt: skip
FLAGS = [
    "evolve", "--num-segments", "2", "--timestep-s", "0.01", "--friction", "0.7", "--population", "3",
    "--hall-of-fame", "1", "--generations", "1", "--no-video",
]  # fmt: skip

#: Physics in which every simulation diverges immediately.
BROKEN = ["--integrator", "implicitfast", "--axial-stiffness-n-m", "1e5", "--axial-damping-n-s-m", "0"]


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    """A run's folder, and its stdout and stderr."""
    folder = tmp_path_factory.mktemp("commands") / "run"
    out, err = io.StringIO(), io.StringIO()
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
        status = cli.main([*FLAGS, "--seed", "4", "--out", str(folder)])
    assert status == 0
    return folder, out.getvalue(), err.getvalue()


@pytest.fixture
def elsewhere(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.fixture
def without_page(monkeypatch):
    """Skip writing the page, which takes longer than the run."""
    monkeypatch.setattr(
        "evolution.report.run_page.write", lambda history, _: history.folder / "report.html"
    )


def summary(number, evaluations, *, replayed=False, **failures):
    failed = {"tipped": 0, "veered": 0, **failures}
    return Generation(number, 0.0123, 0.004, failed, evaluations, 210.0, replayed=replayed)


# evolve


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


def test_brackets_in_a_folder_name_are_printed_literally(elsewhere, capsys, without_page):
    assert cli.main([*FLAGS, *BROKEN, "--out", "a[red]b[/x]"]) == 0
    captured = capsys.readouterr()
    assert "a[red]b[/x]" in (captured.err + captured.out).replace("\n", "")


def test_runs_without_out_get_separate_folders(elsewhere, without_page):
    (elsewhere / "runs" / "ga-uniform-seed4").mkdir(parents=True)
    for _ in range(2):
        assert cli.main([*FLAGS, *BROKEN, "--prior", "uniform", "--seed", "4"]) == 0
    names = sorted(p.name for p in (elsewhere / "runs").iterdir())
    assert names == ["ga-uniform-seed4", "ga-uniform-seed4-2", "ga-uniform-seed4-3"]


def test_run_without_a_best_robot_is_reported(elsewhere, capsys):
    assert cli.main([*FLAGS, *BROKEN, "--out", "run"]) == 0
    captured = capsys.readouterr()
    assert "3 diverged" in captured.err
    assert "best: none, no robot crawled forwards without failing" in captured.out


def test_progress_line_excludes_replayed_generations_from_the_time_left():
    config = RunConfig(generations=4, ga=GaConfig(population=4, hall_of_fame=1))
    output = io.StringIO()
    with Reporter(config, Console(file=output, width=200)) as reporter:
        reporter.generation(summary(0, 4, replayed=True))
        reporter.progress(0.5)
        time.sleep(0.2)
        reporter.generation(summary(1, 7, tipped=1, veered=2))
    replayed, computed = output.getvalue().splitlines()
    assert "left" not in replayed
    assert "best   12.3 mm" in computed
    assert "failed: 1 tipped, 2 veered" in computed
    assert re.search(r"50 % done, 0\.\d min left$", computed)


@pytest.mark.parametrize("budget_s", [None, 420.0])
def test_share_done_never_decreases(budget_s):
    config = RunConfig(generations=3, budget_s=budget_s, ga=GaConfig(population=4, hall_of_fame=1))
    console = Console(file=io.StringIO(), force_terminal=True, width=120)
    done = []
    with Reporter(config, console) as reporter:
        for number, evaluations in enumerate((4, 7, 10)):
            for share in (0.1, 0.5, 1.0):
                reporter.progress(share)
                done.append(reporter.share_done)
            reporter.generation(summary(number, evaluations)._replace(simulated_s=140.0 * (number + 1)))
            done.append(reporter.share_done)
    assert done == sorted(done)
    assert done[-1] == pytest.approx(1.0)


def test_video_is_written_unless_it_already_shows_the_best_robot(run, monkeypatch):
    history, made = load(run[0]), []
    path, console = history.folder / "best.mp4", Console(file=io.StringIO())
    monkeypatch.setattr(cli, "film", lambda *arguments: made.append(arguments))
    monkeypatch.setattr("evolution.report.run_page.write", lambda history, _: path)
    monkeypatch.setattr(
        "caterpillar_env.drawing.video.is_video_of", lambda path, robot: path.read_bytes() == b"it"
    )
    running.write_results(history, console, video=True)
    path.write_bytes(b"another robot")
    running.write_results(history, console, video=False)
    running.write_results(history, console, video=True)
    path.write_bytes(b"it")
    running.write_results(history, console, video=True)
    path.unlink()
    filmed = [(recording.robot.digest, where) for recording, where, _ in made]
    assert filmed == [(history.best_robot.digest, path)] * 2


# resume


def test_resume_can_make_a_run_longer(run, elsewhere, capsys, without_page):
    shutil.copytree(run[0], "short")
    assert cli.main(["resume", "short", "--generations", "2", "--no-video"]) == 0
    assert len(load("short").generations) == 2


def test_resume_does_not_repeat_a_finished_run(run, tmp_path, capsys):
    shutil.copytree(run[0], tmp_path / "run")
    before = {p.name: p.read_bytes() for p in (tmp_path / "run").iterdir()}
    assert cli.main(["resume", str(tmp_path / "run")]) == 0
    captured = capsys.readouterr()
    assert captured.err == "already finished: all 1 generations are complete\n"
    assert f"caterpillar resume {tmp_path / 'run'} --generations 2" in captured.out
    assert {p.name: p.read_bytes() for p in (tmp_path / "run").iterdir()} == before


def test_resume_writes_a_lost_best_robot_again(run, tmp_path, without_page):
    shutil.copytree(run[0], tmp_path / "run")
    (tmp_path / "run" / "best.json").unlink()
    assert cli.main(["resume", str(tmp_path / "run"), "--no-video"]) == 0
    assert (tmp_path / "run" / "best.json").read_bytes() == (run[0] / "best.json").read_bytes()


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["nowhere"], "is not a run folder"),
        ([], "folder"),
        (["run", "--generations", "many"], "--generations"),
        (["run", "--threads", "-1"], "threads = -1"),
        (["run", "--evaluator", "cloud"], "--evaluator"),
    ],
)
def test_resume_names_wrong_input(elsewhere, capsys, arguments, message):
    assert cli.main(["resume", *arguments]) in (1, 2)
    assert message.lower() in capsys.readouterr().err.lower()


# preprocess


def test_preprocess_prints_table_i_as_json(elsewhere, capsys):
    assert cli.main(["preprocess", "--json"]) == 0
    table = {row["gene"]: row for row in json.loads(capsys.readouterr().out)}
    assert len(table) == 20
    assert table["leg_separation_m"]["mu"] == table["leg_separation_m"]["upper"]
    assert table["segment_radius_m"]["mu"] == table["segment_radius_m"]["lower"]
    assert table["segment_mass_kg"]["kind"] == "uniform"
    assert table["gap1_dorsal_on_s"]["upper"] == RunConfig().gait_period_s
    assert (elsewhere / "preprocess.png").read_bytes().startswith(b"\x89PNG")


def test_preprocess_prints_a_table_with_every_gene(elsewhere, capsys, monkeypatch):
    monkeypatch.setenv("COLUMNS", "200")
    assert cli.main(["preprocess", "--num-segments", "2", "--out", "d.png"]) == 0
    captured = capsys.readouterr()
    for name in ("leg separation", "segment mass", "gap1 ventral off", "8 to 24 mm", "contradiction"):
        assert name in captured.out
    assert "d.png" in captured.err
    assert (elsewhere / "d.png").exists()


# runs


def test_runs_with_a_budget_show_the_spent_share(tmp_path, invented, capsys):
    config = RunConfig(budget_s=400.0, ga=GaConfig(population=4, hall_of_fame=1))

    def stop(generation):
        raise KeyboardInterrupt

    history = evolve(config, tmp_path / "run", evaluator=invented, on_generation=stop)
    assert cli.main(["runs", str(tmp_path), "--json"]) == 0
    (row,) = json.loads(capsys.readouterr().out)
    assert row["generation"] == f"1 ({100 * history.simulated_s / 400:.0f} %)"
