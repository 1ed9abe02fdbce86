"""Film a robot that crawls in a wave, with Gymnasium's wrappers; needs moviepy."""

import gymnasium
from gymnasium.wrappers import NormalizeObservation, RecordEpisodeStatistics

from caterpillar_env import wave_robot
from caterpillar_env.wrappers import RecordVideo

env = gymnasium.make("CaterpillarSMA-v0", episode_s=10.0, render_mode="rgb_array", width=320, height=180)
env = RecordVideo(env, "videos", name_prefix="wave", episode_trigger=lambda episode: True)
env = NormalizeObservation(env)  # running mean 0 and variance 1
env = RecordEpisodeStatistics(env)

action = wave_robot().timings.to_action()  # on and off time of each pair, -1 to 1
observation, info = env.reset(seed=0)
done = False
while not done:
    observation, reward, terminated, truncated, info = env.step(action)  # a gait period of 5 s
    done = terminated or truncated
env.close()
print(f"return {info['episode']['r']:.2f} in {info['episode']['l']} steps ({info['failure']})")
print("video: videos/wave-episode-0.mp4")
