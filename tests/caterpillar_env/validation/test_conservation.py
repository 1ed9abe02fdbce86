import numpy as np
import pytest

from caterpillar_env import Physics
from caterpillar_env.validation import conservation


def test_robots_drift_less_at_a_finer_timestep():
    coarse, fine = (
        conservation.drift_m(Physics(timestep_s=timestep_s), 3, 5.0) for timestep_s in (0.005, 0.001)
    )
    assert np.median(fine) < np.median(coarse)


@pytest.mark.parametrize(
    ("energy_j", "share"),
    [([4.0, 3.0, 2.0, 0.0], 0.0), ([4.0, 1.0, 2.0, 0.0], 0.25), ([4.0, 3.0, 5.0, 0.0], 0.5)],
)
def test_regained_energy_is_detected(energy_j, share):
    assert conservation._regained(np.array(energy_j)) == share
