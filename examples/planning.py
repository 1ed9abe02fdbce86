"""Plan a gait by random shooting: in each period, try many actions from the current state.

A vector environment tries 32 actions at a time, each for one gait period, from the state of the robot.
The robot then takes the best of them.
"""

import gymnasium
import numpy as np

TRIALS, PERIODS = 32, 6

env = gymnasium.make("caterpillar_env:CaterpillarSMA-v0", action_mode="phase")
model = gymnasium.make_vec("caterpillar_env:CaterpillarSMA-v0", num_envs=TRIALS, action_mode="phase")
env.reset(seed=0)
model.reset(seed=0)
rng = np.random.default_rng(0)
for _ in range(PERIODS):
    state = env.unwrapped.get_state()
    model.unwrapped.set_state(state.rows([0] * TRIALS))
    delay, duty = rng.uniform(-1, 1, (TRIALS, 6)), rng.uniform(-0.8, -0.2, (TRIALS, 6))
    actions = np.stack([delay, duty], axis=2).reshape(TRIALS, -1).astype(np.float32)
    _, rewards, _, _, _ = model.step(actions)
    _, reward, _, _, info = env.step(actions[rewards.argmax()])
    print(f"{info['time_s']:4.0f} s: {1000 * info['distance']:6.1f} mm, {info['failure']}")
    assert reward == rewards.max()  # the model is exact
