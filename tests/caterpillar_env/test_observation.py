import math

import numpy as np
import pytest

from caterpillar_env import Morphology, Physics
from caterpillar_env.observation import observation_names, observe
from caterpillar_env.task import Crawl

BODY = Morphology()


def crawl():
    return Crawl([BODY], Physics(), 1)


def sense(robots, morphology, clock_s):
    """Return the observations of all robots; `morphology` is the scaled value of all body parameters."""
    state, progress = robots.simulation.state(), robots.progress()
    bodies = np.full((len(state.com_m), 8), morphology)
    return observe(robots.physics, state, progress.heading_rad, bodies, clock_s)


def off(rows=1, intervals=1):
    return np.zeros((rows, 10 * intervals, 12))


@pytest.mark.parametrize("clock", [False, True])
@pytest.mark.parametrize("segments", [2, 4, 5])
def test_every_entry_of_an_observation_is_named_once(segments, clock):
    physics = Physics(num_segments=segments)
    robots = Crawl([BODY] * 2, physics, 1)
    names = observation_names(physics, clock=clock)
    values = sense(robots, 0.0, 3.0 if clock else None)
    assert values.shape == (2, len(names))
    assert values.dtype == np.float32
    assert len(set(names)) == len(names)


def test_entries_have_their_documented_scales():
    robots = crawl()
    power = off(1, 5)
    power[:, :, 0] = 1.0
    robots.run(power)
    state, progress = robots.simulation.state(), robots.progress()
    names = observation_names(Physics(), clock=True)
    values = dict(zip(names, sense(robots, 0.25, 2.0)[0], strict=True))
    forward = state.forward[0]
    left = np.cross([0, 0, 1], forward / np.linalg.norm(forward[:2]))
    expected = {
        "position:axial0": state.joint_position[0, 0] / 0.003,
        "position:neck0": state.joint_position[0, 2] / 0.3,
        "velocity:axial0": state.joint_velocity[0, 0] / 0.020,
        "velocity:neck0": state.joint_velocity[0, 2] / 1.0,
        "up:z": state.up[0, 2],
        "heading:cos": math.cos(progress.heading_rad[0]),
        "heading:sin": math.sin(progress.heading_rad[0]),
        "height": state.com_m[0, 2] / 0.024,
        "linear_velocity:y": state.velocity[0, :3] @ left / 0.020,
        "angular_velocity:y": state.velocity[0, 3:] @ left,
        "angular_velocity:z": state.velocity[0, 5],
        "temperature:gap1_dorsal_left": (state.temperature_c[0, 0] - 25) / (120 - 25),
        "temperature:gap1_dorsal_right": 0.0,
        "fraction:gap1_dorsal_left": state.fraction[0, 0],
        "phase:cos": 0.0,  # 0.5 s of 2 s
        "phase:sin": 1.0,
        "morphology:joint_limit_rad": 0.25,
    }
    for name, value in expected.items():
        assert values[name] == pytest.approx(value, abs=1e-6), name
    assert values["temperature:gap1_dorsal_left"] > 0.2


@pytest.mark.parametrize("heading_rad", [math.pi / 3, -2.5])
def test_progress_and_observation_do_not_depend_on_the_starting_heading(heading_rad):
    """The same motion relative to the start gives the same progress for any starting heading."""
    rng = np.random.default_rng(0)
    joints, rates = rng.normal(0, 0.003, 11), rng.normal(0, 0.3, 17)
    drift, turn = np.array([0.02, 0.01, 0.003]), 0.3
    seen, progresses = [], []
    for start_rad in (0.0, heading_rad):
        robots = crawl()
        robots.reset([BODY], heading_rad=start_rad)
        simulation, now_rad = robots.simulation, start_rad + turn
        compass = np.array(
            [
                [math.cos(start_rad), -math.sin(start_rad), 0],
                [math.sin(start_rad), math.cos(start_rad), 0],
                [0, 0, 1],
            ]
        )
        qpos, qvel = simulation.qpos(0), rates.copy()
        qpos[:3] += compass @ drift
        qpos[3:7] = [math.cos(now_rad / 2), 0, 0, math.sin(now_rad / 2)]
        qpos[7:] = joints
        qvel[:3] = compass @ rates[:3]  # linear in the world, angular in the body
        simulation.place(qpos[None], qvel=qvel[None])
        robots.run(off())
        seen.append(sense(robots, 0.0, 3.0))
        progresses.append(robots.progress())
    np.testing.assert_allclose(seen[1], seen[0], rtol=1e-5, atol=1e-5)
    for one, other in zip(*progresses, strict=True):
        np.testing.assert_allclose(other, one, atol=1e-12)
    assert progresses[0].heading_rad[0] == pytest.approx(0.3, abs=0.02)
    assert progresses[0].distance_m[0] > 0.01
