"""The page of a run: numbers, commands and videos, for finished, stopped and failed runs."""

import base64
import re
import shutil
from dataclasses import replace
from html import unescape

import numpy as np
import polars
import pytest

from caterpillar_env.drawing.video import Recording, VideoConfig, write_video
from caterpillar_env.physics import Physics
from caterpillar_env.robot import Robot
from evolution import cli
from evolution.config import RunConfig
from evolution.optimizers.cma_es import CmaConfig
from evolution.optimizers.ga import GaConfig
from evolution.report import run_page
from evolution.run.evaluators import LocalEvaluator
from evolution.run.history import load
from evolution.run.journal import FILE, Journal
from evolution.run.loop import evolve

CONFIG = RunConfig(
    seed=4, generations=2, physics=Physics(num_segments=2, timestep_s=0.01, friction=0.7),
    ga=GaConfig(population=3, hall_of_fame=1),
)  # fmt: skip
SHORT = replace(CONFIG, generations=1)
BREAKS = replace(
    CONFIG.physics, integrator="implicitfast", axial_stiffness_n_m=1e5, axial_damping_n_s_m=0.0
)
COLOURS = """() => {
    const style = (selector) => getComputedStyle(document.querySelector(selector));
    return {
        paper: style("body").backgroundColor,
        text: style("figure svg text").fill,
        axis: style('figure svg [style*="stroke: #000000"]').stroke,
    };
}"""


class Fixed:
    """A custom optimizer that always asks for the same genomes."""

    def ask(self):
        return np.random.default_rng(4).random((3, 12))

    def tell(self, genomes, fitness):
        pass


def read_page(folder):
    """Render the page without its figures, which are slow."""
    return run_page.page(load(folder), {})


def number(page, name):
    """Return the exact value of a number on the page."""
    (value,) = re.findall(rf'<data id="{name}" value="([^"]*)">', page)
    return float(value)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """The folder of a run with a page, without a video."""
    folder = tmp_path_factory.mktemp("report") / "a <run> & more"
    evolve(CONFIG, folder, evaluator=LocalEvaluator(1))
    run_page.write(load(folder))
    return folder


@pytest.fixture(scope="module")
def gait(folder):
    """The gait of the best robot of that run."""
    return run_page.measure_gait(load(folder).best_robot)


@pytest.fixture
def measured_once(gait, monkeypatch):
    """Use this gait for all robots, because measuring a gait is slow."""
    monkeypatch.setattr(run_page, "measure_gait", lambda robot: gait)


@pytest.fixture
def ran(invented, measured_once, tmp_path):
    """Return a function that runs a configuration in `run` with invented outcomes and renders it."""

    def run(config=SHORT, **kwargs):
        evolve(config, tmp_path / "run", evaluator=invented, **kwargs)
        return read_page(tmp_path / "run")

    return run


@pytest.fixture
def page(folder):
    return (folder / run_page.PAGE).read_text("utf-8")


def test_numbers_match_best_json_and_the_journal(folder, page):
    best, rows = Robot.load(folder), load(folder).table()
    row = rows.row(int(number(page, "best-evaluation")), named=True)
    assert number(page, "best-m") == best.fitness_m == row["distance_m"]
    assert best.fitness_m == rows.filter(polars.col("failure") == "ok")["distance_m"].max()
    assert number(page, "best-generation") == best.generation == row["generation"]
    assert number(page, "best-energy-j") == row["energy_j"]
    assert number(page, "evaluations") == len(rows) == 5
    assert number(page, "failed") == (rows["failure"] != "ok").sum()
    assert number(page, "simulated-s") == pytest.approx(rows["simulated_s"].sum(), rel=1e-12)


def test_genes_of_the_best_robot_are_shown_between_their_bounds(folder, page):
    record = load(folder)
    rows = run_page.gene_rows(record)
    row_values = load(folder).table().row(record.best.number, named=True)
    for row, gene in zip(rows, CONFIG.encoding.genes, strict=True):
        factor = {"m": 1e3, "kg": 1e3, "rad": 180 / np.pi, "s": 1.0}[gene.unit]
        assert row.value == pytest.approx(factor * row_values[gene.name], rel=1e-12)
        assert row.lower <= row.value <= row.upper
        share = (row.value - row.lower) / (row.upper - row.lower)
        assert row.percent(row.value) == pytest.approx(100 * share)
        assert f"<td>{row.title}<td>{row.value:.3g} {row.unit}" in page
    by_title = {row.title: row for row in rows}
    separation = by_title["leg separation"]
    assert (separation.peak, separation.upper, separation.unit) == (24.0, 24.0, "mm")
    assert separation.width == pytest.approx(16 / np.sqrt(2 * np.log(3)))
    assert separation.percent(separation.peak + separation.width) == 100.0
    assert by_title["segment mass"].peak is None
    assert by_title["joint limit"].unit == "°"


