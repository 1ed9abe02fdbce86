"""Compare optimizers of several packages on the search for a crawling robot.

    pip install cmaes minionpy smac
    python -m benchmarks.optimizers --out runs/optimizers               # all optimizers, ten seeds
    python -m benchmarks.optimizers l-shade lra-cma-es --seeds 0,1      # some of them

All optimizers search waves with the priors of body and gait, and spend the same simulated time. Racing
stops two thirds of each generation early, except for optimizers that propose single genomes. Ten seeds
of one optimizer take about 20 minutes on two cores. The file `runs.csv` of the folder holds the results
of finished runs. Repeat the command to make the missing runs and print a table of all runs.
"""

from __future__ import annotations

import argparse
import queue
import sys
import tempfile
import threading
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import replace
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import numpy as np
import polars

from benchmarks.harness import report
from caterpillar_env.arrays import Array
from caterpillar_env.errors import CaterpillarError
from caterpillar_env.machine import cores
from caterpillar_env.task import EPISODE_S
from evolution import GaConfig, LocalEvaluator, RunConfig, ShadeConfig, evolve, load, resume
from evolution.optimizers.base import Optimizer
from evolution.optimizers.ga import GeneticAlgorithm
from evolution.priors.distributions import Gaussian, draw
from evolution.study.results import Run
from evolution.study.statistics import a12, bootstrap, expected_running_time, median

BUDGET_S = 9000.0
THRESHOLDS_M = (0.13, 0.2)
BASE = RunConfig(
    timing="wave", prior="body+gait", race_share=0.34, budget_s=BUDGET_S, generations=100_000,
    ga=GaConfig(population=30, hall_of_fame=2), shade=ShadeConfig(15),
)  # fmt: skip
_POPULATION = 30
_EVALUATIONS = 600  #: slightly more than fit into the budget, for optimizers that plan ahead
_PRIOR_DRAWS = 1000  #: genomes from which WS-CMA-ES learns the prior
_CREEP = 0.05  #: standard deviation of a creep mutation, as a share of the range
_CREEP_RATE = 0.2  #: probability that a gene creeps


class Asked:
    """Ask/tell interface to a minimizer that calls a cost function, genomes (P, n) -> costs (P,).

    The function runs in a thread of its own, which ends with the process.
    """

    def __init__(self, minimize: Callable[[Callable[[Any], list[float]]], Any]) -> None:
        self._genomes: queue.Queue[Array] = queue.Queue()
        self._costs: queue.Queue[list[float]] = queue.Queue()
        self._thread = threading.Thread(target=minimize, args=(self._evaluate,), daemon=True)

    def _evaluate(self, genomes: Any) -> list[float]:
        self._genomes.put(np.clip(np.atleast_2d(np.asarray(genomes, dtype=float)), 0.0, 1.0))
        return self._costs.get()

    def ask(self) -> Array:
        """Return the genomes whose costs the minimizer asks for, (P, n)."""
        if not self._thread.ident:
            self._thread.start()
        while self._thread.is_alive():
            try:
                return self._genomes.get(timeout=1.0)
            except queue.Empty:
                continue
        raise CaterpillarError("the optimizer ended before the budget was spent")

    def tell(self, genomes: Array, fitness: Array) -> None:
        """Pass the costs of these genomes to the minimizer."""
        self._costs.put((-fitness).tolist())


def start(config: RunConfig) -> tuple[Array, Array]:
    """Return the peak and the width of each gene's prior, where an evolution strategy begins."""
    shapes = config.distributions()
    peaks = [d.mu if isinstance(d, Gaussian) else 0.5 for d in shapes]
    widths = [min(d.sigma, 0.3) if isinstance(d, Gaussian) else 0.3 for d in shapes]
    return np.clip(peaks, 0.05, 0.95), np.array(widths)


class LearningRate:
    """LRA-CMA-ES of cmaes: adapts its learning rate to noisy and multimodal functions."""

    def __init__(self, config: RunConfig) -> None:
        import cmaes

        peaks, widths = start(config)
        self._strategy = cmaes.CMA(
            peaks, 1.0, np.tile([0.0, 1.0], (len(peaks), 1)), cov=np.diag(widths**2),
            seed=config.seed, lr_adapt=True,
        )  # fmt: skip

    def ask(self) -> Array:
        """Return the genomes of a generation, (P, n)."""
        return np.array([self._strategy.ask() for _ in range(self._strategy.population_size)])

    def tell(self, genomes: Array, fitness: Array) -> None:
        """Receive their fitness, (P,)."""
        self._strategy.tell([(g, -f) for g, f in zip(genomes, fitness.tolist(), strict=True)])


