import numpy as np
import pytest

from caterpillar_env.robot import Outcomes
from caterpillar_env.validation import convergence


def outcomes(failure, distance_m):
    nothing = np.zeros(len(failure))
    return Outcomes(np.array(failure, dtype=np.int8), np.array(distance_m), nothing, nothing)


def test_statistics_match_a_hand_worked_example():
    # The last robot fails at the reference only.
    random = convergence.Pair(outcomes([0, 3], [0.010, 0.5]), outcomes([0, 3], [0.020, 0.1]))
    evolved = convergence.Pair(
        outcomes([0, 0, 0], [0.110, 0.180, 0.3]), outcomes([0, 0, 5], [0.100, 0.200, 0.3])
    )
    assert random.agreement() == 1.0
    assert evolved.agreement() == pytest.approx(2 / 3)
    assert evolved.distances_m().tolist() == [[0.110, 0.180], [0.100, 0.200]]
    assert evolved.median_error() == pytest.approx(0.1)
    assert convergence.rank_correlation(random, evolved) == pytest.approx(1.0)
