"""Results of a study: reading its runs and its table, and reporting them."""

import json
import shutil
import subprocess
import tomllib
from pathlib import Path

import numpy as np
import polars
import pytest

from caterpillar_env.errors import CaterpillarError
from caterpillar_env.robot import Outcomes
from evolution import cli
from evolution.run.history import History
from evolution.run.journal import Journal
from evolution.study import winners
from evolution.study.config import Cell, StudyConfig, begin, load
from evolution.study.results import (
    DATA,
    DIGEST,
    Run,
    collect,
    read_all,
    read_kept,
    read_run,
    read_runs,
)

SMALL = tomllib.loads(Path(__file__).with_name("small.toml").read_text("utf-8"))


def changed(**fields):
    return {**SMALL, **fields}


# Reading runs and the table


def test_runs_with_other_settings_are_rejected(finished, tmp_path):
    arms = {**SMALL["arms"], "cma-es": {"optimizer": "random"}}
    other = StudyConfig.from_dict(changed(arms=arms))
    begin(other, tmp_path / "copy")
    shutil.copytree(finished / "cells", tmp_path / "copy" / "cells")
    with pytest.raises(CaterpillarError, match=r"cma-es/seed-0 has settings that differ"):
        collect(other, tmp_path / "copy")


def test_table_keeps_runs_whose_folders_were_deleted(finished, tmp_path):
    shutil.copytree(finished, tmp_path / "copy")
    config = load(finished)
    for cell in config.cells()[1:]:
        shutil.rmtree(cell.folder(tmp_path / "copy"))
    results = collect(config, tmp_path / "copy")
    assert not results.missing
    key = ["arm", "seed", "evaluation"]
    assert results.table.sort(key).equals(collect(config, finished).table.sort(key))


def test_a_study_can_be_read_while_it_runs(finished):
    config = load(finished)
    with Journal(config.cells()[0].folder(finished)):
        assert read_run(config, config.cells()[0], finished).finished
        assert collect(config, finished).missing == []


def test_longer_record_of_a_run_is_used(finished, tmp_path):
    config, table = load(finished), polars.read_parquet(finished / DATA)
    begin(config, tmp_path)
    cell = config.cells()[0]
    rows = table.filter(arm=cell.arm, seed=cell.seed)
    arm, folder = config.arms[cell.arm], cell.folder(tmp_path)
    arm.restore(rows.filter(polars.col("generation") < 2), folder, cell.seed, config.budget_s)
    assert len(collect(config, tmp_path).missing) == len(config.cells())
    rows.write_parquet(tmp_path / DATA)  # from another machine, with more generations
    (tmp_path / DIGEST).unlink()
    assert cell not in collect(config, tmp_path).missing
    rows.filter(polars.col("generation") < 1).write_parquet(tmp_path / DATA)  # with fewer generations
    (tmp_path / DIGEST).unlink()
    assert read_all(config, tmp_path)[cell]["generation"].max() == 1


def test_an_unreadable_or_incomplete_table_is_refused(tmp_path):
    assert read_kept(tmp_path) == {}
    (tmp_path / DATA).write_bytes(b"no table")
    with pytest.raises(CaterpillarError, match=r"cannot read .*restore a copy"):
        read_kept(tmp_path)
    polars.DataFrame({"arm": ["a"], "seed": [0]}).write_parquet(tmp_path / DATA)
    with pytest.raises(CaterpillarError, match="lacks these columns: distance_m, energy_j"):
        read_kept(tmp_path)


def test_a_damaged_table_is_refused(tmp_path):
    study = StudyConfig.from_dict(SMALL)
    cell = study.cells()[0]
    config = study.arms[cell.arm].run_config(cell.seed, study.budget_of(cell))
    cell.folder(tmp_path).mkdir(parents=True)
    with Journal.create(cell.folder(tmp_path), config.to_dict()) as journal:
        history = History(journal)
        history.begin()
        rng = np.random.default_rng(0)
        for _ in range(3):
            genomes = rng.random((20, len(config.encoding.genes)))
            energy_j, simulated_s = np.ones(20), np.full(20, 30.0)
            outcomes = Outcomes(np.zeros(20, dtype=np.int8), rng.random(20), energy_j, simulated_s)
            history.append(genomes, outcomes)
            history.complete()
        history.finish()
    table = collect(study, tmp_path).table
    assert len(table) == 60
    file, digest = tmp_path / DATA, tmp_path / DIGEST
    checked = ["sha256sum", "--check", DIGEST]
    assert subprocess.run(checked, cwd=tmp_path, capture_output=True).returncode == 0
    for damaged in (file, digest):
        content = damaged.read_bytes()
        for place in rng.integers(0, len(content), 50):
            altered = bytearray(content)
            altered[place] ^= 1 << int(rng.integers(0, 8))
            damaged.write_bytes(altered)
            with pytest.raises(CaterpillarError, match=r"parquet is damaged: .*restore a copy"):
                read_kept(tmp_path)
        damaged.write_bytes(content)
    assert read_kept(tmp_path)[cell].equals(table)
    digest.unlink()
    assert read_kept(tmp_path)[cell].equals(table)


@pytest.mark.parametrize("place", [3, 400, -9, -20, -200])
def test_a_damaged_table_without_a_digest_raises_an_error(tmp_path, place):
    numbers = np.random.default_rng(0).random(500)
    table = polars.DataFrame({"arm": ["a"] * 500, "seed": [1] * 500, "distance_m": numbers})
    table.write_parquet(tmp_path / DATA)
    content = bytearray((tmp_path / DATA).read_bytes())
    content[place] ^= 255
    (tmp_path / DATA).write_bytes(content)
    with pytest.raises(CaterpillarError, match=DATA):
        read_kept(tmp_path)