class Creep(GeneticAlgorithm):
    """Genetic algorithm whose mutation moves a gene by a small step instead of redrawing it."""

    def __init__(self, config: RunConfig) -> None:
        rng, shapes = np.random.default_rng(config.seed), config.distributions()
        super().__init__(shapes, shapes, replace(config.ga, mutation_rate=0.0), rng)
        self._circular = [gene.circular for gene in config.encoding.genes]

    def _breed(self, count: int) -> Array:
        children = super()._breed(count)
        crept = children + _CREEP * self._rng.standard_normal(children.shape)
        crept = np.where(self._circular, crept % 1.0, np.clip(crept, 0.0, 1.0))
        return np.where(self._rng.random(children.shape) < _CREEP_RATE, crept, children)


class Centred:
    """Base class of optimizers whose circular genes are shifted so that the priors peak at 0.5."""

    def __init__(self, config: RunConfig) -> None:
        rows = zip(config.distributions(), config.encoding.genes, strict=True)
        peaks = [d.mu if gene.circular and isinstance(d, Gaussian) else 0.5 for d, gene in rows]
        self._shift = np.array(peaks) - 0.5

    def _from_genes(self, genomes: Array) -> Array:
        return np.where(self._shift == 0.0, genomes, (genomes - self._shift) % 1.0)

    def _to_genes(self, points: Array) -> Array:
        shifted = (points + self._shift) % 1.0
        return np.where(self._shift == 0.0, np.clip(points, 0.0, 1.0), shifted)


class WarmStart(Centred):
    """WS-CMA-ES of cmaes (Nomura et al. 2021): begins with a Gaussian fitted to the prior."""

    def __init__(self, config: RunConfig) -> None:
        import cmaes

        super().__init__(config)
        shapes = config.distributions()
        genomes = draw(shapes, np.random.default_rng(config.seed), _PRIOR_DRAWS)
        density = np.prod([d.density(x) for d, x in zip(shapes, genomes.T, strict=True)], axis=0)
        known = list(zip(self._from_genes(genomes), (-density).tolist(), strict=True))
        mean, sigma, covariance = cmaes.get_warm_start_mgd(known)
        self._strategy = cmaes.CMA(
            mean, sigma, np.tile([0.0, 1.0], (len(mean), 1)), cov=covariance, seed=config.seed
        )
        self._asked: list[Array] = []

    def ask(self) -> Array:
        """Return the genomes of a generation, (P, n)."""
        self._asked = [self._strategy.ask() for _ in range(self._strategy.population_size)]
        return self._to_genes(np.array(self._asked))

    def tell(self, genomes: Array, fitness: Array) -> None:
        """Receive their fitness, (P,)."""
        self._strategy.tell([(p, -f) for p, f in zip(self._asked, fitness.tolist(), strict=True)])


class PiBO(Centred):
    """piBO of SMAC (Hvarfner et al. 2022): Bayesian optimization that weights genomes by their prior.

    It simulates one robot at a time, to the end. The weight of the prior decays with the number of
    robots.
    """

    def __init__(self, config: RunConfig) -> None:
        import ConfigSpace
        import smac
        from smac.acquisition.function import EI, PriorAcquisitionFunction

        super().__init__(config)
        space = ConfigSpace.ConfigurationSpace(seed=config.seed)
        self._names = [f"gene{number:03d}" for number in range(len(self._shift))]
        rows = zip(self._names, config.distributions(), self._shift, strict=True)
        for name, shape, shift in rows:
            if isinstance(shape, Gaussian):
                space.add(
                    ConfigSpace.NormalFloatHyperparameter(
                        name, mu=shape.mu - shift, sigma=shape.sigma, lower=0.0, upper=1.0
                    )
                )
            else:
                space.add(ConfigSpace.UniformFloatHyperparameter(name, 0.0, 1.0))
        trials = round(BUDGET_S / EPISODE_S)
        self._folder = tempfile.TemporaryDirectory()
        scenario = smac.Scenario(
            space, output_directory=Path(self._folder.name), seed=config.seed, deterministic=True,
            n_trials=_EVALUATIONS,
        )  # fmt: skip
        facade = smac.HyperparameterOptimizationFacade
        self._smac = facade(
            scenario, lambda config, seed: 0.0, logging_level=False,
            acquisition_function=PriorAcquisitionFunction(EI(log=True), decay_beta=trials / 10),
            initial_design=smac.initial_design.RandomInitialDesign(scenario, n_configs=_POPULATION),
        )  # fmt: skip
        self._trial: Any = None

    def ask(self) -> Array:
        """Return the next genome, (1, n)."""
        self._trial = self._smac.ask()
        point = np.array([[self._trial.config[name] for name in self._names]])
        return self._to_genes(point)

    def tell(self, genomes: Array, fitness: Array) -> None:
        """Receive its fitness, (1,)."""
        from smac.runhistory.dataclasses import TrialValue

        self._smac.tell(self._trial, TrialValue(cost=-float(fitness[0])), save=False)


