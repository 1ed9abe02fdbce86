"""Damaged or hostile files in the folder of a study are refused in one line."""

import json
import os
import subprocess
import tomllib
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import polars
import pytest

from caterpillar_env.errors import CaterpillarError
from caterpillar_env.robot import Outcomes
from evolution.run.history import History
from evolution.run.journal import Journal
from evolution.study.config import StudyConfig, begin, load
from evolution.study.results import DATA, DIGEST, collect, read_kept
from evolution.study.winners import retest_winners

SMALL = tomllib.loads(Path(__file__).with_name("small.toml").read_text("utf-8"))


@pytest.fixture
def analysis():
    """The part of an analysis that these functions need first, for a study without runs."""
    config = StudyConfig.from_dict(SMALL)
    return SimpleNamespace(config=config, runs={})


END = {"distance_m": 0.1, "failure": "ok"}
ROW = {"arm": "a", "seed": 0, "recorded_m": 0.1, "references": {"0.25 ms": END}}
DAMAGED = [
    ROW | {"recorded_m": "far"}, ROW | {"references": {"0.25 ms": 3}}, ROW | {"gait": {}},
    ROW | {"references": {"0.25 ms": END | {"distance_m": "far"}}},
]  # fmt: skip
TEXTS = [
    "{", "{}", "[1]", "3", "null", '"x"', '{"a": 1, "a": 2}', "[" * 50_000, "[{}]",
    *(json.dumps([row]) for row in DAMAGED),
]  # fmt: skip


@pytest.mark.parametrize("text", TEXTS, ids=range(len(TEXTS)))
def test_damaged_winners_are_refused(tmp_path, analysis, text):
    (tmp_path / "winners").mkdir()
    (tmp_path / "winners" / "winners.json").write_text(text)
    with pytest.raises(CaterpillarError, match=r"winners\.json.* (remove|not JSON)"):
        retest_winners(analysis, tmp_path)


def test_an_unreadable_or_incomplete_table_is_refused(tmp_path):
    assert read_kept(tmp_path) == {}
    (tmp_path / DATA).write_bytes(b"no table")
    with pytest.raises(CaterpillarError, match=r"cannot read .*restore a copy"):
        read_kept(tmp_path)
    polars.DataFrame({"arm": ["a"], "seed": [0]}).write_parquet(tmp_path / DATA)
    with pytest.raises(CaterpillarError, match="has no columns distance_m, energy_j"):
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


def test_damaged_settings_are_detected_or_harmless(tmp_path):
    config = StudyConfig.from_dict(SMALL)
    begin(config, tmp_path)
    content, rng = bytearray((tmp_path / "study.json").read_bytes()), np.random.default_rng(0)
    for place in rng.integers(0, len(content), 300):
        altered = content.copy()
        altered[place] ^= 1 << int(rng.integers(0, 7))
        (tmp_path / "study.json").write_bytes(altered)
        try:
            assert load(tmp_path) == config
        except CaterpillarError as error:
            message = str(error)
        else:
            continue
        assert "study.json" in message
    (tmp_path / "study.json").unlink()
    os.mkfifo(tmp_path / "study.json")
    with pytest.raises(CaterpillarError, match="it is not a regular file"):
        load(tmp_path)
