"""Damaged or hostile files in the folder of a study are refused in one line."""

import json
import os
import tomllib
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import polars
import pytest

from caterpillar_env.errors import CaterpillarError
from evolution.study.config import StudyConfig, begin, load
from evolution.study.results import DATA, read_kept
from evolution.study.winners import judge_winners

SMALL = tomllib.loads(Path(__file__).with_name("small.toml").read_text("utf-8"))


@pytest.fixture
def analysis():
    """The part of an analysis that these functions need first, of a study without runs."""
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
def test_winners(tmp_path, analysis, text):
    (tmp_path / "winners").mkdir()
    (tmp_path / "winners" / "winners.json").write_text(text)
    with pytest.raises(CaterpillarError, match=r"winners\.json.* (remove|not JSON)"):
        judge_winners(analysis, tmp_path)


def test_the_table_of_evaluations(tmp_path):
    assert read_kept(tmp_path) == {}
    (tmp_path / DATA).write_bytes(b"no table")
    with pytest.raises(CaterpillarError, match=r"cannot read .*restore a copy"):
        read_kept(tmp_path)
    polars.DataFrame({"arm": ["a"], "seed": [0]}).write_parquet(tmp_path / DATA)
    with pytest.raises(CaterpillarError, match="has no columns distance_m, energy_j"):
        read_kept(tmp_path)


def test_the_settings(tmp_path):
    config = StudyConfig.from_dict(SMALL)
    begin(config, tmp_path)
    content, rng = bytearray((tmp_path / "study.json").read_bytes()), np.random.default_rng(0)
    for place in rng.integers(0, len(content), 60):
        altered = content.copy()
        altered[place] ^= 1 << int(rng.integers(0, 7))
        (tmp_path / "study.json").write_bytes(altered)
        try:
            load(tmp_path)  # without a digest, because people may edit it
        except CaterpillarError as error:
            message = str(error)
        else:
            continue
        assert "study.json" in message
    (tmp_path / "study.json").unlink()
    os.mkfifo(tmp_path / "study.json")
    with pytest.raises(CaterpillarError, match="it is not a regular file"):
        load(tmp_path)
