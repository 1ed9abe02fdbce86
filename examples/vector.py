"""Step eight robots with different bodies and the same gait in one batch."""

import gymnasium
import numpy as np

from caterpillar_env import Failure, Morphology, wave_robot

NUM_ROBOTS = 8

rng = np.random.default_rng(0)
bodies = [Morphology.from_unit(rng.random(8)) for _ in range(NUM_ROBOTS)]
env = gymnasium.make_vec(
    "caterpillar_env:CaterpillarSMA-v0",
    num_envs=NUM_ROBOTS,
    morphology=bodies,
    terminate_on_failure=False,  # so that all episodes end together
)
env.reset(seed=0)
gait = wave_robot().timings.to_action()  # a wave designed by hand; it travels from tail to head
for _ in range(env.spec.max_episode_steps):
    *_, infos = env.step(np.tile(gait, (NUM_ROBOTS, 1)))
for body, distance_m, failure in zip(bodies, infos["distance"], infos["failure"], strict=True):
    size = f"segments of {1000 * body.segment_length_m:.1f} mm, {1000 * body.segment_mass_kg:4.1f} g"
    print(f"{size}: {1000 * distance_m:6.1f} mm, {Failure(failure)}")
env.close()
