"""`caterpillar export`: tables and models of runs, and refused input."""

import mujoco
import numpy as np
import polars
import pytest

from caterpillar_env.physics import Physics
from caterpillar_env.robot import Robot
from evolution import cli
from evolution.config import RunConfig
from evolution.run.history import load


@pytest.mark.parametrize(
    ("kind", "read"),
    [("csv", polars.read_csv), ("parquet", polars.read_parquet), ("json", polars.read_json)],
)
def test_exported_tables_equal_the_journal(runs, tmp_path, kind, read, capsys):
    out = tmp_path / f"rows.{kind}"
    assert cli.main(["export", str(runs / "done"), "--to", kind, "--out", str(out)]) == 0
    assert "5 evaluations written to" in capsys.readouterr().err
    assert read(out).equals(load(runs / "done").table())


def test_export_is_written_beside_the_journal_and_contains_the_best_robot(runs):
    assert cli.main(["export", str(runs / "done")]) == 0
    rows = polars.read_csv(runs / "done" / "evaluations.csv")
    best = Robot.load(runs / "done")
    row = rows.row(int(rows["fitness"].arg_max()), named=True)
    assert row["distance_m"] == best.fitness_m
    assert row["segment_mass_kg"] == best.morphology.segment_mass_kg
    assert row["gap1_ventral_off_s"] == best.timings.off_s[1]


@pytest.mark.parametrize("source", ["done", "done/best.json"])
def test_robot_of_a_run_is_exported_as_a_model(runs, source, capsys):
    out = runs / "done" / "best.xml"
    out.unlink(missing_ok=True)
    assert cli.main(["export", str(runs / source), "--to", "mjcf"]) == 0
    assert f"with 2 segments written to {out}" in capsys.readouterr().err
    model = mujoco.MjModel.from_xml_path(str(out))
    best = Robot.load(runs / "done")
    assert model.nu == 4
    assert model.opt.timestep == 0.01
    assert model.body_mass.sum() == pytest.approx(2 * best.morphology.segment_mass_kg)


@pytest.mark.parametrize("genome", ["full", "per-segment"])
def test_robots_of_all_kinds_are_exported(tmp_path, genome):
    encoding = RunConfig(genome=genome, physics=Physics(num_segments=3)).encoding
    genes = np.random.default_rng(1).random(len(encoding.genes))
    encoding.robot(genes).save(tmp_path / "robot.json")
    out = tmp_path / "model.xml"  # the suffix selects the kind
    assert cli.main(["export", str(tmp_path / "robot.json"), "--out", str(out)]) == 0
    assert mujoco.MjModel.from_xml_path(str(out)).nu == 8


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["export", "nowhere"], "is not a run folder"),
        (["export", "done", "--to", "xlsx"], "--to"),
        (["export", "done", "--out", "missing/rows.csv"], "choose another place with --out"),
        (["export", "damaged"], "is damaged"),
        (["export", "done/best.json"], "to export the robot in a JSON file, add --to mjcf"),
        (["export", "done", "--out", "rows.xlsx"], "the suffix of --out must be .csv, .parquet, .json"),
        (["export", "nowhere", "--to", "mjcf"], "give a run folder or the JSON file of one robot"),
        (["export", "empty", "--to", "mjcf"], "empty holds no best.json"),
        (["export", "done", "--to", "mjcf", "--out", "missing/robot.xml"], "cannot write missing/robot"),
        (["export", "done", "--to", "mjcf", "--out", "empty"], "choose another place with --out"),
        (["export", "policy.json", "--to", "mjcf"], "for a trained policy, use caterpillar rl eval"),
        (["runs", "nowhere"], "nowhere is not a folder"),
    ],
)
def test_wrong_input_is_refused_with_the_reason(runs, monkeypatch, capsys, arguments, message):
    monkeypatch.chdir(runs)
    assert cli.main(arguments) in (1, 2)
    assert message in capsys.readouterr().err
