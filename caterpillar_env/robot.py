"""Robots: a body, a gait and the physics that they crawl in, and what becomes of them in 30 s."""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from caterpillar_env.arrays import Array
from caterpillar_env.errors import CaterpillarError
from caterpillar_env.files import read, write_json
from caterpillar_env.gait import GaitTimings, count_steps, pair_names, spring_names
from caterpillar_env.morphology import NAMES, Body, Morphology, segments_of
from caterpillar_env.physics import CONTROL_INTERVAL_S, SMA_STEP_S, Physics
from caterpillar_env.task import EPISODE_S, STEPS_PER_INTERVAL, Crawl, Failure, OnInterval, Progress

FORMAT = "caterpillar-individual-1"
_CHUNK_STEPS = 10 * STEPS_PER_INTERVAL
_TIMED = {"pairs": pair_names, "springs": spring_names}


class RobotError(CaterpillarError):
    """A file does not hold an individual."""


class Outcomes(NamedTuple):
    """What became of P genomes. A failure is a status, not a number."""

    failure: NDArray[np.int8]  #: values of `Failure`, (P,)
    distance_m: Array  #: until the end or the failure, finite, (P,)
    energy_j: Array  #: electrical, (P,)
    simulated_s: Array  #: really stepped, (P,)

    @classmethod
    def of(cls, end: Progress) -> Outcomes:
        """What became of robots that have come to their end."""
        # Of a robot that went nowhere finite no distance can be told; its status says why.
        distance_m = np.where(np.isfinite(end.distance_m), end.distance_m, 0.0)
        return cls(end.failure, distance_m, end.energy_j, end.time_s)

    def fitness(self, failed_fitness: float = 0.0) -> Array:
        """Distance in m, not below 0; `failed_fitness` for a failure, (P,)."""
        ok = self.failure == Failure.NONE
        return np.where(ok, np.maximum(self.distance_m, 0.0), failed_fitness)


def simulate(
    bodies: Sequence[Body],
    timings: GaitTimings,
    physics: Physics,
    *,
    threads: int = 0,
    duration_s: float = EPISODE_S,
    on_interval: OnInterval | None = None,
) -> Outcomes:
    """Let P robots crawl side by side, each until it fails.

    Args:
        bodies: P of them.
        timings: of their springs or mirrored pairs, arrays of shape (P, springs) or (P, pairs).
        physics: material, numerics, number of segments.
        threads: 0 means all cores; results do not depend on it.
        duration_s: how long each crawls.
        on_interval: called with the trace of every control interval.
    """
    count_steps(timings.period_s, CONTROL_INTERVAL_S, "the gait period")
    steps = count_steps(duration_s, CONTROL_INTERVAL_S, "the duration") * STEPS_PER_INTERVAL
    power = timings.of_springs(physics.num_springs).power(SMA_STEP_S)
    crawl = Crawl(bodies, physics, threads)
    # Some intervals at a time, so that no array of the whole 30 s is made.
    first = 0
    while first < steps:
        phase = first % power.shape[1]
        part = power[:, phase : phase + min(_CHUNK_STEPS, steps - first)]
        crawl.run(part, on_interval=on_interval)
        first += part.shape[1]
    return Outcomes.of(crawl.progress())


class AnyRobot(Protocol):
    """A body and whatever drives it: a `Robot`, or a trained policy. A dataclass."""

    @property
    def morphology(self) -> Body:
        """Its body."""
        ...

    @property
    def physics(self) -> Physics:
        """What it was evaluated in."""
        ...

    @property
    def fitness_m(self) -> float | None:
        """How far it crawled, as recorded."""
        ...

    @property
    def digest(self) -> str:
        """Tells it from any other robot."""
        ...

    def simulate(
        self,
        timestep_s: float | None = None,
        *,
        on_interval: OnInterval | None = None,
    ) -> Outcomes:
        """Let it crawl once more, at its own timestep or another; see `simulate`."""
        ...

    def save(self, path: Path) -> None:
        """Keep it as JSON, with what belongs to it beside that."""
        ...


