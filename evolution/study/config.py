"""Configuration of a study: every arm runs with every seed, and all arms have the same budget.

The folder of a study contains `study.json` (the configuration), `evaluations.parquet` (all results) and
a run folder `cells/ARM/seed-N` for each run. Studies can be stopped and resumed anytime.
"""

from __future__ import annotations

import re
import tomllib
from collections.abc import Mapping
from dataclasses import dataclass, field, fields, replace
from pathlib import Path
from typing import Any, NamedTuple

from caterpillar_env.errors import CaterpillarError, check_fields, show
from caterpillar_env.files import read, with_digest, write_json, writing
from caterpillar_env.task import EPISODE_S
from evolution.config import RunConfig
from evolution.run.database import lock
from evolution.study.arms import Arm, EvolutionArm, make_arm

NO_LOCKS = "Choose a folder on a file system with locks, with --out"  #: advice in errors of locks
SETTINGS = "study.json"  #: name of the file with a study's configuration


class Cell(NamedTuple):
    """One run of a study."""

    arm: str
    seed: int

    def folder(self, study: Path) -> Path:
        """Return the run folder."""
        return study / "cells" / self.arm / f"seed-{self.seed}"

    def __str__(self) -> str:
        return f"{self.arm} seed {self.seed}"


@dataclass(frozen=True)
class StudyConfig:
    """Configuration of a study.

    Raises:
        CaterpillarError: a value is out of range, a seed is repeated, or the reference is not an arm.
    """

    arms: Mapping[str, Arm]
    seeds: tuple[int, ...] = ()
    budget_s: float = 0.0  #: simulated seconds of each run
    long_seeds: tuple[int, ...] = ()  #: seeds for which the reference runs until `long_budget_s`
    long_budget_s: float = 0.0  #: simulated seconds of the reference's longer runs
    reference: str = "ga-uniform"  #: arm that the other arms are compared with
    references: Mapping[str, str] = field(default_factory=dict)  #: by arm, if different from `reference`
    #: Numbers of generations after which arms are compared. Only arms with the same optimizer, optimizer
    #: settings (except the mutation rate) and racing as `reference` take part.
    generations: tuple[int, ...] = (50,)
    #: Thresholds in m. By default, the reference's median distance after each of `generations`.
    thresholds_m: tuple[float, ...] = ()
    compare_at_s: tuple[float, ...] = ()  #: simulated seconds at which distances are compared, too
    #: `base` and `arms` as given to `from_dict`.
    sources: Mapping[str, Any] = field(default_factory=dict, compare=False)

    def __post_init__(self) -> None:
        check_fields(self, {"seeds": (0, 2**63), "long_seeds": (0, 2**63), "generations": (1, 2**63)})
        if not self.arms:
            raise CaterpillarError("a study needs arms: add a table [arms.NAME] for each arm")
        for arm in self.arms:
            if not re.fullmatch(r"[A-Za-z0-9][A-Za-z0-9._-]{0,99}", arm):
                raise CaterpillarError(
                    "the name of an arm is used for a folder: use up to 100 letters, digits, '.', '_' "
                    f"and '-', and begin with a letter or a digit; got {arm!r}"
                )
        if self.reference not in self.arms:
            raise CaterpillarError(
                f"reference = {self.reference!r} must be one of the arms {', '.join(self.arms)}"
            )
        self._check_references()
        for name in ("seeds", "generations"):
            values = getattr(self, name)
            if not values or len(set(values)) < len(values):
                first = "0" if name == "seeds" else "1"
                raise CaterpillarError(
                    f"{name} must be a list of one or more distinct integers >= {first}; got {values!r}"
                )
        if self.budget_s < EPISODE_S:
            raise CaterpillarError(
                f"budget_s = {self.budget_s!r} must be at least {EPISODE_S:g}, the simulated seconds of "
                "one evaluation"
            )
        if self.long_seeds and self.long_budget_s < self.budget_s:
            raise CaterpillarError(
                f"long_budget_s = {self.long_budget_s!r} must be at least budget_s = {self.budget_s:g}"
            )
        if self.long_seeds and not isinstance(self.arms[self.reference], EvolutionArm):
            raise CaterpillarError(
                f"long_seeds needs a reference of the kind evolution, and {self.reference} is of "
                "another kind; choose another reference, or remove long_seeds"
            )
        times_s = self.compare_at_s
        if len(set(times_s)) < len(times_s) or not all(0 < time_s < self.budget_s for time_s in times_s):
            raise CaterpillarError(
                f"compare_at_s must be a list of distinct numbers between 0 and budget_s = "
                f"{self.budget_s:g}; got {times_s!r}"
            )
        if min(self.thresholds_m, default=1.0) <= 0:
            raise CaterpillarError(
                f"thresholds_m must be a list of positive numbers; got {self.thresholds_m!r}"
            )

    def _check_references(self) -> None:
        for arm, reference in self.references.items():
            for name in (arm, reference):
                if not isinstance(name, str) or name not in self.arms:
                    raise CaterpillarError(
                        f"references: {show(name)} must be one of the arms {', '.join(self.arms)}"
                    )

    @classmethod
    def from_dict(cls, data: Mapping[str, Any]) -> StudyConfig:
        """Make a study from plain data, as in a TOML file. `base` has the settings shared by all arms.

        Raises:
            CaterpillarError: a field is missing, unknown or invalid.
        """
        if not isinstance(data, Mapping):
            raise CaterpillarError(f"a study must be a table; got {show(data)}")
        settings = dict(data)
        sources = {name: settings.pop(name, {}) for name in ("base", "arms")}
        for name, table in sources.items():
            if not isinstance(table, Mapping):
                raise CaterpillarError(f"{name} must be a table; got {show(table)}")
        known = [f.name for f in fields(cls) if f.name not in ("arms", "sources")]
        if unknown := set(settings) - set(known):
            raise CaterpillarError(
                f"a study has no {', '.join(sorted(map(str, unknown)))}; its fields are base, arms, "
                f"{', '.join(known)}"
            )
        arms = {name: make_arm(name, arm, sources["base"]) for name, arm in sources["arms"].items()}
        return cls(arms, **settings, sources=sources)

    def to_dict(self) -> dict[str, Any]:
        """Return plain data for `from_dict`."""
        names = [f.name for f in fields(self) if f.name not in ("arms", "sources")]
        return {name: getattr(self, name) for name in names} | dict(self.sources)

    def cells(self) -> list[Cell]:
        """Return all runs, seed by seed, so that the first seeds of all arms finish first."""
        return [Cell(arm, seed) for seed in self.seeds for arm in self.arms]

    def budget_of(self, cell: Cell) -> float:
        """Return the budget of a run, simulated seconds."""
        is_long = cell.arm == self.reference and cell.seed in self.long_seeds
        return self.long_budget_s if is_long else self.budget_s

    def reference_of(self, arm: str) -> str:
        """Return the reference of an arm: its entry in `references` or, without one, `reference`.

        An arm that has no entry but is the reference of another arm is its own reference.
        """
        return self.references.get(arm, arm if arm in self.references.values() else self.reference)

    def comparable(self) -> list[str]:
        """Return the arms with the algorithm of `reference`, whose generations are comparable."""
        runs = {name: arm.config for name, arm in self.arms.items() if isinstance(arm, EvolutionArm)}
        base = runs.get(self.reference)
        return [
            name
            for name, run in runs.items()
            if base is not None and _algorithm(run) == _algorithm(base)
        ]

    def comparisons(self) -> int:
        """Return the number of arms that are compared with a reference."""
        return sum(self.reference_of(arm) != arm for arm in self.arms)

    def warnings(self) -> list[str]:
        """Describe the arms that may not reach the generations at which arms are compared."""
        found = []
        for name in self.comparable():
            arm = self.arms[name]
            assert isinstance(arm, EvolutionArm)
            is_longer = name == self.reference and self.long_seeds
            budget_s = self.long_budget_s if is_longer else self.budget_s
            count = min(self.generations) if self.long_seeds and not is_longer else max(self.generations)
            needed_s = EPISODE_S * replace(arm.config, generations=count).evaluations()
            if needed_s > budget_s:
                found.append(
                    f"arms.{name}: {count} generations, after which arms are compared, may not be "
                    f"completed: they take up to {needed_s:g} simulated seconds, and the budget is "
                    f"{budget_s:g}"
                )
        return found


