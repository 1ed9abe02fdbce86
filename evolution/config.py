"""The configuration of a run."""

from __future__ import annotations

from dataclasses import asdict, dataclass, field
from functools import cached_property
from typing import Any, Literal

import numpy as np

from caterpillar_env.arrays import Array
from caterpillar_env.errors import CaterpillarError, check_fields, from_mapping
from caterpillar_env.gait import GAIT_PERIOD_S
from caterpillar_env.physics import Physics
from caterpillar_env.task import EPISODE_S
from evolution.genome import Encoding, GenomeKind, Timing
from evolution.objective import ObjectiveName
from evolution.optimizers.base import Optimizer
from evolution.optimizers.cma_es import CmaConfig, CmaEs
from evolution.optimizers.ga import GaConfig, GeneticAlgorithm
from evolution.optimizers.random_search import RandomSearch, Sampling
from evolution.optimizers.shade import DRAWS, Shade, ShadeConfig
from evolution.priors import Control, Prior, Without, design_parameters, make_priors
from evolution.priors.distributions import Clipping, Distribution, Uniform
from evolution.priors.gait import advance
from evolution.priors.preprocessor import Contradictions, GenePrior, check_floor_ratio

OptimizerName = Literal["ga", "cma-es", "shade", "random"]
PriorUse = Literal["both", "init", "mutation"]


