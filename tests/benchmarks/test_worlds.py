import json

import numpy as np
import pytest

from benchmarks import worlds
from caterpillar_env.errors import CaterpillarError
from caterpillar_env.robot import wave_robot
from caterpillar_env.worlds import World
from evolution.study.cells import Processes, run_study
from evolution.study.config import StudyConfig, begin

PHYSICS = {"num_segments": 2, "timestep_s": 0.01}
STUDY = {
    "seeds": [0, 1], "thresholds_m": [0.01], "budget_s": 120, "reference": "flat",
    "base": {"ga": {"population": 4, "hall_of_fame": 1}, "prior": "uniform", "physics": PHYSICS},
    "arms": {"flat": {}, "rough": {"physics": {"world": "rough"}}},
}  # fmt: skip


@pytest.mark.slow
def test_winners_are_tested_in_the_world_of_every_arm(tmp_path, capsys):
    config = StudyConfig.from_dict(STUDY)
    begin(config, tmp_path)
    assert not run_study(config, tmp_path, Processes(2), lambda ended, share: None)
    worlds.compare_winners(tmp_path)
    lines = capsys.readouterr().out.splitlines()
    matrix, failures, bodies = (json.loads(line)["rows"] for line in lines)
    for row, failed in zip(matrix, failures, strict=True):
        assert list(row) == list(failed)
        # Each arm has two robots: if both failed, the median is 0.
        assert all(row[w]["median"] == 0 for w in list(row)[2:] if failed[w].startswith("2 "))
    assert [row["evolved on"] for row in matrix] == ["flat", "rough"]
    for row in matrix:
        assert list(row)[2:] == ["flat", "rough", "rough:seed=1000"]
        for world in list(row)[2:]:
            median, low, high = row[world].values()
            assert median >= 0
            if row["robots"] > 1:  # the interval of a single robot is unknown
                assert 0 <= low <= median <= high
    own_mm = [run["flat"]["median"] for run in matrix]
    assert own_mm[0] > 0
    assert len(bodies) == 8


def test_a_study_without_finished_runs_is_rejected(tmp_path):
    begin(StudyConfig.from_dict(STUDY), tmp_path)
    with pytest.raises(CaterpillarError, match=r"no run of .* is finished; continue with"):
        worlds.compare_winners(tmp_path)


def test_the_hand_made_wave_crawls_and_failed_robots_count_as_0():
    wave = wave_robot()
    (flat_mm,) = worlds.fitness_mm([wave], World.of("flat"))
    assert flat_mm == pytest.approx(177, abs=1)  # as in docs/results/rl.md
    steep_mm = worlds.fitness_mm([wave], World.of("slope:angle_deg=45"))
    np.testing.assert_array_equal(steep_mm, [0.0])
