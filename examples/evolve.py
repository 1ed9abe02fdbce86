"""Evolve a few robots, tell of each generation, and read the best one back."""

import tempfile
from pathlib import Path

from caterpillar_env.robot import Robot
from evolution.config import RunConfig
from evolution.optimizers.ga import GaConfig
from evolution.run.loop import Generation, evolve


def tell(generation: Generation) -> None:
    """A line a generation."""
    failed = sum(generation.failures.values())
    print(f"generation {generation.number}  best {1000 * generation.best_m:5.1f} mm  failed {failed}")


config = RunConfig(seed=1, generations=3, ga=GaConfig(population=5, hall_of_fame=1))
folder = Path(tempfile.mkdtemp(prefix="caterpillar-"))
evolve(config, folder, on_generation=tell)

best = Robot.load(folder)  # best.json; the journal beside it holds everybody
for name, value in best.to_dict()["morphology"].items():
    print(f"{name:18} {value:.4f}")
print(f"again: {1000 * best.simulate().distance_m[0]:.1f} mm; film it: caterpillar replay {folder}")
