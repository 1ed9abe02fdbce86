"""What a run is asked to compute: every setting, and the optimizer and the distributions that follow."""

from __future__ import annotations

from dataclasses import asdict, dataclass, field
from typing import Any, Literal

import numpy as np

from caterpillar_env.errors import CaterpillarError, check_choice, from_mapping
from caterpillar_env.gait import GAIT_PERIOD_S
from caterpillar_env.physics import Physics
from evolution.genome import Encoding, GenomeKind
from evolution.optimizers.base import Optimizer
from evolution.optimizers.cma_es import CmaConfig, CmaEs
from evolution.optimizers.ga import GaConfig, GeneticAlgorithm
from evolution.optimizers.random_search import RandomSearch, Sampling
from evolution.priors.distributions import Clipping, Distribution, Uniform
from evolution.priors.preprocessor import paper_priors
from evolution.run.objective import ObjectiveName

OptimizerName = Literal["ga", "cma-es", "random"]
Prior = Literal["preprocessed", "uniform", "init-only", "mutation-only", "mirrored"]

#: What optimizers and priors are, in words.
OPTIMIZERS: dict[OptimizerName, str] = {
    "ga": "the genetic algorithm", "cma-es": "CMA-ES", "random": "random search",
}  # fmt: skip
PRIORS: dict[Prior, str] = {
    "preprocessed": "the preprocessor's distributions",
    "uniform": "uniform distributions",
    "init-only": "the preprocessor's distributions at first, uniform ones in mutation",
    "mutation-only": "uniform distributions at first, the preprocessor's in mutation",
    "mirrored": "the preprocessor's distributions with every peak at the wrong end",
}


class ConfigError(CaterpillarError):
    """A run's configuration has a field that is unknown or out of range."""


