import contextlib
import io

import pytest

from evolution import cli


@pytest.fixture(scope="session")
def flags():
    """Arguments that evolve three robots of two segments for one generation, without a video."""
    return [
        "evolve", "--num-segments", "2", "--timestep-s", "0.01", "--friction", "0.7",
        "--population", "3", "--hall-of-fame", "1", "--generations", "1", "--no-video",
    ]  # fmt: skip


@pytest.fixture(scope="module")
def run(tmp_path_factory, flags):
    """A run's folder, and its stdout and stderr."""
    folder = tmp_path_factory.mktemp("commands") / "run"
    out, err = io.StringIO(), io.StringIO()
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
        status = cli.main([*flags, "--seed", "4", "--out", str(folder)])
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
