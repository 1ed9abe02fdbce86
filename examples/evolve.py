"""Evolve a few robots, report each generation, and simulate the best robot again."""

import tempfile
from pathlib import Path

from evolution import GaConfig, Generation, RunConfig, evolve


def report(generation: Generation) -> None:
    """Print one line."""
    failed = sum(generation.failures.values())
    print(f"generation {generation.number}  best {1000 * generation.best_m:5.1f} mm  failed {failed}")


config = RunConfig(seed=1, generations=3, ga=GaConfig(population=5))
folder = Path(tempfile.mkdtemp(prefix="caterpillar-"))
history = evolve(config, folder, on_generation=report)  # later: evolution.load(folder)

robot = history.best_robot
if robot is None:
    raise SystemExit("no robot crawled forwards without failing")
for name, value in robot.to_dict()["morphology"].items():
    print(f"{name:18} {value:.4f}")
distance_m = float(robot.simulate().distance_m[0])
print(f"again: {1000 * distance_m:.1f} mm; film it: caterpillar replay {folder}")
