"""Compare three optimizers with the same simulated time; for many seeds see docs/study.md."""

import tempfile
from pathlib import Path

import polars

from caterpillar_env import Physics
from evolution import CmaConfig, GaConfig, RunConfig, evolve

SEEDS, BUDGET_S = (0, 1), 500  # a run ends with its generation, and may exceed the budget
SMALL = Physics(num_segments=2, timestep_s=0.005)  # quick to simulate, but a poor crawler

folder = Path(tempfile.mkdtemp(prefix="caterpillar-"))
print(f"{'optimizer':10}" + "".join(f"{'seed ' + str(seed):>12}" for seed in SEEDS))
for name in ("ga", "cma-es", "random"):
    row = f"{name:10}"
    for seed in SEEDS:
        config = RunConfig(
            seed=seed,
            optimizer=name,
            budget_s=BUDGET_S,
            ga=GaConfig(population=5),
            cma=CmaConfig(cma_population=5),
            physics=SMALL,
        )
        table = evolve(config, folder / f"{name}-{seed}").table()
        within = table.filter(polars.col("simulated_s").cum_sum() <= BUDGET_S, failure="ok")
        row += f"{1000 * within['distance_m'].max():9.1f} mm"
    print(row)
print(f"list the runs: caterpillar runs {folder}")