def _algorithm(run: RunConfig) -> tuple[Any, ...]:
    """Return the settings that arms with comparable generations share. Mutation rates may differ."""
    ga = replace(run.ga, mutation_rate=0.0)
    return run.optimizer, ga, run.cma, run.shade, run.race_share, run.race_periods


def read_toml(path: Path) -> StudyConfig:
    """Read a study from a TOML file.

    Raises:
        CaterpillarError: the file is missing, is not TOML, or does not describe a study.
    """
    missing = "give the TOML file of a study, or --preset"
    return read(path, StudyConfig.from_dict, missing, tomllib.loads)


def preset(name: str) -> StudyConfig:
    """Read one of the package's preset studies, for example paper or ablation."""
    return read_toml(Path(__file__).with_name("presets") / f"{name}.toml")


def begin(config: StudyConfig, folder: Path) -> None:
    """Write a study's configuration into its folder. The folder is created if it is missing.

    Arms, seeds, longer runs and `compare_at_s` can be added to an existing study. Its budget and its
    references cannot be changed, and its arms can be neither changed nor removed.

    Raises:
        CaterpillarError: the folder contains other files, or a study with different settings, or another
            process is running this study.
    """
    file = folder / SETTINGS
    if file.exists():
        before = load(folder)
        names = ("budget_s", "reference", "generations", "thresholds_m")
        changed = [name for name in names if getattr(before, name) != getattr(config, name)]
        changed += [
            f"references.{arm}"
            for arm in before.arms
            if arm in config.arms and config.reference_of(arm) != before.reference_of(arm)
        ]
        changed += [f"arms.{a}" for a, arm in before.arms.items() if config.arms.get(a, arm) != arm]
        if lost := before.arms.keys() - config.arms.keys():
            raise CaterpillarError(
                f"{folder} holds a study with more arms: add arms.{', arms.'.join(sorted(lost))} again, "
                "or choose another folder with --out"
            )
        if changed:
            raise CaterpillarError(
                f"{folder} holds a study that differs in {', '.join(changed)}, so its runs are not "
                "comparable; choose another folder with --out"
            )
    with writing(folder):
        folder.mkdir(parents=True, exist_ok=True)
        if not file.exists() and any(path.name[0] != "." for path in folder.iterdir()):
            raise CaterpillarError(
                f"{folder} is not empty and contains no study; choose another folder with --out"
            )
        with lock(folder, NO_LOCKS):  # so that a running study does not change
            write_json(file, with_digest(config.to_dict()))


def load(folder: Path) -> StudyConfig:
    """Read the configuration of the study in a folder.

    Raises:
        CaterpillarError: the folder contains no study, or the study cannot be read.
    """
    missing = "give a folder that caterpillar study made"
    return read(folder / SETTINGS, StudyConfig.from_dict, missing)
