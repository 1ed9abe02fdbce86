import json

import numpy as np
import pytest

from caterpillar_env.robot import Outcomes
from caterpillar_env.validation import convergence, gaits, golden, material
from caterpillar_env.validation.check import check_at_most, check_equal
from evolution import cli
from evolution.cli import validate

PLOTS = ("sma.png", "timestep.png")


@pytest.mark.slow
def test_quick_validation_passes_and_writes_plots(tmp_path, capsys):
    status = cli.main(["validate", "--quick", "--json", "--out", str(tmp_path / "v")])
    data = json.loads(capsys.readouterr().out)
    failed = [check for found in data.values() for check in found if not check["passed"]]
    assert not failed
    assert status == 0
    assert len(data) == 12
    assert sum(map(len, data.values())) > 50
    for name in PLOTS:
        assert (tmp_path / "v" / name).stat().st_size > 10_000
    assert json.loads((tmp_path / "v" / "validation.json").read_text("utf-8")) == data


def canned(monkeypatch, *, weight_n, golden_passes):
    """Replace the simulations and plots with fixed results."""
    nothing = np.zeros(4)
    outcomes = Outcomes(nothing.astype(np.int8), np.array([0.1, 0.2, 0.3, 0.4]), nothing, nothing)
    result = convergence.Comparison(*[convergence.Pair(outcomes, outcomes)] * 4)
    monkeypatch.setattr(convergence, "compare", lambda *, quick: result)
    groups = {
        "mechanics": lambda: [check_at_most("weight", 1.0, weight_n, "N")],
        "golden trajectories": lambda: [check_equal("path", True, golden_passes)],
    }
    gait = gaits.Gait(0.1, 0.2, 1.0, 0.1, 0.0, 0.5, 0.0, 0.0, 1000.0, 0.03)
    monkeypatch.setattr(gaits, "measure_gait", lambda robot, duration_s: gait)
    monkeypatch.setattr(material, "plot", lambda path: None)
    monkeypatch.setattr(convergence, "plot", lambda compared, path: None)
    monkeypatch.setattr(validate, "groups", lambda robots, *, quick: groups)


def test_a_failed_check_is_shown_and_sets_the_exit_status(tmp_path, capsys, monkeypatch):
    canned(monkeypatch, weight_n=2.0, golden_passes=True)
    assert cli.main(["validate", "--quick", "--out", str(tmp_path)]) == 1
    out, err = capsys.readouterr()
    assert "FAIL" in out
    assert "9 of 10 checks passed" in " ".join(err.split())
    assert golden.ADVICE[:30] not in " ".join(err.split())


def test_changed_golden_trajectories_come_with_advice(tmp_path, capsys, monkeypatch):
    canned(monkeypatch, weight_n=0.5, golden_passes=False)
    assert cli.main(["validate", "--quick", "--out", str(tmp_path)]) == 1
    assert golden.ADVICE in " ".join(capsys.readouterr().err.split())


def test_exit_status_is_0_if_all_checks_pass(tmp_path, capsys, monkeypatch):
    canned(monkeypatch, weight_n=0.5, golden_passes=True)
    assert cli.main(["validate", "--quick", "--out", str(tmp_path)]) == 0
    assert "FAIL" not in capsys.readouterr().out


def test_a_file_as_the_output_folder_is_an_error(tmp_path, capsys):
    (tmp_path / "v").write_text("")
    assert cli.main(["validate", "--quick", "--out", str(tmp_path / "v")]) != 0
    assert "choose another place with --out" in " ".join(capsys.readouterr().err.split())
