"""TensorBoard logs of runs, read with TensorBoard's own reader."""

import sys

import polars
import pytest

from caterpillar_env.errors import CaterpillarError
from evolution import cli
from evolution.report.tensorboard import FOLDER, TensorBoard
from evolution.run.history import load

FLAGS = [
    "--num-segments", "2", "--timestep-s", "0.01", "--population", "3", "--hall-of-fame", "1",
    "--no-video",
]  # fmt: skip


def scalars(folder):
    """Return the (step, value) points of each scalar."""
    reader = pytest.importorskip("tensorboard.backend.event_processing.event_accumulator")
    events = reader.EventAccumulator(str(folder / FOLDER))
    events.Reload()
    return {tag: [(e.step, e.value) for e in events.Scalars(tag)] for tag in events.Tags()["scalars"]}


@pytest.mark.filterwarnings("default")
def test_run_and_resumed_run_are_logged(tmp_path):
    run = tmp_path / "run"
    tracked = ["evolve", *FLAGS, "--generations", "2", "--track", "tensorboard", "--out", str(run)]
    assert cli.main(tracked) == 0
    assert cli.main(["resume", str(run), "--generations", "3", "--no-video"]) == 0
    points = scalars(run)
    rows = load(run).table()
    seconds = rows.group_by("generation", maintain_order=True).agg(polars.col("simulated_s").sum())
    best = points["distance_m/best_so_far"]
    assert [step for step, _ in best] == [round(s) for s in seconds["simulated_s"].cum_sum()]
    healthy = rows.filter(rows["failure"] == "ok")["distance_m"]
    assert best[-1][1] == pytest.approx(max(healthy.max() or 0.0, 0.0))
    failed = rows.filter(rows["failure"] == "tipped").height
    assert sum(value for _, value in points["failures/tipped"]) == failed


def test_an_untracked_run_leaves_no_log(tmp_path):
    run = tmp_path / "run"
    assert cli.main(["evolve", *FLAGS, "--generations", "1", "--out", str(run)]) == 0
    assert not (run / FOLDER).exists()


def test_error_without_tensorboardx_names_the_package(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "tensorboardX", None)
    with pytest.raises(CaterpillarError, match=r"pip install 'caterpillar-sma\[tensorboard\]'"):
        TensorBoard(tmp_path)