@dataclass(frozen=True)
class RunConfig:
    """Everything that decides what a run computes; threads and folders do not.

    Raises:
        ConfigError: a value is out of range.
    """

    seed: int = 0  #: of all that the optimizer draws; the springs have --mismatch-seed
    generations: int = 50  #: how often the optimizer asks for genomes
    budget_s: float | None = None  #: simulated seconds; once spent, no generation begins
    target_m: float | None = None  #: m; once a healthy robot gets that far, no generation begins
    optimizer: OptimizerName = "ga"  #: ga: the paper's genetic algorithm; random: random search
    genome: GenomeKind = "shared"  #: full: times of every spring; per-segment: a body for every segment
    prior: Prior = "preprocessed"  #: what genes are drawn from; init- and mutation-only are the GA's
    floor_ratio: float = 3.0  #: greatest over least density of a preprocessed gene
    clipping: Clipping = "truncated"  #: what becomes of a Gaussian beyond the bounds of its gene
    objective: ObjectiveName = "distance"  #: what is maximised: m, or m per J of electrical energy
    failed_fitness: float = 0.0  #: of a robot that fails, in the unit of the objective
    gait_period_s: float = GAIT_PERIOD_S  #: a whole multiple of 0.1; on and off times end with it
    sampling: Sampling = "independent"  #: how random search draws: one by one, or evenly spread
    ga: GaConfig = field(default_factory=GaConfig)
    cma: CmaConfig = field(default_factory=CmaConfig)
    physics: Physics = field(default_factory=Physics)

    def __post_init__(self) -> None:
        if self.seed < 0:
            raise ConfigError(f"seed = {self.seed} must not be negative")
        if self.generations < 1:
            raise ConfigError(f"generations = {self.generations} must be at least 1")
        for name, what in _LIMITS.items():
            value = getattr(self, name)
            number = isinstance(value, (int, float)) and not isinstance(value, bool)
            if value is not None and not (number and 0 < value < np.inf):
                raise ConfigError(f"{name} = {value!r} must be {what}; leave it out to run without it")
        for name, kind in _CHOICES.items():
            check_choice(name, getattr(self, name), kind, ConfigError)
        if self.optimizer != "ga" and self.prior in ("init-only", "mutation-only"):
            raise ConfigError(
                f"prior = {self.prior!r} is for the genetic algorithm alone; with "
                f"{self.optimizer} choose preprocessed, uniform or mirrored"
            )
        if not np.isfinite(self.failed_fitness):
            raise ConfigError(f"failed_fitness = {self.failed_fitness} must be a finite number")
        self.distributions()

    @classmethod
    def from_dict(cls, data: dict[str, Any]) -> RunConfig:
        """The configuration in plain JSON, as `to_dict` gives it.

        Raises:
            ConfigError: a field is unknown or unusable.
        """
        kinds = {"ga": GaConfig, "cma": CmaConfig, "physics": Physics}
        made = {
            name: from_mapping(kinds[name], value, name, ConfigError) if name in kinds else value
            for name, value in data.items()
        }
        return from_mapping(cls, made, "a run's configuration", ConfigError)

    def to_dict(self) -> dict[str, Any]:
        """Plain JSON."""
        return asdict(self)

    def distributions(self, use: Literal["init", "mutation"] = "init") -> list[Distribution]:
        """What each gene is drawn from, at first or by mutation."""
        rows = paper_priors(
            self.encoding, self.floor_ratio, self.clipping, mirrored=self.prior == "mirrored"
        )
        informed = self.prior in ("preprocessed", "mirrored", f"{use}-only")
        return [row.distribution if informed else Uniform() for row in rows]

    @property
    def encoding(self) -> Encoding:
        """What a genome stands for."""
        return Encoding(self.physics, self.gait_period_s, self.genome)

    def make_optimizer(self) -> Optimizer:
        """The optimizer at its beginning."""
        rng = np.random.default_rng(self.seed)
        first = self.distributions("init")
        if self.optimizer == "ga":
            return GeneticAlgorithm(first, self.distributions("mutation"), self.ga, rng)
        if self.optimizer == "cma-es":
            return CmaEs(first, self.cma, rng)
        return RandomSearch(first, self.ga.population, self.sampling, rng)

    def evaluations(self) -> int:
        """How many genomes the whole run evaluates; without restarts, in the case of CMA-ES."""
        ga = self.ga
        if self.optimizer == "ga":
            return ga.population + (self.generations - 1) * (ga.population - ga.elites)
        if self.optimizer == "random":
            return ga.population * self.generations
        default = 4 + int(3 * np.log(len(self.encoding.genes)))
        return (self.cma.cma_population or default) * self.generations

    def ending(self, generations: int, simulated_s: float, farthest_m: float) -> str | None:
        """Why a run that is so far is over, in words; None if another generation follows.

        Args:
            generations: how many are through.
            simulated_s: simulated time of all evaluations.
            farthest_m: greatest distance of a robot that did not fail, whatever the objective.
        """
        missed = ""
        if self.target_m is not None:
            target = f"the target of {1000 * self.target_m:g} mm"
            if farthest_m >= self.target_m:
                crawled = f"a robot crawled {1000 * farthest_m:.1f} mm"
                return f"{target} was reached in generation {generations - 1}, where {crawled}"
            missed = f"; {target} was not reached"
        if self.budget_s is not None and simulated_s >= self.budget_s:
            return f"the budget of {self.budget_s:,.0f} simulated seconds is spent{missed}"
        if generations >= self.generations:
            return f"the last generation is through{missed}"
        return None

    def share_done(self, evaluations: int, simulated_s: float) -> float:
        """How much of the run is behind it, in [0, 1]; of a budget, what is spent."""
        if self.budget_s is not None:
            return min(simulated_s / self.budget_s, 1.0)
        return min(evaluations / self.evaluations(), 1.0)


#: What ends a run before its last generation, where it is given.
_LIMITS = {
    "budget_s": "a positive number of simulated seconds",
    "target_m": "a positive distance in m",
}
_CHOICES = {
    "optimizer": OptimizerName,
    "genome": GenomeKind,
    "prior": Prior,
    "clipping": Clipping,
    "objective": ObjectiveName,
    "sampling": Sampling,
}