def test_page_is_deterministic(folder, page):
    figures = [(folder / name).read_bytes() for name in ("convergence.png", "gait.png")]
    assert run_page.write(load(folder)).read_text("utf-8") == page
    assert [(folder / name).read_bytes() for name in ("convergence.png", "gait.png")] == figures


def test_page_loads_no_external_resources(page):
    assert not re.findall(r'(?:src|href)="(?!data:|#)[^"]*"', page)
    assert "@import" not in page
    assert "url(" not in page.replace("url(#", "")


def test_names_are_escaped_in_html_and_in_commands(page):
    assert "<title>a &lt;run&gt; &amp; more: " in page
    assert "<run>" not in page
    assert "caterpillar replay 'a <run> & more' " in unescape(page)


def test_settings_that_differ_from_the_defaults_are_listed(folder):
    with Journal(folder, read_only=True) as journal:
        changed = {
            name: (value, default) for name, value, default in run_page.changed(journal.configuration)
        }
    assert changed == {
        "seed": ("4", "0"), "generations": ("2", "50"), "ga.population": ("3", "200"),
        "ga.hall_of_fame": ("1", "10"), "physics.num_segments": ("2", "4"),
        "physics.timestep_s": ("0.01", "0.0025"), "physics.friction": ("0.7", "0.8"),
    }  # fmt: skip


def test_versions_and_machine_of_each_session_are_shown(folder, page):
    with Journal(folder, read_only=True) as journal:
        (session,) = journal.sessions
    for name, value in session.fingerprint.items():
        assert f"{name} {value}" in page
    assert f"<td>0:00:{session.wall_s:02.0f}<td>" in page


def test_video_is_embedded_if_it_shows_the_best_robot(folder, measured_once, monkeypatch):
    film = folder / "best.mp4"
    monkeypatch.setattr(
        run_page, "is_video_of", lambda path, _: path.exists() and path.read_bytes()[:2] == b"it"
    )
    assert "no video of this robot" in read_page(folder)
    try:
        film.write_bytes(b"another one")
        assert "no video of this robot" in read_page(folder)
        film.write_bytes(b"it is this robot")
        (data,) = re.findall(
            r'<video controls[^>]* src="data:video/mp4;base64,([^"]+)"', read_page(folder)
        )
        assert base64.b64decode(data) == film.read_bytes()
    finally:
        film.unlink()


def test_gait_is_measured_only_if_the_best_robot_moves_forwards(page, invented, tmp_path):
    class Backwards(LocalEvaluator):
        def map(self, encoding, jobs, on_progress=None):
            for result in invented.map(encoding, jobs):
                outcomes = result.outcomes
                backwards_m = -np.ones_like(outcomes.distance_m)
                yield result._replace(outcomes=outcomes._replace(distance_m=backwards_m))

    evolve(SHORT, tmp_path, evaluator=Backwards(), objective=lambda outcomes: -outcomes.energy_j)
    assert "How it moves" in page
    assert "How it moves" not in read_page(tmp_path)


@pytest.mark.parametrize(
    ("config", "text"),
    [
        (replace(SHORT, optimizer="cma-es", cma=CmaConfig(cma_population=4)), "CMA-ES uses the prior"),
        (replace(SHORT, optimizer="random", prior="uniform"), "random with the prior uniform"),
        (replace(SHORT, genome="full"), "gap1 dorsal left on"),
        (replace(CONFIG, genome="per-segment"), "segment2 leg separation"),
        (replace(SHORT, prior_use="mutation"), "the first generation is uniform"),
        (replace(SHORT, objective="distance-per-energy"), "The objective was distance-per-energy"),
        (replace(CONFIG, generations=9, budget_s=100.0), "a budget of 100 simulated seconds"),
    ],
    ids=["cma-es", "random", "full", "per-segment", "mutation-only", "energy", "budget"],
)
def test_runs_of_every_kind_have_a_page(config, text, ran, tmp_path):
    page = ran(config)
    assert text in page
    assert number(page, "best-m") == Robot.load(tmp_path / "run").fitness_m
    assert page.count('<svg class="bar"') == len(config.encoding.genes)