@dataclass(frozen=True)
class RunConfig:
    """All settings that affect the result of a run.

    Raises:
        CaterpillarError: a value is out of range.
    """

    seed: int = 0  #: seed of the optimizer; --mismatch-seed is the seed of the spring-force factors
    generations: int = 50  #: number of generations
    budget_s: float | None = None  #: simulated seconds after which no new generation starts
    target_m: float | None = None  #: distance in m; stop once a robot reaches it without failing
    optimizer: OptimizerName = "ga"  #: ga: the paper's genetic algorithm; shade: differential evolution
    genome: GenomeKind = "shared"  #: full: gait genes per spring; per-segment: body genes per segment
    timing: Timing = "on-off"  #: gait genes. phase: delays and duties; wave: lag, offset and two duties
    prior: Prior = "body"  #: genes with a distribution from the preprocessor; body: as in the paper
    prior_use: PriorUse = "both"  #: where the GA uses the prior: first generation (init), mutation, both
    #: deliberately misleading prior. mirrored: peaks reflected; shuffled: distributions permuted
    prior_control: Control = "none"
    prior_without: Without = "none"  #: design parameter (K_i) to leave out of the prior
    #: prior of a gene on which two design parameters disagree. product: peak where their product peaks
    contradictions: Contradictions = "uniform"
    floor_ratio: float = 3.0  #: ratio of the maximum to the minimum density of a Gaussian prior
    clipping: Clipping = "truncated"  #: how a Gaussian is limited to the bounds of its gene
    objective: ObjectiveName = "distance"  #: quantity to maximize: m, or m per J of electrical energy
    failed_fitness: float = 0.0  #: fitness of a robot that fails, in the unit of the objective
    race_share: float = 1.0  #: share of a generation to simulate to the end; 1: all, no racing
    race_periods: int = 2  #: gait periods after which racing stops the other robots
    gait_period_s: float = GAIT_PERIOD_S  #: period of the gait, a multiple of 0.1 s
    sampling: Sampling = "independent"  #: draws of random search: independent, or evenly spread (sobol)
    ga: GaConfig = field(default_factory=GaConfig)
    cma: CmaConfig = field(default_factory=CmaConfig)
    shade: ShadeConfig = field(default_factory=ShadeConfig)
    physics: Physics = field(default_factory=Physics)

    def __post_init__(self) -> None:
        # With an extreme fitness of failed robots, sums of SHADE would overflow.
        bounds = {"seed": (0, 2**63), "generations": (1, 2**63), "failed_fitness": (-1e100, 1e100)}
        check_fields(self, bounds)
        for name in ("budget_s", "target_m"):
            value = getattr(self, name)
            if value is not None and value <= 0:
                raise CaterpillarError(f"{name} = {value!r} must be a positive number, or left out")
        if self.optimizer != "ga" and self.prior_use != "both":
            raise CaterpillarError(
                f"prior_use = {self.prior_use!r} needs the genetic algorithm; with {self.optimizer}, "
                "prior_use must be 'both'"
            )
        if self.optimizer != "random" and self.sampling != "independent":
            raise CaterpillarError(
                f"sampling = {self.sampling!r} needs random search; with {self.optimizer}, sampling "
                "must be 'independent'"
            )
        if self.prior == "uniform" and self.prior_control != "none":
            raise CaterpillarError(
                f"prior_control = {self.prior_control!r} needs another prior than 'uniform'"
            )
        check_floor_ratio(self.floor_ratio)
        if not 0 < self.race_share <= 1:
            raise CaterpillarError(f"race_share = {self.race_share} must lie in (0, 1]")
        if self.race_share < 1 and not 0 < self.race_periods * self.gait_period_s < EPISODE_S:
            raise CaterpillarError(
                f"race_periods = {self.race_periods} must be at least 1, and that many gait periods of "
                f"{self.gait_period_s:g} s must end before the episode, at {EPISODE_S:g} s"
            )
        # This checks the kind of genome, the timing, the gait period and prior_without.
        _ = design_parameters(self.encoding, self.prior, self.prior_without)

    @classmethod
    def from_dict(cls, data: dict[str, Any]) -> RunConfig:
        """Build a configuration from plain data, as returned by `to_dict`.

        Raises:
            CaterpillarError: a field is unknown or invalid.
        """
        kinds = {"ga": GaConfig, "cma": CmaConfig, "shade": ShadeConfig, "physics": Physics}
        made = data
        if isinstance(data, dict):
            made = {
                name: from_mapping(kinds[name], value, name) if name in kinds else value
                for name, value in data.items()
            }
        return from_mapping(cls, made, "a run's configuration")

    def to_dict(self) -> dict[str, Any]:
        """Return the configuration as plain data for JSON."""
        return asdict(self)

    def priors(self) -> list[GenePrior]:
        """Return the result of the preprocessor for each gene."""
        return make_priors(
            self.encoding, self.prior, floor_ratio=self.floor_ratio, clipping=self.clipping,
            contradictions=self.contradictions, control=self.prior_control,
            without=self.prior_without, seed=self.seed,
        )  # fmt: skip

    def distributions(self, use: Literal["init", "mutation"] = "init") -> list[Distribution]:
        """Return the distribution of each gene, for initialization or for mutation."""
        informed = self.prior_use in ("both", use)
        return [row.distribution if informed else Uniform() for row in self.priors()]

    @cached_property
    def encoding(self) -> Encoding:
        """The mapping from genomes to robots."""
        return Encoding(self.physics, self.gait_period_s, self.genome, self.timing)

    def make_optimizer(self) -> Optimizer:
        """Return the optimizer in its initial state."""
        rng = np.random.default_rng(self.seed)
        first = self.distributions("init")
        if self.optimizer == "ga":
            return GeneticAlgorithm(first, self.distributions("mutation"), self.ga, rng)
        circular = [gene.circular for gene in self.encoding.genes]
        if self.optimizer == "shade":
            predict = self._predict_advance if self.shade.shade_candidates > 1 else None
            return Shade(first, self.shade, rng, circular, predict)
        if self.optimizer == "cma-es":
            return CmaEs(first, self.cma, rng, circular)
        return RandomSearch(first, self.ga.population, self.sampling, rng)

    def _predict_advance(self, genomes: Array) -> Array:
        """Return the predicted advance K_5 of the robots of genomes (P, n), in m, shape (P,)."""
        bodies, timings = self.encoding.decode(genomes)
        return advance(bodies, timings, self.physics)

    def evaluations(self) -> int:
        """Return the number of genomes in all generations. CMA-ES with restarts evaluates more."""
        ga = self.ga
        if self.optimizer == "ga":
            return ga.population + (self.generations - 1) * (ga.population - ga.elites)
        if self.optimizer == "random":
            return ga.population * self.generations
        if self.optimizer == "shade":
            return self.shade.shade_population * (self.generations - 1 + DRAWS)
        default = 4 + int(3 * np.log(len(self.encoding.genes)))
        return (self.cma.cma_population or default) * self.generations

    def stop_reason(self, completed: int, simulated_s: float, farthest_m: float) -> str | None:
        """Return why the run is over, or None if another generation follows.

        Args:
            completed: number of completed generations.
            simulated_s: simulated time of all evaluations, s.
            farthest_m: largest distance of a robot that did not fail, m.
        """
        missed = ""
        if self.target_m is not None:
            target = f"the target of {1000 * self.target_m:g} mm"
            if farthest_m >= self.target_m:
                crawled = f"a robot crawled {1000 * farthest_m:.1f} mm"
                return f"{target} was reached in generation {completed - 1}, where {crawled}"
            missed = f"; {target} was not reached"
        # Rounded, because a study adds the times in another order.
        if self.budget_s is not None and round(simulated_s, 6) >= self.budget_s:
            return f"the budget of {self.budget_s:,.0f} simulated seconds is spent{missed}"
        if completed >= self.generations:
            return f"all {completed} generations are complete{missed}"
        return None

    def share_done(self, completed: int, simulated_s: float) -> float:
        """Return the completed share of the budget, or of the generations if none is set, in [0, 1]."""
        if self.budget_s is not None:
            return min(simulated_s / self.budget_s, 1.0)
        return completed / self.generations
