"""The subcommands from inside: presets, what is printed, and which files are left."""

import contextlib
import io
import json
import sqlite3

import pytest
from rich.console import Console

from caterpillar_env.physics import Physics
from caterpillar_env.robot import Robot
from evolution import cli
from evolution.cli import running
from evolution.cli.evolve import PRESETS, _preset
from evolution.cli.running import Reporter
from evolution.config import RunConfig
from evolution.optimizers.ga import GaConfig
from evolution.run.evaluators import LocalEvaluator
from evolution.run.history import table
from evolution.run.journal import FILE, Journal
from evolution.run.loop import Generation, Own, evolve, read_configuration

CONFIG = RunConfig(
    seed=4, generations=1, physics=Physics(num_segments=2, timestep_s=0.01, friction=0.7),
    ga=GaConfig(population=3, hall_of_fame=1),
)  # fmt: skip
FLAGS = [
    "evolve", "--num-segments", "2", "--timestep-s", "0.01", "--friction", "0.7", "--population", "3",
    "--hall-of-fame", "1", "--generations", "1", "--no-video",
]  # fmt: skip

#: Physics in which every robot's integration breaks down at once.
BROKEN = ["--integrator", "implicitfast", "--axial-stiffness-n-m", "1e9", "--axial-damping-n-s-m", "0"]


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    """A run's folder, and what it printed."""
    folder = tmp_path_factory.mktemp("commands") / "run"
    out, err = io.StringIO(), io.StringIO()
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
        status = cli.main([*FLAGS, "--seed", "4", "--preset", "quick", "--out", str(folder)])
    assert status == 0
    return folder, out.getvalue(), err.getvalue()


