"""Three optimizers at one budget of simulated seconds, twice each; for many seeds see docs/study.md."""

import tempfile
from pathlib import Path
from typing import get_args

from caterpillar_env import Physics
from evolution.config import OptimizerName, RunConfig
from evolution.optimizers.cma_es import CmaConfig
from evolution.optimizers.ga import GaConfig
from evolution.run.loop import evolve

SEEDS = (0, 1)
SMALL = Physics(num_segments=2)  # a gap with four springs: quick, and a poor crawler

folder = Path(tempfile.mkdtemp(prefix="caterpillar-"))
print(f"{'optimizer':10}" + "".join(f"{'seed ' + str(seed):>12}" for seed in SEEDS))
for name in get_args(OptimizerName):
    row = f"{name:10}"
    for seed in SEEDS:
        config = RunConfig(
            seed=seed,
            optimizer=name,
            budget_s=100,
            ga=GaConfig(population=5, hall_of_fame=1),
            cma=CmaConfig(cma_population=5),
            physics=SMALL,
        )
        result = evolve(config, folder / f"{name}-{seed}")
        row += f"{1000 * result.generations[-1].best_m:9.1f} mm"
    print(row)
print(f"caterpillar runs {folder} lists them all")
