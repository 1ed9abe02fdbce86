"""Film a robot that crawls in a wave, with Gymnasium's wrappers; needs moviepy."""

import gymnasium
import numpy as np
from gymnasium.wrappers import NormalizeObservation, RecordEpisodeStatistics

from caterpillar_env.wrappers import RecordVideo

DUTY = 0.2  # share of the gait period in which a pair of springs is powered

env = gymnasium.make("CaterpillarSMA-v0", episode_s=10.0, render_mode="rgb_array", width=320, height=180)
env = RecordVideo(env, "videos", name_prefix="wave", episode_trigger=lambda episode: True)
env = NormalizeObservation(env)  # running mean 0 and variance 1
env = RecordEpisodeStatistics(env)

gap, ventral = np.repeat(np.arange(3), 2), np.tile([0, 1], 3)  # position of each pair
on = (-gap / 3 - ventral / 2) % 1  # the tail leads; ventral springs follow after half a period
off = (on + DUTY) % 1
action = np.stack([2 * on - 1, 2 * off - 1], axis=1).ravel().astype(np.float32)  # -1 to 1
observation, info = env.reset(seed=0)
done = False
while not done:
    observation, reward, terminated, truncated, info = env.step(action)  # a gait period of 5 s
    done = terminated or truncated
env.close()
print(f"return {info['episode']['r']:.2f} in {info['episode']['l']} steps ({info['failure']})")
print("video: videos/wave-episode-0.mp4")
