"""Configuration of a study: every arm runs with every seed, and all runs have the same budget.

The folder of a study contains `study.json` (the configuration), a run folder `cells/ARM/seed-N` for each
run, and `thresholds.json` (written once, from pilot runs). Studies can be stopped and resumed anytime.
"""

from __future__ import annotations

import re
import tomllib
from collections.abc import Mapping
from dataclasses import dataclass, field, fields, replace
from pathlib import Path
from typing import Any, NamedTuple

from caterpillar_env.errors import CaterpillarError, check_fields, show
from caterpillar_env.files import read, write_json, writing
from caterpillar_env.task import EPISODE_S
from evolution.config import RunConfig
from evolution.study.arms import Arm, EvolutionArm, make_arm

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
    pilot_seeds: tuple[int, ...] = ()  #: seeds of the reference's pilot runs, for the thresholds only
    budget_s: float = 0.0  #: simulated seconds of each run
    reference: str = "ga-uniform"  #: arm that the other arms are compared with
    generation: int = 50  #: arms with the reference's algorithm are also compared at this generation
    #: Thresholds as shares of the median final distance of the reference's pilot runs.
    threshold_shares: tuple[float, ...] = (0.5, 0.75, 1.0)
    thresholds_m: tuple[float, ...] = ()  #: thresholds in m, instead of shares and pilot runs
    #: `base` and `arms` as given to `from_dict`.
    sources: Mapping[str, Any] = field(default_factory=dict, compare=False)

    def __post_init__(self) -> None:
        check_fields(self, dict.fromkeys(("seeds", "pilot_seeds", "generation"), (0, 2**63)))
        if not self.arms:
            raise CaterpillarError("a study needs arms: add a table [arms.NAME] for each of them")
        for arm in self.arms:
            if not re.fullmatch(r"[A-Za-z0-9][A-Za-z0-9._-]{0,99}", arm):
                raise CaterpillarError(
                    "the name of an arm is used for a folder: use up to 100 letters, digits, '.', '_' "
                    f"and '-'; got {arm!r}"
                )
        if self.reference not in self.arms:
            raise CaterpillarError(
                f"reference = {self.reference!r} must be one of the arms {', '.join(self.arms)}"
            )
        for name in ("seeds", "pilot_seeds"):
            seeds = getattr(self, name)
            needed = name == "seeds" or not self.thresholds_m
            if (needed and not seeds) or len(set(seeds)) < len(seeds):
                raise CaterpillarError(
                    f"{name} must be a list of different integers from 0; got {seeds!r}"
                )
        if both := set(self.seeds) & set(self.pilot_seeds):
            raise CaterpillarError(
                f"seeds {sorted(both)} are pilot seeds too: thresholds must come from runs that are not "
                "analysed; choose other pilot_seeds"
            )
        if self.budget_s < EPISODE_S:
            raise CaterpillarError(
                f"budget_s = {self.budget_s!r} must be at least {EPISODE_S:g}, the simulated seconds of "
                "one evaluation"
            )
        for name in ("threshold_shares", "thresholds_m"):
            values, needed = getattr(self, name), name == "threshold_shares"
            if min(values, default=1.0) <= 0 or (needed and not values):
                raise CaterpillarError(f"{name} must be a list of positive numbers; got {values!r}")
        if self.thresholds_m and self.pilot_seeds:
            raise CaterpillarError(
                "thresholds_m replaces the pilot runs; remove pilot_seeds, or thresholds_m"
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
                f"a study has no {', '.join(sorted(unknown))}; its fields are base, arms, "
                f"{', '.join(known)}"
            )
        arms = {name: make_arm(name, arm, sources["base"]) for name, arm in sources["arms"].items()}
        return cls(arms, **settings, sources=sources)

    def to_dict(self) -> dict[str, Any]:
        """Return plain data for `from_dict`."""
        names = [f.name for f in fields(self) if f.name not in ("arms", "sources")]
        return {name: getattr(self, name) for name in names} | dict(self.sources)

    def cells(self) -> list[Cell]:
        """Return all runs, pilot runs first."""
        pilot = [Cell(self.reference, seed) for seed in self.pilot_seeds]
        return pilot + [Cell(arm, seed) for seed in self.seeds for arm in self.arms]

    def comparable(self) -> dict[str, RunConfig]:
        """Return the arms with the reference's algorithm, whose generations are comparable."""
        runs = {name: arm.config for name, arm in self.arms.items() if isinstance(arm, EvolutionArm)}
        base = runs.get(self.reference)
        return {
            name: run
            for name, run in runs.items()
            if base is not None and (run.optimizer, run.ga) == (base.optimizer, base.ga)
        }

    def warnings(self) -> list[str]:
        """Describe the arms that may not reach the generation at which arms are compared."""
        found = []
        for name, run in self.comparable().items():
            needed_s = EPISODE_S * replace(run, generations=self.generation + 1).evaluations()
            if needed_s > self.budget_s:
                found.append(
                    f"arms.{name}: generation {self.generation}, at which arms are compared, may not be "
                    f"completed: it takes up to {needed_s:g} simulated seconds, and budget_s = "
                    f"{self.budget_s:g}"
                )
        return found


def read_toml(path: Path) -> StudyConfig:
    """Read a study from a TOML file.

    Raises:
        CaterpillarError: the file is missing, is not TOML, or does not describe a study.
    """
    missing = "give the TOML file of a study, or --preset"
    return read(path, StudyConfig.from_dict, missing, tomllib.loads)


def preset(name: str) -> StudyConfig:
    """Read a study of this package: paper, ablation, search, worlds, pilot or rl-pilot."""
    return read_toml(Path(__file__).with_name("presets") / f"{name}.toml")


def begin(config: StudyConfig, folder: Path) -> None:
    """Write a study's configuration into its folder. The folder is created if it is missing.

    Arms and seeds can be added to an existing study. Its other settings cannot be changed.

    Raises:
        CaterpillarError: the folder contains other files, or a study with different settings.
    """
    file = folder / SETTINGS
    if file.exists():
        before = load(folder)
        names = ("budget_s", "reference", "pilot_seeds", "threshold_shares", "thresholds_m")
        changed = [name for name in names if getattr(before, name) != getattr(config, name)]
        changed += [f"arms.{a}" for a, arm in before.arms.items() if config.arms.get(a, arm) != arm]
        if changed:
            raise CaterpillarError(
                f"{folder} holds a study with other {', '.join(changed)}, whose runs are not "
                "comparable; choose another folder with --out"
            )
    with writing(folder):
        folder.mkdir(parents=True, exist_ok=True)
        if not file.exists() and any(folder.iterdir()):
            raise CaterpillarError(
                f"{folder} is not empty and holds no study; choose another with --out"
            )
        write_json(file, config.to_dict())


def load(folder: Path) -> StudyConfig:
    """Read the study of a folder.

    Raises:
        CaterpillarError: the folder contains no study, or the study cannot be read.
    """
    missing = "give a folder that caterpillar study made"
    return read(folder / SETTINGS, StudyConfig.from_dict, missing)
