import mujoco
import numpy as np
import pytest
from scipy.integrate import quad

from caterpillar_env import Morphology, Physics
from caterpillar_env.model import build_model, joint_names
from caterpillar_env.sma import spring_force
from caterpillar_env.validation import conservation


@pytest.mark.parametrize(
    ("energy_j", "share"),
    [([4.0, 3.0, 2.0, 0.0], 0.0), ([4.0, 1.0, 2.0, 0.0], 0.25), ([4.0, 3.0, 5.0, 0.0], 0.5)],
)
def test_regained_energy_is_detected(energy_j, share):
    assert conservation._regained(np.array(energy_j)) == share


def test_energy_includes_the_work_that_stretched_the_springs():
    physics = Physics(num_segments=2, mismatch_std=0.0)
    model = build_model(Morphology(), physics, scenery=False)
    data = mujoco.MjData(model)
    data.qpos[7:] = [0.08 * name.startswith("axial") for name in joint_names(2)]
    (energy_j,) = conservation._energy(model, data.qpos, physics, 1)
    mujoco.mj_forward(model, data)
    assert spring_force(physics.spring, data.ten_length, 0.0).max() == physics.spring.force_limit_n
    rest_m = physics.spring.martensite_rest_length_m
    work_j = sum(
        quad(lambda x: spring_force(physics.spring, x, 0.0), rest_m, max(end_m, rest_m))[0]
        for end_m in data.ten_length
    )
    assert energy_j == pytest.approx(data.energy.sum() + work_j)