def lq_surrogate(config: RunConfig) -> Asked:
    """Return lq-CMA-ES of pycma, with a linear-quadratic surrogate and restarts."""
    import cma

    peaks, widths = start(config)
    options = {
        "bounds": [0.0, 1.0], "CMA_stds": widths / 0.3, "seed": config.seed + 1, "verbose": -9,
        "verb_log": 0,
    }  # fmt: skip
    return Asked(
        lambda function: cma.fmin_lq_surr2(lambda x: function([x])[0], peaks, 0.3, options, restarts=100)
    )


def from_minion(name: str, config: RunConfig, first: Array, options: dict[str, Any]) -> Asked:
    """Return an optimizer of minionpy that begins with the genomes `first`, (P, n)."""
    import minionpy

    def minimize(function: Callable[[Any], list[float]]) -> None:
        bounds = [(0.0, 1.0)] * first.shape[1]
        maker = getattr(minionpy, name)
        maker(
            function, bounds, first.tolist(), maxevals=_EVALUATIONS, seed=config.seed, options=options
        ).optimize()

    return Asked(minimize)


def l_shade(config: RunConfig) -> Asked:
    """Return L-SHADE of minionpy: SHADE with a population that shrinks."""
    rng = np.random.default_rng(config.seed)
    first = draw(config.distributions(), rng, _POPULATION)
    return from_minion("LSHADE", config, first, {"population_size": _POPULATION})


def bipop(config: RunConfig) -> Asked:
    """Return BIPOP-aCMA-ES of minionpy: restarts with large and small populations."""
    return from_minion("BIPOP_aCMAES", config, start(config)[0][None], {"rel_initial_step": 0.15})


OURS = {
    "shade": replace(BASE, optimizer="shade"),
    "ga": replace(BASE, optimizer="ga"),
    "cma-es": replace(BASE, optimizer="cma-es"),
}
OTHERS: dict[str, Callable[[RunConfig], Optimizer]] = {
    "ga-creep": Creep,
    "bipop-cma-es": bipop,
    "lra-cma-es": LearningRate,
    "lq-cma-es": lq_surrogate,
    "l-shade": l_shade,
    "ws-cma-es": WarmStart,
    "pibo": PiBO,
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
    return {"optimizer": name, "seed": seed, "best_mm": 1000 * made.best_m[-1], **times}


def name_of(threshold_m: float) -> str:
    """Return the name of the column with the time to a threshold, s (infinite if not reached)."""
    return f"s_to_{1000 * threshold_m:.0f}_mm"


def summarize(rows: polars.DataFrame, shade: polars.DataFrame) -> dict[str, Any]:
    """Return the summary of an optimizer from the rows of its runs and those of SHADE."""
    best_mm = rows["best_mm"].to_numpy()
    summary: dict[str, Any] = {"optimizer": rows["optimizer"][0], "runs": len(rows)}
    estimates = {"median, mm": (median(best_mm), ".0f")}
    estimates["A12 against shade"] = (a12(best_mm, shade["best_mm"].to_numpy()), ".2f")
    for name, ((value, low, high), form) in estimates.items():
        summary[name] = f"{value:{form}} ({low:{form}} to {high:{form}})"
    summary["range, mm"] = f"{best_mm.min():.0f} to {best_mm.max():.0f}"
    for threshold_m in THRESHOLDS_M:
        time_s = rows[name_of(threshold_m)].to_numpy()
        reached = np.isfinite(time_s)
        ert = bootstrap(expected_running_time, (np.minimum(time_s, BUDGET_S), reached))
        interval = f" ({ert.low:,.0f} to {ert.high:,.0f})" if reached.any() else ""
        summary[f"ERT to {1000 * threshold_m:.0f} mm, s"] = (
            f"{ert.value:,.0f}{interval}; {reached.sum()} reached"
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
        for finished in as_completed(made):
            if error := finished.exception():
                print(f"a run failed: {error!r}", file=sys.stderr)
                continue
            rows.append(finished.result())
            polars.DataFrame(rows).sort("optimizer", "seed").write_csv(file)
    table = polars.DataFrame(rows).sort("optimizer", "seed")  # on whose order the bootstrap depends
    parts = [table.filter(optimizer=name) for name in NAMES]
    report("optimizers", [summarize(part, parts[0]) for part in parts if len(part)])


if __name__ == "__main__":
    main()
