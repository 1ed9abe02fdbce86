import mujoco
import numpy as np
import pytest

from caterpillar_env.ground import FOOT, SKIN
from caterpillar_env.validation.gaits import (
    Gait,
    _cover_best_tenth,
    _replay,
    check_gaits,
    measure_gait,
)
from caterpillar_env.validation.robots import evolved_robots


@pytest.fixture(scope="module")
def robot():
    """A robot that leaps: for some milliseconds in each period, nothing supports it."""
    return evolved_robots()[13]


@pytest.fixture(scope="module")
def gait(robot):
    return measure_gait(robot, duration_s=20.0)


def test_figures_agree_with_the_simulation(robot, gait):
    end = robot.simulate(duration_s=20.0)
    assert gait.distance_m == end.distance_m[0]
    later_m = gait.distance_m - robot.simulate(duration_s=5.0).distance_m[0]
    assert gait.settled == pytest.approx(later_m / 15 / (gait.distance_m / 20), rel=1e-3)
    weight_n = 4 * robot.morphology.segment_mass_kg * 9.81
    assert gait.cost_of_transport == pytest.approx(end.energy_j[0] / weight_n / end.distance_m[0])
    length_m = 4 * robot.morphology.segment_length_m
    assert gait.body_lengths_s == pytest.approx(end.distance_m[0] / length_m / 20)


def test_figures_are_plausible(gait):
    assert gait.best_tenth >= 0.1  # a steady gait has a tenth of the distance in each tenth
    assert gait.peak_speed_m_s > gait.distance_m / 20
    assert 0.25 < gait.airborne < 0.5
    assert 0 <= gait.body_load <= 0.15  # 5 % of 30 s may all fall into the first 20 s
    assert gait.overrun >= 0
    assert gait.slip > 0


@pytest.mark.parametrize("start", [0, 7, 38])
def test_best_tenth_may_cross_the_end_of_the_period(start):
    steps = np.full(40, 0.1)
    steps[np.arange(start, start + 4) % 40] = 1.0
    assert _cover_best_tenth(steps) == pytest.approx(4.0)


#: A body on three supports without friction. Motors turn it about the vertical axis and push it. The
#: centre of mass lies between the front support, which bears 60 % of the weight, and the others.
SPINNING = """
<mujoco>
  <option timestep="0.001"/>
  <worldbody>
    <geom type="plane" size="1 1 1" condim="1" contype="3" conaffinity="0"/>
    <body pos="{x_m} 0 0.01">
      <freejoint name="root"/>
      <inertial pos="0 0 0" mass="0.1" diaginertia="1e-4 1e-4 1e-4"/>
      <geom size="0.01" pos="0.02 0 0" condim="1" contype="0" conaffinity="{front}"/>
      <geom size="0.01" pos="-0.03 0.05 0" condim="1" contype="0" conaffinity="1"/>
      <geom size="0.01" pos="-0.03 -0.05 0" condim="1" contype="0" conaffinity="1"/>
      <body>
        <joint name="hinge" axis="0 1 0" limited="true" range="-0.1 0.1"/>
        <inertial pos="0 0 0" mass="1e-3" diaginertia="1e-6 1e-6 1e-6"/>
      </body>
    </body>
  </worldbody>
  <actuator>
    <motor joint="root" gear="0 0 0 0 0 1"/>
    <motor joint="root" gear="0 1 0 0 0 0"/>
    <motor joint="hinge"/>
  </actuator>
</mujoco>
"""


def spin(front, push_n=0.0, hinge_n_m=0.0, x_m=0.0):
    """Return the turned angle (rad), slip (m), load share of the body, and overrun after 0.5 s."""
    model = mujoco.MjModel.from_xml_string(SPINNING.format(front=front, x_m=x_m))
    control = np.tile([1e-4, push_n, hinge_n_m], (500, 1))
    end = _replay(model, model.qpos0, control)
    return 2 * np.arctan2(end.qpos[6], end.qpos[3]), end.slip_m, end.body_load, end.overrun


@pytest.mark.parametrize("x_m", [0.0, 0.3])
def test_slip_is_the_sliding_distance_of_the_feet_weighted_by_their_loads(x_m):
    turned, slip_m, body_load, _ = spin(front=FOOT, x_m=x_m)
    assert slip_m == pytest.approx(turned * (0.6 * 0.02 + 0.4 * np.hypot(0.03, 0.05)), rel=0.01)
    assert body_load == 0


def test_foot_about_which_the_body_turns_does_not_slip():
    # The centre of mass accelerates at 0.02 m times the angular acceleration of 1e-4 / 1.01e-4 rad/s2.
    turned, slip_m, _, _ = spin(front=FOOT, push_n=-0.02 * 0.101 * 1e-4 / 1.01e-4)
    assert slip_m == pytest.approx(turned * 0.4 * np.hypot(0.05, 0.05), rel=0.05)


def test_skin_bears_load_but_does_not_slip():
    turned, slip_m, body_load, _ = spin(front=SKIN)
    assert slip_m == pytest.approx(turned * np.hypot(0.03, 0.05), rel=0.01)
    assert body_load == pytest.approx(0.6, rel=0.01)


@pytest.mark.parametrize("part", [FOOT, SKIN])
def test_falling_body_is_airborne_until_it_lands(part):
    model = mujoco.MjModel.from_xml_string(SPINNING.format(front=part, x_m=0.0))
    height_m = 0.02
    end = _replay(model, model.qpos0 + height_m * np.eye(model.nq)[2], np.zeros((500, 3)))
    landed = int(end.airborne.argmin())
    assert landed * model.opt.timestep == pytest.approx(np.sqrt(2 * height_m / 9.81), rel=0.05)
    assert not end.airborne[-100:].any()


def test_joints_overrun_their_lower_limits_too():
    lower, upper = (spin(FOOT, hinge_n_m)[-1] for hinge_n_m in (-1e-5, 1e-5))
    assert lower == pytest.approx(upper, rel=0.2)
    assert upper > 0.01


@pytest.mark.parametrize(
    ("overruns", "load", "passed"),
    [
        ([0.0, 0.01, 0.14], 0.01, [True, True, True]),
        ([0.06, 0.06, 0.06], 0.01, [False, True, True]),
        ([0.0, 0.0, 0.16], 0.01, [True, False, True]),
        ([0.0, 0.0, 0.0], 0.06, [True, True, False]),
    ],
)
def test_soft_stops_and_crawling_on_the_body_do_not_pass(overruns, load, passed):
    gaits = [Gait(0.1, 0.2, 1.0, 0.1, 0.0, 0.5, load, overrun, 1000.0, 0.03) for overrun in overruns]
    assert [check.passed for check in check_gaits(gaits)] == passed
