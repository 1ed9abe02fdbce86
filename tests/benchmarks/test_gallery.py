"""The gallery script makes all pictures of the page, and its wave figure matches the simulation."""

import re
import subprocess
import sys

import numpy as np
import pytest
from PIL import Image

from benchmarks import gallery
from benchmarks.drawings import write_drawings
from caterpillar_env.drawing.video import Recording
from caterpillar_env.physics import GRAVITY_M_S2
from caterpillar_env.robot import Robot

PAGE = (gallery.ROOT / "docs" / "gallery.md").read_text("utf-8")
MADE = {path.name for path in gallery.OUT.iterdir()}


@pytest.fixture(scope="module")
def winner():
    return Robot.load(gallery.STUDY / "winners" / "shade.json")


def test_page_shows_every_picture():
    assert set(re.findall(r"images/gallery/([\w.-]+)", PAGE)) == MADE


def test_pictures_are_small():
    assert sum(path.stat().st_size for path in gallery.OUT.iterdir()) < 3e6


def test_wave_figure_matches_the_simulation_and_its_loads_bear_the_weight(winner):
    recording = Recording(winner)
    first = round(gallery.WAVE_START_S / 0.01)
    period = gallery.measure_period(winner)
    np.testing.assert_array_equal(period.qpos, recording.qpos[first : first + 500])
    left = recording.temperature_c[first : first + 500, ::2]
    np.testing.assert_allclose(period.temperature_c, left, rtol=1e-12)
    weight_n = GRAVITY_M_S2 * 4 * winner.morphology.segment_mass_kg
    assert 0.94 < period.load_n.sum(axis=1).mean() / weight_n < 1.0  # the body carries up to 5 %
    assert period.advance_m[-1] == pytest.approx(0.36 / 6, rel=0.05)


@pytest.mark.slow
@pytest.mark.drawing
@pytest.mark.parametrize("shot", gallery.SHOTS, ids=lambda shot: shot.failure.label)
def test_films_show_the_failures_of_the_page(shot, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)  # MuJoCo logs a divergence there
    recorded = []
    monkeypatch.setattr(
        gallery, "Recording", lambda *given: recorded.append(Recording(*given)) or recorded[-1]
    )
    monkeypatch.setattr(gallery, "SHOTS", (shot,))
    gallery.write_failures(tmp_path, (86, 60))
    (recording,) = recorded
    assert recording.outcomes.failure.tolist() == [shot.failure]
    assert len(recording.qpos) > 10
    with Image.open(tmp_path / f"{shot.failure.label}.webp") as film:
        assert film.size == (86, 60)
        assert film.n_frames > 10
    assert f"\n**{shot.failure.label}**: " in PAGE


@pytest.mark.slow
@pytest.mark.drawing
def test_film_of_the_policies_shows_their_published_distances(tmp_path, monkeypatch):
    recorded = []
    monkeypatch.setattr(
        gallery, "Recording", lambda *given: recorded.append(Recording(*given)) or recorded[-1]
    )
    gallery.write_policies(tmp_path, (120, 80))
    distances_m = [recording.outcomes.distance_m[0] for recording in recorded]
    assert distances_m[0] == pytest.approx(0.177, abs=5e-4)  # the wave
    # PyTorch rounds differently on other CPUs.
    recorded_m = [recording.robot.fitness_m for recording in recorded[1:]]
    assert distances_m[1:] == pytest.approx(recorded_m, rel=1e-6)
    with Image.open(tmp_path / "policies.webp") as film:
        assert film.n_frames > 10


@pytest.mark.slow
@pytest.mark.drawing
def test_script_draws_the_figures_of_the_page(tmp_path):
    command = [sys.executable, "-m", "benchmarks.gallery", "wave", "drawings", "--out", str(tmp_path)]
    done = subprocess.run(command, cwd=gallery.ROOT, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    drawn = {path.name: path.read_bytes() for path in tmp_path.iterdir()}
    assert drawn.keys() == {name for name in MADE if re.match("wave|fig|eq", name)}
    write_drawings(tmp_path)
    for name, content in drawn.items():
        assert (tmp_path / name).read_bytes() == content
        if name.endswith(".svg"):
            assert content.count(b"<path") > 20


def test_unknown_kinds_are_rejected(capsys, monkeypatch):
    monkeypatch.setattr(sys, "argv", ["gallery", "movies"])
    with pytest.raises(SystemExit):
        gallery.main()
    assert (
        "unknown kind movies; choose from films, policies, failures, wave, drawings"
        in capsys.readouterr().err
    )