# Distances


def test_distances_of_a_run_by_time_and_generation():
    run = Run(
        seed=0, spent_s=np.array([10.0, 20.0, 35.0, 50.0]), best_m=np.array([0.0, 0.01, 0.01, 0.03]),
        failure=np.full(4, "ok"), generation=np.array([0, 0, 1, 1]), generations=2, budget_s=60.0,
    )  # fmt: skip
    assert [run.time_to(distance_m) for distance_m in (0.01, 0.02, 0.04)] == [20.0, 50.0, np.inf]
    assert [run.generations_to(distance_m) for distance_m in (0.01, 0.02, 0.04)] == [1, 2, np.inf]
    assert [run.best_after(count) for count in (1, 2)] == [0.01, 0.03]
    assert np.isnan(run.best_after(3))
    cut = run._replace(generations=1)  # the budget ends within the second generation
    assert [cut.time_to(0.02), cut.generations_to(0.02)] == [50.0, np.inf]
    assert np.isnan(cut.best_after(2))
    assert [run.best_at(time_s) for time_s in (9.0, 20.0, 60.0)] == [0.0, 0.01, 0.03]


def test_evaluations_beyond_the_budget_do_not_count():
    config = StudyConfig.from_dict(changed(budget_s=30))
    frame = polars.DataFrame(
        {
            "arm": ["cma-es"] * 4,
            "seed": [0] * 4,
            "evaluation": [0, 1, 2, 3],
            "generation": [0, 0, 1, 1],
            "failure": ["ok", "tipped", "ok", "ok"],
            "stopped": [False] * 4,
            "distance_m": [0.01, 0.5, -0.2, 0.9],
            "simulated_s": [10.0, 4.0, 16.0, 10.0],
        }
    )  # fmt: skip
    (run,) = read_runs(frame, config)["cma-es"]
    assert run.spent_s.tolist() == [10.0, 14.0, 30.0]
    assert run.generations == 1  # the second is not complete
    assert run.best_m.tolist() == [0.01, 0.01, 0.01]


def test_robots_that_racing_stopped_reach_no_distance():
    config = StudyConfig.from_dict(changed(budget_s=100))
    frame = polars.DataFrame(
        {
            "arm": ["cma-es"] * 3,
            "seed": [0] * 3,
            "evaluation": [0, 1, 2],
            "generation": [0, 0, 0],
            "failure": ["ok"] * 3,
            "stopped": [True, False, False],
            "distance_m": [0.5, 0.1, 0.2],
            "simulated_s": [10.0, 30.0, 30.0],
        }
    )
    (run,) = read_runs(frame, config)["cma-es"]
    assert run.best_m.tolist() == [0.0, 0.1, 0.2]
    assert run.spent_s.tolist() == [30.0, 50.0, 70.0]


# The command `report`


def test_report_is_one_page_with_all_arms(finished):
    page = (finished / "report.html").read_text()
    for arm in SMALL["arms"]:
        assert f"<td>{arm}" in page
    assert page.count("data:image/png;base64,") == 5
    assert "http" not in page
    assert "Some arms have only 2 finished runs" in page


@pytest.mark.slow
def test_report_can_be_made_again_from_the_table_alone(finished, tmp_path, capsys):
    for name in ("study.json", DATA):
        (tmp_path / name).write_bytes((finished / name).read_bytes())
    with Journal(Cell("cma-es", 0).folder(finished)):  # as if it were still running
        assert cli.main(["report", str(finished)]) == 0
    first = capsys.readouterr().out
    assert cli.main(["report", str(tmp_path)]) == 0
    assert capsys.readouterr().out == first
    assert "cma-es" in first


def test_best_robots_are_simulated_again_only_once(finished, capsys):
    rows = json.loads((finished / "winners" / "winners.json").read_text())
    assert {row["arm"] for row in rows} == set(SMALL["arms"])
    for row in rows:
        arm = row["arm"]
        assert row["recorded_m"] > 0
        assert (finished / "winners" / f"{arm}.json").exists()
        assert (
            cli.main(["replay", str(finished / "winners" / f"{arm}.json"), "--no-video", "--json"]) == 0
        )
        assert json.loads(capsys.readouterr().out.partition("{")[2].join(["{", ""]))["identical"]
    before = (finished / "winners" / "winners.json").stat().st_mtime_ns
    assert cli.main(["report", str(finished)]) == 0
    assert (finished / "winners" / "winners.json").stat().st_mtime_ns == before


@pytest.mark.slow
def test_report_compares_all_winners_on_request(finished, tmp_path, monkeypatch, capsys):
    shutil.copytree(finished, tmp_path / "study")
    monkeypatch.setattr(winners, "CONDITIONS", {"5 ms": {"timestep_s": 0.005}})
    assert cli.main(["report", str(tmp_path / "study"), "--all-winners"]) == 0
    printed = capsys.readouterr().out
    for arm in SMALL["arms"]:
        assert f"{arm}, 5 ms: " in printed
    assert "simulated again</h2>" in (tmp_path / "study" / "report.html").read_text("utf-8")


def test_only_studies_have_winners_to_compare(finished, capsys):
    run = next((finished / "cells").glob("*/seed-*"))
    assert cli.main(["report", str(run), "--all-winners"]) == 1
    assert "--all-winners needs the folder of a study" in " ".join(capsys.readouterr().err.split())


def test_landscape_of_a_study_is_refused(finished, capsys):
    assert cli.main(["report", str(finished), "--landscape", "lag", "offset"]) == 1
    assert "--landscape needs the folder of a run" in " ".join(capsys.readouterr().err.split())
