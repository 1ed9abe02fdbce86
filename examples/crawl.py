"""Let an evolved robot crawl in the environment; one step is one gait period."""

import gymnasium

from caterpillar_env.validation.robots import evolved_robots

(robot,) = evolved_robots(1)  # or the best robot of a run: caterpillar_env.Robot.load("runs/NAME")
env = gymnasium.make("caterpillar_env:CaterpillarSMA-v0", morphology=robot.morphology)
observation, info = env.reset(seed=0)
action = robot.timings.to_action()
done = False
while not done:
    observation, reward, terminated, truncated, info = env.step(action)
    done = terminated or truncated
    print(f"{info['time_s']:4.0f} s  {1000 * info['distance']:6.1f} mm  {info['energy_j']:6.1f} J")
env.close()
print(f"failure: {info['failure']}; evolution recorded {1000 * (robot.fitness_m or 0):.1f} mm")