@pytest.fixture
def elsewhere(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    return tmp_path


def told(number, evaluations, **failures):
    failed = {"tipped": 0, "veered": 0, **failures}
    return Generation(number, 0.0123, 0.004, failed, evaluations, 210.0, 60.0, replayed=False)


# evolve


def test_paper_preset_is_the_papers_run():
    assert PRESETS["paper"] == RunConfig()
    assert PRESETS["paper"].evaluations() == 9_510


def test_quick_preset_is_small():
    assert PRESETS["quick"].evaluations() < 200


@pytest.mark.parametrize(
    ("arguments", "expected"),
    [
        ([], "paper"),
        (["--seed", "3"], "paper"),
        (["--preset", "quick"], "quick"),
        (["--preset=quick"], "quick"),
        (["--seed", "3", "--preset", "quick", "--generations", "2"], "quick"),
        (["--generations", "2", "--preset", "paper"], "paper"),
    ],
    ids=str,
)
def test_preset_is_found_among_the_other_flags(arguments, expected):
    assert _preset(arguments) == expected


def test_flags_change_a_preset_and_leave_the_rest_of_it(run):
    folder, _, _ = run
    with Journal(folder) as journal:
        assert read_configuration(journal) == (CONFIG, Own())
    assert PRESETS["quick"].generations != CONFIG.generations


def test_evolve_records_the_same_as_the_function(run, tmp_path):
    folder, _, _ = run
    evolve(CONFIG, tmp_path, evaluator=LocalEvaluator(1))
    assert table(folder).equals(table(tmp_path))
    assert (folder / "best.json").read_bytes() == (tmp_path / "best.json").read_bytes()


def test_evolve_tells_generations_on_the_error_stream_and_the_best_on_the_output(run):
    folder, out, err = run
    assert len(err.splitlines()) == 1
    assert err.startswith("generation   0  best ")
    assert f"simulated {table(folder)['simulated_s'].sum():.0f} s" in err
    best = Robot.load(folder)
    assert out == f"best: {1000 * best.fitness_m:.1f} mm in 30 s (generation 0), in {folder}\n"


def test_brackets_in_a_folders_name_are_no_markup(elsewhere, capsys):
    # A folder's name is printed as it is when the run leaves no robot, "[/x]" and all.
    assert cli.main([*FLAGS, *BROKEN, "--out", "a[red]b[/x]"]) == 0
    said = capsys.readouterr()
    assert "a[red]b[/x]" in (said.err + said.out).replace("\n", "")


def test_runs_without_a_name_get_folders_of_their_own(elsewhere):
    (elsewhere / "runs" / "ga-uniform-seed4").mkdir(parents=True)
    for _ in range(2):
        assert cli.main([*FLAGS, *BROKEN, "--prior", "uniform", "--seed", "4"]) == 0
    names = sorted(p.name for p in (elsewhere / "runs").iterdir())
    assert names == ["ga-uniform-seed4", "ga-uniform-seed4-2", "ga-uniform-seed4-3"]


def test_robots_that_all_fail_end_in_a_sentence(elsewhere, capsys):
    assert cli.main([*FLAGS, *BROKEN, "--out", "run"]) == 0
    said = capsys.readouterr()
    assert "3 diverged" in said.err
    assert "no robot crawled forwards without failing" in said.err.replace("\n", " ")
    assert "best:" not in said.out


def test_lines_of_a_long_run_tell_failures_and_the_time_left():
    config = RunConfig(generations=3, ga=GaConfig(population=4, hall_of_fame=1))  # 4 + 3 + 3
    spoken = io.StringIO()
    with Reporter(config, Console(file=spoken, width=200)) as reporter:
        reporter.progress(0.5)
        reporter.generation(told(0, 4, tipped=1, veered=2))
    line = spoken.getvalue()
    assert "best   12.3 mm" in line
    assert "failed: 1 tipped, 2 veered" in line
    assert "left 1.5 min" in line  # 60 s for 4, and 6 to come


def test_bar_on_a_terminal_only_moves_forwards():
    config = RunConfig(generations=3, ga=GaConfig(population=4, hall_of_fame=1))
    console = Console(file=io.StringIO(), force_terminal=True, width=120)
    done = []
    with Reporter(config, console) as reporter:
        for number, evaluations in enumerate((4, 7, 10)):
            for share in (0.1, 0.5, 1.0):
                reporter.progress(share)
                done.append(reporter._bar.tasks[0].completed)
            reporter.generation(told(number, evaluations))
            done.append(reporter._bar.tasks[0].completed)
    assert done == sorted(done)
    assert done[-1] == pytest.approx(1.0)


def test_film_is_made_unless_there_is_one_of_this_robot(run, monkeypatch):
    folder, made = run[0], []
    monkeypatch.setattr(running, "film", lambda *what: made.append(what))
    monkeypatch.setattr("evolution.report.run_page.write", lambda folder: folder)
    best, path, console = Robot.load(folder), folder / "best.mp4", Console(file=io.StringIO())
    running.picture(folder, console, video=True)
    path.write_bytes(b"a film of somebody else")
    running.picture(folder, console, video=False)
    running.picture(folder, console, video=True)
    path.write_bytes(b"a film of " + best.digest.encode())
    running.picture(folder, console, video=True)
    path.unlink()
    assert [(robot.digest, where) for robot, where, _ in made] == [(best.digest, path)] * 2


# resume


def test_resume_goes_on_and_can_make_a_run_longer(run, elsewhere, capsys):
    assert cli.main([*FLAGS, "--seed", "4", "--out", "short"]) == 0
    assert cli.main(["resume", "short", "--generations", "2", "--no-video"]) == 0
    assert cli.main([*FLAGS, "--seed", "4", "--generations", "2", "--out", "long"]) == 0
    assert table(elsewhere / "short").drop("session").equals(table(elsewhere / "long").drop("session"))
    assert (elsewhere / "short" / "best.json").read_bytes() == (
        elsewhere / "long" / "best.json"
    ).read_bytes()


def test_resume_mends_a_damaged_journal_when_asked(elsewhere, capsys):
    assert cli.main([*FLAGS, "--seed", "4", "--generations", "3", "--out", "run"]) == 0
    before = table(elsewhere / "run")
    with contextlib.closing(sqlite3.connect(elsewhere / "run" / FILE)) as db, db:
        db.execute("UPDATE evaluations SET distance_m = 1.0 WHERE evaluation = 4")
    capsys.readouterr()
    assert cli.main(["resume", "run", "--no-video"]) == 1
    assert "evaluation 4 is not as it was written" in capsys.readouterr().err
    assert cli.main(["resume", "run", "--repair", "--no-video"]) == 0
    assert "kept 4 evaluations" in capsys.readouterr().err
    assert table(elsewhere / "run").drop("session").equals(before.drop("session"))


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["nowhere"], "it is no run folder"),
        (["nowhere", "--repair"], "it is no run folder"),
        ([], "folder"),
        (["run", "--generations", "many"], "--generations"),
        (["run", "--threads", "-1"], "threads = -1"),
        (["run", "--evaluator", "cloud"], "--evaluator"),
    ],
)
def test_wrong_input_of_resume_is_named(elsewhere, capsys, arguments, message):
    assert cli.main(["resume", *arguments]) in (1, 2)
    assert message.lower() in capsys.readouterr().err.lower()


# preprocess


def test_preprocess_prints_the_paper_as_json(elsewhere, capsys):
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
    said = capsys.readouterr()
    for name in ("leg_separation_m", "segment_mass_kg", "gap1_ventral_off_s", "contradiction"):
        assert name in said.out
    assert "d.png" in said.err
    assert (elsewhere / "d.png").exists()