@dataclass(frozen=True)
class Robot:
    """A body with its gait, in the physics that it was evaluated in."""

    morphology: Body
    timings: GaitTimings  #: of the mirrored pairs or the springs, arrays of shape (pairs,) or (springs,)
    physics: Physics
    fitness_m: float | None = None  #: as recorded
    generation: int | None = None
    evaluation: int | None = None  #: number in the journal of its run

    def simulate(self, timestep_s: float | None = None, **kwargs: Any) -> Outcomes:
        """Let it crawl once more, at its own timestep or another; keywords as for `simulate`."""
        physics = self.physics if timestep_s is None else replace(self.physics, timestep_s=timestep_s)
        return simulate([self.morphology], self.gaits, physics, **kwargs)

    @property
    def gaits(self) -> GaitTimings:
        """The timings as those of one robot among many, arrays of shape (1, n)."""
        return replace(self.timings, on_s=self.timings.on_s[None], off_s=self.timings.off_s[None])

    @property
    def _kind(self) -> str:
        return "springs" if len(self.timings.on_s) == self.physics.num_springs else "pairs"

    @property
    def timed(self) -> list[str]:
        """Names of what `timings` are of: mirrored pairs or springs."""
        return _TIMED[self._kind](self.physics.num_segments)

    @property
    def digest(self) -> str:
        """What tells this robot, with its record, from any other."""
        return digest_of(self.to_dict())

    def to_dict(self) -> dict[str, Any]:
        """Plain JSON; every number carries its unit in its name."""
        body, timings = self.morphology, self.timings
        times = zip(self.timed, timings.on_s.tolist(), timings.off_s.tolist(), strict=True)
        return {
            "format": FORMAT,
            "fitness_m": self.fitness_m,
            "generation": self.generation,
            "evaluation": self.evaluation,
            "morphology": (
                body.to_dict() if isinstance(body, Morphology) else [m.to_dict() for m in body]
            ),
            "gait": {
                "period_s": timings.period_s,
                self._kind: {name: {"on_s": on, "off_s": off} for name, on, off in times},
            },
            "physics": self.physics.to_dict(),
        }

    @classmethod
    def from_dict(cls, data: Any) -> Robot:
        """The individual in plain JSON.

        Raises:
            CaterpillarError: a part is missing or unusable.
        """
        if not isinstance(data, dict) or data.get("format") != FORMAT:
            raise RobotError(
                f'no robot: expected JSON with "format": "{FORMAT}", as in best.json (a trained policy '
                "crawls by caterpillar rl eval)"
            )
        try:
            physics = Physics.of(data["physics"])
            kind = "springs" if "springs" in data["gait"] else "pairs"
            names, given = _TIMED[kind](physics.num_segments), data["gait"][kind]
            if set(given) != set(names):
                raise RobotError(f"gait.{kind} must be {', '.join(names)}; got {', '.join(given)}")
            body = data["morphology"]
            if isinstance(body, list) and body and isinstance(body[0], dict):
                body = segments_of(tuple(map(_segment, body)), physics.num_segments)
            else:
                body = _segment(body)
            timings = GaitTimings(
                data["gait"]["period_s"],
                np.array([float(given[n]["on_s"]) for n in names]),
                np.array([float(given[n]["off_s"]) for n in names]),
            )
            return cls(
                body,
                timings,
                physics,
                data.get("fitness_m"),
                data.get("generation"),
                data.get("evaluation"),
            )
        except CaterpillarError:
            raise
        except (KeyError, TypeError, ValueError, AttributeError) as error:
            raise RobotError(f"the robot lacks a part, or one is unusable: {error}") from None

    def save(self, path: Path) -> None:
        """Write `path`."""
        write_json(path, self.to_dict())

    @classmethod
    def load(cls, path: Path) -> Robot:
        """Read `path`: a run folder or a JSON file.

        Raises:
            CaterpillarError: no such file, no JSON, or no individual in it.
        """
        otherwise = (
            "give a run folder or the JSON file of one robot (a trained policy crawls by caterpillar rl "
            "eval)"
        )
        file = path / "best.json" if os.path.isdir(path) else path
        if file != path and not file.exists():
            raise RobotError(
                f"{path} holds no best.json: it is no run folder, or no robot of the run has crawled "
                "forwards without failing yet; give another run folder or the JSON file of one robot"
            )
        return read(file, cls.from_dict, RobotError, otherwise)


def _segment(data: Any) -> Morphology:
    """Read the morphology of a segment; unlike `Morphology.of`, all parameters must be given."""
    return Morphology.of({**dict.fromkeys(NAMES), **data} if isinstance(data, dict) else data)


def digest_of(data: dict[str, Any]) -> str:
    """Tells a robot, as plain JSON, from any other."""
    return hashlib.blake2b(json.dumps(data).encode(), digest_size=16).hexdigest()
