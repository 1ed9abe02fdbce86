"""Compare three optimizers with the same simulated time; for many seeds see docs/study.md."""

import tempfile
from pathlib import Path

from caterpillar_env import Physics
from evolution import CmaConfig, GaConfig, RunConfig, evolve

SEEDS = (0, 1)
SMALL = Physics(num_segments=2, timestep_s=0.005)  # quick to simulate, but a poor crawler

folder = Path(tempfile.mkdtemp(prefix="caterpillar-"))
print(f"{'optimizer':10}" + "".join(f"{'seed ' + str(seed):>12}" for seed in SEEDS))
for name in ("ga", "cma-es", "random"):
    row = f"{name:10}"
    for seed in SEEDS:
        config = RunConfig(
            seed=seed,
            optimizer=name,
            budget_s=500,
            ga=GaConfig(population=5),
            cma=CmaConfig(cma_population=5),
            physics=SMALL,
        )
        history = evolve(config, folder / f"{name}-{seed}")
        row += f"{1000 * history.generations[-1].best_m:9.1f} mm"
    print(row)
print(f"list the runs: caterpillar runs {folder}")
