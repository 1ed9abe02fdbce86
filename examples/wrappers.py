"""Film a robot that switches its springs in a wave, with Gymnasium's wrappers; needs moviepy."""

import gymnasium
import numpy as np
from gymnasium.wrappers import NormalizeObservation, RecordEpisodeStatistics, RecordVideo

PERIOD_STEPS = 25  # of 0.2 s
DUTY = 0.2  # share of the period in which a spring is powered

env = gymnasium.make(
    "caterpillar_env:CaterpillarSMASwitch-v0",
    action_repeat=2,
    episode_s=10.0,
    render_mode="rgb_array",
    width=320,
    height=180,
)
env = RecordVideo(env, "videos", name_prefix="wave", episode_trigger=lambda episode: True)
env = NormalizeObservation(env)  # running mean 0 and variance 1
env = RecordEpisodeStatistics(env)

gap, ventral = np.repeat(np.arange(3), 4), np.tile([0, 0, 1, 1], 3)  # position of each spring
lead = gap / 3 + ventral / 2  # the tail leads; ventral springs follow after half a period
observation, info = env.reset(seed=0)
done, step = False, 0
while not done:
    power = (step / PERIOD_STEPS + lead) % 1 < DUTY
    observation, reward, terminated, truncated, info = env.step(power.astype(np.int8))
    done, step = terminated or truncated, step + 1
env.close()
print(f"return {info['episode']['r']:.2f} in {info['episode']['l']} steps ({info['failure']})")
print("video: videos/wave-episode-0.mp4")
