"""Compare optimizers of several packages on the search for a crawling robot.

    pip install cmaes minionpy smac
    python -m benchmarks.optimizers --out runs/optimizers               # all optimizers, ten seeds
    python -m benchmarks.optimizers l-shade lra-cma-es --seeds 0,1      # some of them

All optimizers search waves with the priors of body and gait, and spend the same simulated time. Racing
stops two thirds of each generation early, except for optimizers that propose single genomes. Ten seeds
of one optimizer take about 20 minutes on two cores. The file `runs.csv` of the folder holds the results
of finished runs. Repeat the command to start the missing runs and print a table of all runs.
"""

from __future__ import annotations

import argparse
import sys
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import replace
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import numpy as np
import polars

from benchmarks.harness import report
from benchmarks.packages import OTHERS
from caterpillar_env.machine import cores
from evolution import GaConfig, LocalEvaluator, RunConfig, ShadeConfig, evolve, load, resume
from evolution.study.analysis import format_estimate
from evolution.study.results import Run
from evolution.study.statistics import (
    a12,
    bootstrap,
    expected_running_time,
    holm,
    mann_whitney,
    median,
)

BUDGET_S = 9000.0
THRESHOLDS_M = (0.13, 0.2)
BASE = RunConfig(
    timing="wave", prior="body+gait", race_share=0.34, budget_s=BUDGET_S, generations=100_000,
    ga=GaConfig(population=30, hall_of_fame=2), shade=ShadeConfig(15),
)  # fmt: skip

OURS = {
    "shade": replace(BASE, optimizer="shade"),
    "ga": replace(BASE, optimizer="ga"),
    "cma-es": replace(BASE, optimizer="cma-es"),
}
NAMES = (*OURS, *OTHERS)


def run(name: str, seed: int, out: Path) -> dict[str, Any]:
    """Make or continue a run, and return its row of `runs.csv`."""
    config = replace(OURS.get(name, BASE), seed=seed)
    folder = out / name / f"seed-{seed}"
    optimizer = OTHERS[name](config) if name in OTHERS else None
    if folder.exists():
        resume(folder, optimizer=optimizer, evaluator=LocalEvaluator(1))
    else:
        evolve(config, folder, optimizer=optimizer, evaluator=LocalEvaluator(1))
    made = Run.of(load(folder).table(), seed, BUDGET_S)
    times = {name_of(t): made.time_to(t) for t in THRESHOLDS_M}
    return {"optimizer": name, "seed": seed, "best_mm": 1000 * made.best_at(BUDGET_S), **times}


def name_of(threshold_m: float) -> str:
    """Return the name of the column with the time to a threshold, s (infinite if not reached)."""
    return f"s_to_{1000 * threshold_m:.0f}_mm"


def summarize(rows: polars.DataFrame, shade: polars.DataFrame) -> dict[str, Any]:
    """Return the summary of an optimizer from the rows of its runs and those of SHADE."""
    best_mm = rows["best_mm"].to_numpy()
    summary: dict[str, Any] = {"optimizer": rows["optimizer"][0], "runs": len(rows)}
    summary["median, mm"] = format_estimate(median(best_mm), "{:.0f}")
    against = a12(best_mm, shade["best_mm"].to_numpy()) if len(shade) else None
    summary["A12 against shade"] = format_estimate(against)
    summary["range, mm"] = f"{best_mm.min():.0f} to {best_mm.max():.0f}"
    for threshold_m in THRESHOLDS_M:
        time_s = rows[name_of(threshold_m)].to_numpy()
        reached = np.isfinite(time_s)
        ert = bootstrap(expected_running_time, (np.minimum(time_s, BUDGET_S), reached))
        summary[f"ERT to {1000 * threshold_m:.0f} mm, s"] = (
            f"{format_estimate(ert, '{:,.0f}')}; {reached.sum()} reached"
        )
    return summary


def main() -> None:
    """Make the missing runs, and print a table of all finished runs."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("names", nargs="*", default=NAMES, help=f"{', '.join(NAMES)}; all by default")
    parser.add_argument("--seeds", default="0,1,2,3,4,5,6,7,8,9")
    parser.add_argument("--out", type=Path, default=Path("runs/optimizers"))
    args = parser.parse_args()
    if unknown := set(args.names) - set(NAMES):
        parser.error(f"unknown optimizers: {', '.join(sorted(unknown))}; known: {', '.join(NAMES)}")
    args.out.mkdir(parents=True, exist_ok=True)
    file = args.out / "runs.csv"
    rows = polars.read_csv(file).rows(named=True) if file.exists() else []
    known = {(row["optimizer"], row["seed"]) for row in rows}
    # Seed by seed, so that an early end leaves equally many runs of each optimizer.
    wanted = [(name, int(seed)) for seed in args.seeds.split(",") for name in args.names]
    with ProcessPoolExecutor(cores(), get_context("spawn"), max_tasks_per_child=1) as pool:
        made = [pool.submit(run, *cell, args.out) for cell in wanted if cell not in known]
        failed = 0
        for finished in as_completed(made):
            if error := finished.exception():
                print(f"a run failed: {error!r}", file=sys.stderr)
                failed += 1
                continue
            rows.append(finished.result())
            polars.DataFrame(rows).sort("optimizer", "seed").write_csv(file)
    if not rows:
        sys.exit(f"all {failed} runs failed")
    table = polars.DataFrame(rows).sort("optimizer", "seed")  # the bootstrap depends on the order
    parts = {name: table.filter(optimizer=name) for name in NAMES}
    best_mm = {name: part["best_mm"].to_numpy() for name, part in parts.items() if len(part)}
    others = [name for name in best_mm if name != "shade" and "shade" in best_mm]
    p = holm({name: mann_whitney(best_mm[name], best_mm["shade"]) for name in others})
    summaries = [summarize(parts[name], parts["shade"]) for name in best_mm]
    report("optimizers", [row | {"p (Holm)": p.get(row["optimizer"], "")} for row in summaries])
    if failed:
        sys.exit(f"{failed} runs failed, so the table is not complete")


if __name__ == "__main__":
    main()
