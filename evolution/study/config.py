"""A study: arms times seeds, each cell a run of its own, all with one budget of simulated seconds.

A study is a folder that can be left and gone on with at any point: `study.json` (what is asked),
`cells/ARM/seed-N` (a run folder each), `thresholds.json` (frozen once, from seeds of their own).
"""

from __future__ import annotations

import re
import tomllib
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from caterpillar_env.errors import CaterpillarError
from caterpillar_env.files import read, write_json, writing
from caterpillar_env.task import EPISODE_S
from evolution.study import arms as kinds
from evolution.study.arms import Arm

SETTINGS = "study.json"  #: what is asked


class StudyError(CaterpillarError):
    """A study is not described or not used as it must be."""


class Cell(NamedTuple):
    """One run of a study."""

    arm: str
    seed: int

    def folder(self, study: Path) -> Path:
        """Its run folder."""
        return study / "cells" / self.arm / f"seed-{self.seed}"


@dataclass(frozen=True)
class StudyConfig:
    """What a study asks.

    Raises:
        StudyError: seeds are missing or serve twice, the reference is no arm, or a value is unusable.
    """

    arms: Mapping[str, Arm]
    seeds: tuple[int, ...]
    pilot_seeds: tuple[int, ...]  #: of the reference arm alone; thresholds come from them, nothing else
    budget_s: float  #: simulated seconds of each cell
    reference: str = "ga-uniform"  #: the arm that the others are compared with
    generation: int = 50  #: at which arms of the genetic algorithm are compared as well
    threshold_shares: tuple[float, ...] = (0.5, 0.75, 1.0)  #: of the reference's median final distance
    sources: Mapping[str, Any] = field(default_factory=dict, compare=False)

    def __post_init__(self) -> None:
        if not self.arms:
            raise StudyError("a study needs arms: give each a table [arms.NAME] with its settings")
        for name in ("seeds", "pilot_seeds"):
            seeds = getattr(self, name)
            whole = all(isinstance(s, int) and s >= 0 for s in seeds)
            if not seeds or not whole or len(set(seeds)) < len(seeds):
                raise StudyError(
                    f"{name} must be different whole numbers from 0, at least one; got {list(seeds)}"
                )
        if both := set(self.seeds) & set(self.pilot_seeds):
            raise StudyError(
                f"seeds {sorted(both)} are pilot seeds too: thresholds must come from runs that the "
                "analysis does not see"
            )
        if self.reference not in self.arms:
            raise StudyError(
                f"reference = {self.reference!r} is no arm; arms are {', '.join(self.arms)}"
            )
        number = isinstance(self.budget_s, (int, float))
        if not number or not EPISODE_S <= self.budget_s < np.inf:
            raise StudyError(
                f"budget_s = {self.budget_s!r} must be at least {EPISODE_S:g}, the simulated seconds of "
                "one evaluation"
            )
        if not isinstance(self.generation, int) or self.generation < 0:
            raise StudyError(f"generation = {self.generation!r} must be a whole number from 0")
        for arm in self.arms:
            if not re.fullmatch(r"[A-Za-z0-9][A-Za-z0-9._-]*", arm):
                raise StudyError(
                    f"an arm's name is a folder's too: letters, digits, '.', '_' and '-'; got {arm!r}"
                )
        shares = self.threshold_shares
        if not shares or not all(0 < s < np.inf for s in shares):
            raise StudyError(f"threshold_shares must be positive numbers; got {list(shares)}")

    @classmethod
    def from_dict(cls, data: Mapping[str, Any]) -> StudyConfig:
        """The study of plain data, as in a TOML file: `base` holds what all arms have in common.

        Raises:
            CaterpillarError: an unknown field, or an unusable value.
        """
        fields = {**data}
        base, arms = fields.pop("base", {}), fields.pop("arms", {})
        known = {"seeds", "pilot_seeds", "budget_s", "reference", "generation", "threshold_shares"}
        if unknown := set(fields) - known:
            raise StudyError(
                f"a study has no {', '.join(sorted(unknown))}; it has base, arms, "
                f"{', '.join(sorted(known))}"
            )
        if missing := {"seeds", "pilot_seeds", "budget_s"} - set(fields):
            raise StudyError(f"a study needs {', '.join(sorted(missing))}")
        for name in ("seeds", "pilot_seeds", "threshold_shares"):
            if name in fields:
                if not isinstance(fields[name], (list, tuple)):
                    raise StudyError(f"{name} must be a list; got {fields[name]!r}")
                fields[name] = tuple(fields[name])
        for name, table in (("base", base), ("arms", arms)):
            if not isinstance(table, Mapping):
                raise StudyError(f"{name} must be a table; got {table!r}")
        made = {}
        for name, special in arms.items():
            if not isinstance(special, Mapping):
                raise StudyError(f"arms.{name} must be a table of an arm's settings; got {special!r}")
            if taken := (set(special) | set(base)) & {"seed", "generations", "budget_s"}:
                raise StudyError(
                    f"arms.{name}: {', '.join(sorted(taken))} is the study's to say, not an arm's"
                )
            try:
                made[name] = kinds.make(special, base)
            except CaterpillarError as error:
                raise StudyError(f"arms.{name}: {error}") from None
        try:
            return cls(made, **fields, sources={"base": base, "arms": arms})
        except TypeError as error:
            raise StudyError(f"the study cannot be read: {error}") from None

    def to_dict(self) -> dict[str, Any]:
        """Plain data, as `from_dict` takes it."""
        return {
            "seeds": list(self.seeds),
            "pilot_seeds": list(self.pilot_seeds),
            "budget_s": self.budget_s,
            "reference": self.reference,
            "generation": self.generation,
            "threshold_shares": list(self.threshold_shares),
            **self.sources,
        }

    def cells(self) -> list[Cell]:
        """All runs; those that thresholds come from first."""
        pilot = [Cell(self.reference, seed) for seed in self.pilot_seeds]
        return pilot + [Cell(arm, seed) for seed in self.seeds for arm in self.arms]