@pytest.mark.parametrize(("prior", "peaks"), [("uniform", 0), ("body", 6)])
def test_genes_show_the_prior_that_the_run_uses(folder, prior, peaks):
    history = load(folder)
    history.configuration["prior"] = prior
    rows = run_page.gene_rows(history)
    assert sum(row.peak is not None for row in rows) == peaks
    assert all((row.peak is None) == (row.width is None) for row in rows)


def test_page_names_a_custom_optimizer(ran):
    page = ran(optimizer=Fixed())
    assert "the user's own optimizer Fixed, " in unescape(page)
    assert "caterpillar resume" not in page
    assert "may not use the prior" in page


def test_page_shows_no_resume_command_for_a_custom_objective(ran):
    page = ran(objective=lambda outcomes: -outcomes.energy_j)
    assert "caterpillar replay run" in page
    assert "caterpillar resume" not in page
    assert "The objective was the user's own " in unescape(page)


def test_page_of_a_stopped_run_with_a_custom_objective_names_the_function_that_resumes_it(tmp_path):
    folder = tmp_path / "run"
    evolve(
        CONFIG, folder, objective=lambda outcomes: -outcomes.energy_j,
        evaluator=LocalEvaluator(1), on_generation=stop_after(1),
    )  # fmt: skip
    page = " ".join(read_page(folder).split())
    assert "with <code>evolution.resume</code> and its objective." in page
    assert "caterpillar resume" not in page


def test_page_of_a_run_without_a_best_robot_lists_the_failures(tmp_path):
    evolve(replace(SHORT, physics=BREAKS), tmp_path / "run", evaluator=LocalEvaluator(1))
    page = read_page(tmp_path / "run")
    assert "no robot crawled forwards without failing" in page
    assert "<tr><td>diverged<td>3<td>100.0 %</tr>" in page
    assert "There is no robot to film." in page
    assert "caterpillar replay" not in page


def stop_after(count):
    """Return a callback that stops the run after `count` generations."""

    def stop(generation):
        if generation.number + 1 == count:
            raise KeyboardInterrupt

    return stop


def test_page_of_a_stopped_run_shows_how_to_resume(ran, tmp_path):
    page = ran(CONFIG, on_generation=stop_after(1))
    assert "Not finished: " in page
    assert "caterpillar resume run " in page
    assert "<small>1 generations</small>" not in page
    assert "<small>1 generation</small>" in page
    assert "<td>stopped<td>3<td" in page
    assert number(page, "evaluations") == 3
    assert number(page, "best-m") == Robot.load(tmp_path / "run").fitness_m


def test_incomplete_generation_is_excluded_from_the_figures(tmp_path, invented, measured_once):
    """The incomplete generation contains the best robot."""
    evolve(CONFIG, tmp_path, evaluator=invented, on_generation=stop_after(2))
    with Journal(tmp_path) as journal:
        first = next(journal.evaluations())
        journal.append([first._replace(number=5 + i, generation=2, distance_m=1.0) for i in range(50)])
    history, page = load(tmp_path), read_page(tmp_path)
    assert [g.number for g in history.generations] == [0, 1]
    assert "50 evaluations belong to an incomplete generation" in page
    assert number(page, "best-m") == history.best.distance_m < 1.0
    assert number(page, "evaluations") == 55
    assert number(page, "simulated-s") == pytest.approx(
        history.simulated_s + 50 * first.simulated_s, rel=1e-12
    )


def test_run_without_evaluations_has_a_page(tmp_path):
    with Journal.create(tmp_path, {**CONFIG.to_dict(), "own_optimizer": None}) as journal:
        journal.begin()
    page = read_page(tmp_path)
    assert "no generation is complete" in page
    assert number(page, "evaluations") == 0


