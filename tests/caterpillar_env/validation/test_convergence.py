import numpy as np
import pytest

from caterpillar_env.robot import Outcomes
from caterpillar_env.validation import convergence


def outcomes(failure, distance_m):
    nothing = np.zeros(len(failure))
    return Outcomes(np.array(failure, dtype=np.int8), np.array(distance_m), nothing, nothing)


def test_statistics_match_a_hand_worked_example():
    # Two random robots, three evolved ones; the last fails at the reference only.
    coarse = outcomes([0, 3, 0, 0, 0], [0.010, 0.5, 0.110, 0.180, 0.3])
    fine = outcomes([0, 3, 0, 0, 5], [0.020, 0.1, 0.100, 0.200, 0.3])
    evolved = np.array([False, False, True, True, True])
    result = convergence.Comparison(coarse, fine, evolved, np.zeros(3))
    assert result.agreement(evolved=False) == 1.0
    assert result.agreement(evolved=True) == pytest.approx(2 / 3)
    assert result.errors() == pytest.approx([0.1, 0.1])
    assert result.rank_correlation() == pytest.approx(1.0)
