"""Robots: a body with its gait and physics, and the outcome of letting it crawl for 30 s."""

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
    """A file does not describe a robot."""


class Outcomes(NamedTuple):
    """Outcomes of P robots."""

    failure: NDArray[np.int8]  #: values of `Failure`, (P,)
    distance_m: Array  #: until the end or the failure; 0 where it is not finite, (P,)
    energy_j: Array  #: electrical, (P,)
    simulated_s: Array  #: until the end or the failure, (P,)

    @classmethod
    def of(cls, end: Progress) -> Outcomes:
        """Outcomes of robots that have failed or reached the end."""
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
    """Simulate P robots, each until it fails.

    Args:
        bodies: one for each robot.
        timings: of their springs or mirrored pairs, arrays of shape (P, springs) or (P, pairs).
        physics: material, numerics, number of segments.
        threads: 0 means all usable cores; the results do not depend on it.
        duration_s: simulated time, a multiple of 0.1 s.
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
    """What videos and comparisons need of a robot: a `Robot`, or one driven by a trained policy."""

    @property
    def morphology(self) -> Body:
        """The body."""

    @property
    def physics(self) -> Physics:
        """The physics that it was evaluated in."""

    @property
    def fitness_m(self) -> float | None:
        """The recorded fitness, m."""

    @property
    def digest(self) -> str:
        """Hash that identifies the robot."""

    def simulate(
        self, timestep_s: float | None = None, *, on_interval: OnInterval | None = None
    ) -> Outcomes:
        """Simulate the robot, at another timestep if one is given; see `simulate`."""

    def save(self, path: Path) -> None:
        """Write the robot as JSON, with further files beside it if it has any."""


@dataclass(frozen=True)
class Robot:
    """A body with its gait, and the physics that it was evaluated in."""

    morphology: Body
    timings: GaitTimings  #: of the mirrored pairs or the springs, arrays of shape (pairs,) or (springs,)
    physics: Physics
    fitness_m: float | None = None  #: as recorded
    generation: int | None = None
    evaluation: int | None = None  #: number in the journal of its run

    def simulate(self, timestep_s: float | None = None, **kwargs: Any) -> Outcomes:
        """Simulate the robot, at another timestep if one is given; keywords as for `simulate`."""
        physics = self.physics if timestep_s is None else replace(self.physics, timestep_s=timestep_s)
        return simulate([self.morphology], self.gaits, physics, **kwargs)

    @property
    def gaits(self) -> GaitTimings:
        """The timings as arrays of shape (1, n), for `simulate`."""
        return replace(self.timings, on_s=self.timings.on_s[None], off_s=self.timings.off_s[None])

    @property
    def _kind(self) -> str:
        return "springs" if len(self.timings.on_s) == self.physics.num_springs else "pairs"

    @property
    def timed(self) -> list[str]:
        """Names of the mirrored pairs or springs that `timings` refers to."""
        return _TIMED[self._kind](self.physics.num_segments)

    @property
    def digest(self) -> str:
        """Hash that identifies the robot, with its record."""
        return digest_of(self.to_dict())

    def to_dict(self) -> dict[str, Any]:
        """Return the robot as plain JSON; names carry units."""
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
        """Read a robot from plain JSON.

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
            record = {name: data.get(name) for name in ("fitness_m", "generation", "evaluation")}
            return cls(body, timings, physics, **record)
        except CaterpillarError:
            raise
        except (KeyError, TypeError, ValueError, AttributeError) as error:
            raise RobotError(f"the robot lacks a part, or one is unusable: {error}") from None

    def save(self, path: str | Path) -> None:
        """Write the robot as JSON."""
        write_json(Path(path), self.to_dict())

    @classmethod
    def load(cls, path: str | Path) -> Robot:
        """Read a robot from its JSON file, or the best one from a run folder.

        Raises:
            CaterpillarError: no such file, or no robot in it.
        """
        path, advice = Path(path), "give a run folder or the JSON file of one robot"
        if os.path.isdir(path):
            if not (path / "best.json").exists():
                raise RobotError(
                    f"{path} holds no best.json: it is no run folder, or no robot of the run has "
                    f"crawled forwards without failing yet; {advice}"
                )
            path = path / "best.json"
        return read(
            path, cls.from_dict, RobotError, f"{advice} (for a trained policy: caterpillar rl eval)"
        )


def _segment(data: Any) -> Morphology:
    """Read the morphology of a segment; unlike `Morphology.of`, all parameters must be given."""
    return Morphology.of({**dict.fromkeys(NAMES), **data} if isinstance(data, dict) else data)


def digest_of(data: dict[str, Any]) -> str:
    """Return a hash of plain JSON."""
    return hashlib.blake2b(json.dumps(data).encode(), digest_size=16).hexdigest()
