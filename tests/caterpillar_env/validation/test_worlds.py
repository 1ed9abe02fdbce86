import pytest

from caterpillar_env.validation import worlds
from caterpillar_env.worlds import World


@pytest.mark.slow
def test_robots_hardly_creep_on_slopes():
    assert not [check for check in worlds.check_creep(quick=True) if not check.passed]


@pytest.mark.slow
def test_a_coarse_timestep_changes_distances_on_rough_ground_by_millimetres():
    pair, spread = worlds.compare_timesteps(World.of("rough"), quick=True)
    assert pair.agreement() >= 0.85
    (ours_m, reference_m), (nudged_m, usual_m) = pair.distances_m(), spread.distances_m()
    assert 0 < abs(ours_m - reference_m).max() < 0.02
    assert 0 < abs(nudged_m - usual_m).max() < 0.02