def read_toml(path: Path) -> StudyConfig:
    """The study that a TOML file describes.

    Raises:
        StudyError: no such file, no TOML, or no study in it.
    """
    missing = "give the TOML file of a study, or --preset"
    return read(path, StudyConfig.from_dict, StudyError, missing, tomllib.loads)


def preset(name: str) -> StudyConfig:
    """One of the studies that come with the package: paper, ablation, pilot, rl-pilot."""
    return read_toml(Path(__file__).with_name("presets") / f"{name}.toml")


def begin(config: StudyConfig, folder: Path) -> None:
    """Make the study's folder, or see that it holds this study; arms and seeds may be added to it.

    Raises:
        StudyError: the folder holds something else, or cells of other settings.
    """
    file = folder / SETTINGS
    if not file.exists():
        with writing(folder):
            folder.mkdir(parents=True, exist_ok=True)
            if any(folder.iterdir()):
                raise StudyError(f"{folder} is not empty and holds no study; choose another with --out")
    else:
        before = load(folder)
        changed = [
            name
            for name in ("budget_s", "reference", "pilot_seeds", "threshold_shares")
            if getattr(before, name) != getattr(config, name)
        ]
        changed += [f"arms.{a}" for a, c in before.arms.items() if config.arms.get(a, c) != c]
        if changed:
            raise StudyError(
                f"{folder} holds a study with other {', '.join(changed)}; they cannot be compared: "
                "choose another folder with --out"
            )
    with writing(folder):
        write_json(file, config.to_dict())


def load(folder: Path) -> StudyConfig:
    """The study that a folder holds.

    Raises:
        StudyError: the folder holds no study, or one that cannot be read.
    """
    missing = "give a folder that caterpillar study made"
    return read(folder / SETTINGS, StudyConfig.from_dict, StudyError, missing)


def is_finished(config: StudyConfig, cell: Cell, study: Path) -> bool:
    """Whether a cell came to its end; a running one has not.

    Raises:
        ArmError: its run has other settings than the study asks for.
    """
    return config.arms[cell.arm].is_finished(cell.folder(study), cell.seed, config.budget_s)
