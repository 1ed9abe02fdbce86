"""Let an evolved robot crawl in the environment with its own body and gait, one gait period a step."""

import gymnasium

import caterpillar_env  # noqa: F401  registers the environments
from caterpillar_env.validation.robots import evolved_robots

(robot,) = evolved_robots(1)  # for the best robot of a run: Robot.load(Path("runs/NAME"))
env = gymnasium.make("CaterpillarSMA-v0")
observation, info = env.reset(seed=0, options={"morphology": robot.morphology})
action = robot.timings.to_action()
done = False
while not done:
    observation, reward, terminated, truncated, info = env.step(action)
    done = terminated or truncated
    print(f"{info['time_s']:4.0f} s  {1000 * info['distance']:6.1f} mm  {info['energy_j']:6.1f} J")
env.close()
print(f"it ended {info['failure']}; evolution recorded {1000 * (robot.fitness_m or 0):.1f} mm")