def test_a_page_names_the_world(tmp_path):
    for number, world in enumerate(("flat", "slope:angle_deg=3.0")):
        config = replace(CONFIG, physics=replace(CONFIG.physics, world=world))
        folder = tmp_path / str(number)
        folder.mkdir()
        with Journal.create(folder, {**config.to_dict(), "own_optimizer": None}) as journal:
            journal.begin()
        assert ("in the world slope:angle_deg=3.0." in read_page(folder)) == (number == 1)


# caterpillar report


def test_report_rewrites_the_page_of_a_run(folder, tmp_path, capsys):
    shutil.copytree(folder, tmp_path / "run")
    made = [tmp_path / "run" / name for name in ("report.html", "gait.png", "convergence.png")]
    for path in made:
        path.unlink()
    assert cli.main(["report", str(tmp_path / "run"), "--no-video"]) == 0
    captured = capsys.readouterr()
    assert captured.out.startswith("best: ")
    assert f"\npage: {tmp_path / 'run' / 'report.html'}\n" in captured.out
    assert captured.err == ""
    assert {"report.html", "gait.png", "convergence.png"} <= {
        p.name for p in (tmp_path / "run").iterdir()
    }


@pytest.mark.parametrize(
    ("spoil", "message"),
    [
        (
            lambda run: (run / FILE).unlink(),
            "contains neither a run (journal.sqlite) nor a study (study.json)",
        ),
        (lambda run: (run / FILE).write_bytes(b"no database"), "is damaged"),
        (lambda run: (run / "report.html").mkdir(), "report.html: Is a directory; free some space"),
    ],
    ids=["no journal", "damaged journal", "unwritable"],
)
def test_report_errors_are_one_line(folder, tmp_path, capsys, spoil, message):
    shutil.copytree(folder, tmp_path / "run")
    (tmp_path / "run" / "report.html").unlink()
    spoil(tmp_path / "run")
    assert cli.main(["report", str(tmp_path / "run"), "--no-video"]) == 1
    err = capsys.readouterr().err
    assert message in err
    assert err.count("\n") == 1


# In a browser


@pytest.fixture(scope="module")
def filmed(folder, tmp_path_factory):
    """A run's page with a film of half a second in it."""
    copy = tmp_path_factory.mktemp("filmed") / "run"
    shutil.copytree(folder, copy)
    recording = Recording(Robot.load(copy))
    write_video([recording], copy / "best.mp4", VideoConfig(60.0, 160, 120))
    film = (copy / "best.mp4").read_bytes()
    assert cli.main(["report", str(copy)]) == 0
    assert (copy / "best.mp4").read_bytes() == film  # it shows this robot, so it is kept
    return copy / run_page.PAGE


@pytest.mark.slow
@pytest.mark.parametrize("width_px", [1100, 400])
@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_browser_shows_the_page_without_errors_or_requests(browser, filmed, width_px, scheme):
    address, complaints, asked = filmed.as_uri(), [], []
    window = browser.new_page(viewport={"width": width_px, "height": 800}, color_scheme=scheme)
    window.on("console", lambda message: complaints.append(message.text))
    window.on("pageerror", lambda error: complaints.append(str(error)))
    window.on("request", lambda request: asked.append(request.url))
    window.goto(address)
    wide = window.evaluate("document.documentElement.scrollWidth")
    film_s = window.evaluate("document.querySelector('video').duration")
    colours = window.evaluate(COLOURS)
    window.emulate_media(media="print")
    printed = window.evaluate(COLOURS)
    pages = window.pdf(format="A4").count(b"/Type /Page\n")
    window.close()
    assert complaints == []
    assert [url for url in asked if not url.startswith("data:")] == [address]
    assert wide <= width_px  # only tables scroll sideways
    assert film_s == pytest.approx(1.52, abs=0.1)  # half a second, then 1 s of the last frame
    dark = {"paper": "rgb(20, 20, 20)", "text": "rgb(232, 232, 232)", "axis": "rgb(232, 232, 232)"}
    light = {"paper": "rgb(255, 255, 255)", "text": "rgb(27, 27, 27)", "axis": "rgb(27, 27, 27)"}
    assert colours == (dark if scheme == "dark" else light)
    assert printed["paper"] == "rgb(255, 255, 255)"
    assert printed["text"] == printed["axis"] == "rgb(0, 0, 0)"
    assert 2 <= pages <= 6
