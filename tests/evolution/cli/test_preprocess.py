"""`caterpillar preprocess` prints and draws the priors of all genes."""

import json
from typing import get_args

import pytest

from evolution import cli
from evolution.config import RunConfig
from evolution.priors import Without


def test_preprocess_prints_table_i_as_json(elsewhere, capsys):
    assert cli.main(["preprocess", "--json"]) == 0
    table = {row["gene"]: row for row in json.loads(capsys.readouterr().out)}
    assert len(table) == 20
    assert table["leg_separation_m"]["mu"] == table["leg_separation_m"]["upper"]
    assert table["segment_radius_m"]["mu"] == table["segment_radius_m"]["lower"]
    assert table["segment_mass_kg"]["kind"] == "uniform"
    assert table["gap1_dorsal_on_s"]["upper"] == RunConfig().gait_period_s
    assert (elsewhere / "preprocess.png").read_bytes().startswith(b"\x89PNG")


@pytest.mark.parametrize("name", [name for name in get_args(Without) if name != "none"])
def test_design_parameters_can_be_left_out(elsewhere, capsys, monkeypatch, name):
    monkeypatch.setenv("COLUMNS", "200")
    assert cli.main(["preprocess", "--timing", "wave", "--prior", "body+gait", "--without", name]) == 0
    captured = capsys.readouterr()
    assert name not in captured.out
    assert (elsewhere / "preprocess-gait.png").exists() == (name not in ("stroke", "advance"))


def test_preprocess_prints_a_table_with_every_gene(elsewhere, capsys, monkeypatch):
    monkeypatch.setenv("COLUMNS", "200")
    assert cli.main(["preprocess", "--num-segments", "2", "--out", "d.png"]) == 0
    captured = capsys.readouterr()
    for name in ("leg separation", "segment mass", "gap1 ventral off", "8 to 24 mm", "contradiction"):
        assert name in captured.out
    assert "d.png" in captured.err
    assert (elsewhere / "d.png").exists()
