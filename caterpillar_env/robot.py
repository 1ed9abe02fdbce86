"""Robots (body, gait and physics), and the outcomes of simulating them for 30 s."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, NamedTuple, Protocol, Self

import numpy as np
from numpy.typing import NDArray

from caterpillar_env.arrays import Array
from caterpillar_env.errors import CaterpillarError, check_fields, show
from caterpillar_env.files import ELSEWHERE, digest_of, read, with_digest, write_json
from caterpillar_env.gait import GAIT_PERIOD_S, GaitTimings, count_steps, pair_names, spring_names
from caterpillar_env.morphology import NAMES, Body, Morphology, segments_of
from caterpillar_env.physics import CONTROL_INTERVAL_S, SMA_STEP_S, Physics
from caterpillar_env.task import EPISODE_S, STEPS_PER_INTERVAL, Crawl, Failure, OnInterval, Progress

FORMAT = "caterpillar-individual-1"
_CHUNK_STEPS = 10 * STEPS_PER_INTERVAL
_TIMED = {"pairs": pair_names, "springs": spring_names}


class Outcomes(NamedTuple):
    """Outcomes of P robots."""

    failure: NDArray[np.int8]  #: values of `Failure`, (P,)
    distance_m: Array  #: distance until the end or the failure; 0 after a divergence, (P,)
    energy_j: Array  #: electrical energy, (P,)
    simulated_s: Array  #: simulated time until the end or the failure, (P,)

    @classmethod
    def of(cls, end: Progress) -> Outcomes:
        """Create the outcomes of robots from their final progress."""
        distance_m = np.where(end.failure == Failure.DIVERGED, 0.0, end.distance_m)
        return cls(end.failure, distance_m, end.energy_j, end.time_s)

    @classmethod
    def join(cls, parts: Iterable[Outcomes]) -> Outcomes:
        """Join the outcomes of several groups of robots."""
        return cls(*map(np.concatenate, zip(*parts, strict=True)))

    def rows(self, rows: Any) -> Outcomes:
        """Return the outcomes of some robots, selected by an index or a slice."""
        return Outcomes(*(column[rows] for column in self))

    def fitness(self) -> Array:
        """Return the distance in m, or 0 for robots that fail or move backwards, (P,)."""
        return np.where(self.failure == Failure.NONE, np.maximum(self.distance_m, 0.0), 0.0)


def simulate(
    bodies: Sequence[Body],
    timings: GaitTimings,
    physics: Physics,
    *,
    threads: int = 0,
    duration_s: float = EPISODE_S,
    on_interval: OnInterval | None = None,
) -> Outcomes:
    """Simulate P robots, each until it fails or `duration_s` has passed.

    Args:
        bodies: body of each robot.
        timings: timings of springs or mirrored pairs, arrays of shape (P, springs) or (P, pairs).
        physics: material, numerics and number of segments.
        threads: number of threads; 0 means all usable cores. The results do not depend on it.
        duration_s: simulated time, s, a multiple of 0.1 s.
        on_interval: function to call with the trace of every control interval.
    """
    crawl = Crawl(bodies, physics, threads)
    repeat(crawl, gait_power(timings, physics), duration_s, on_interval=on_interval)
    return Outcomes.of(crawl.progress())


def gait_power(timings: GaitTimings, physics: Physics) -> Array:
    """Return the share of the drive power over one gait period, (P, steps of 10 ms, springs).

    Args:
        timings: see `simulate`. Arrays of shape (springs,) or (pairs,) give a power of (steps, springs).
        physics: gives the number of springs.

    Raises:
        CaterpillarError: the gait period is not a multiple of 0.1 s, or the number of timings is wrong.
    """
    count_steps(timings.period_s, CONTROL_INTERVAL_S, "the gait period")
    return timings.of_springs(physics.num_springs).power(SMA_STEP_S)


def repeat(
    crawl: Crawl,
    power: Array,
    end_s: float,
    *,
    on_interval: OnInterval | None = None,
    on_progress: Callable[[float], None] | None = None,
) -> None:
    """Advance the robots of a `Crawl` with periodic power, until `end_s` after their reset.

    Args:
        crawl: P robots. All that have not failed must be at the same simulated time.
        power: power over one period, (P, steps, springs), see `Crawl.run`. The first period starts at
            the reset.
        end_s: simulated time at which to stop, counted from the reset, s, a multiple of 0.1 s.
        on_interval: see `simulate`.
        on_progress: function to call with the completed share of this call, in [0, 1].
    """
    start_s = float(crawl.progress().time_s.max())
    steps = count_steps(end_s - start_s, CONTROL_INTERVAL_S, "the duration") * STEPS_PER_INTERVAL
    before = round(start_s / SMA_STEP_S)
    # Simulate a few intervals at a time to limit memory.
    first = 0
    while first < steps:
        phase = (before + first) % power.shape[1]
        part = power[:, phase : phase + min(_CHUNK_STEPS, steps - first)]
        crawl.run(part, on_interval=on_interval)
        first += part.shape[1]
        if on_progress is not None:
            on_progress(first / steps)


class AnyRobot(Protocol):
    """Interface of robots for videos and comparisons: a `Robot`, or a robot with a trained policy."""

    @property
    def morphology(self) -> Body:
        """Body of the robot."""

    @property
    def physics(self) -> Physics:
        """Physics of the evaluation."""

    @property
    def fitness_m(self) -> float | None:
        """Recorded fitness, m."""

    @property
    def digest(self) -> str:
        """Hash that identifies the robot."""

    def simulate(self, *, on_interval: OnInterval | None = None) -> Outcomes:
        """Simulate the robot; for `on_interval`, see the function `simulate`."""

    def with_physics(self, **changes: Any) -> Self:
        """Return a copy of the robot with changed fields of `Physics`."""

    def save(self, path: Path) -> None:
        """Write the robot as JSON. For a trained policy, also write the weights next to this file."""


@dataclass(frozen=True, eq=False)
class Robot:
    """A body, its gait, and the physics of its evaluation. Compare robots by their `digest`."""

    morphology: Body
    timings: GaitTimings  #: timings of mirrored pairs or springs, arrays of shape (pairs,) or (springs,)
    physics: Physics
    fitness_m: float | None = None  #: recorded fitness
    generation: int | None = None  #: generation in its run
    evaluation: int | None = None  #: evaluation number in the journal of its run

    def __post_init__(self) -> None:
        check_fields(self)

    def simulate(self, **kwargs: Any) -> Outcomes:
        """Simulate the robot. For the keyword arguments, see the function `simulate`."""
        return simulate([self.morphology], self.timings[None], self.physics, **kwargs)

    def with_physics(self, **changes: Any) -> Robot:
        """Return a copy of the robot with changed fields of `Physics`."""
        return replace(self, physics=replace(self.physics, **changes))

    def power(self) -> Array:
        """Return the share of the drive power over one gait period, (steps of 10 ms, springs)."""
        return gait_power(self.timings, self.physics)

    @property
    def kind(self) -> str:
        """What the timings refer to: "springs", or mirrored "pairs"."""
        return "springs" if len(self.timings.on_s) == self.physics.num_springs else "pairs"

    @property
    def timed(self) -> list[str]:
        """Names of the mirrored pairs or springs that `timings` refers to."""
        return _TIMED[self.kind](self.physics.num_segments)

    @property
    def digest(self) -> str:
        """Hash of the robot and its recorded evaluation."""
        return digest_of(self.to_dict())

    def to_dict(self) -> dict[str, Any]:
        """Return the robot as a mapping for JSON. Names end with units."""
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
                self.kind: {name: {"on_s": on, "off_s": off} for name, on, off in times},
            },
            "physics": self.physics.to_dict(),
        }

    @classmethod
    def from_dict(cls, data: Any) -> Robot:
        """Create a robot from a mapping that was read from JSON.

        Raises:
            CaterpillarError: a field is missing or invalid.
        """
        if not isinstance(data, dict) or show(data.get("format")) != show(FORMAT):
            raise CaterpillarError(
                f'not a robot: expected JSON with "format": "{FORMAT}", as in best.json (for a trained '
                "policy, use caterpillar rl eval)"
            )
        try:
            physics = Physics.of(data["physics"])
            kind = "springs" if "springs" in data["gait"] else "pairs"
            names, given = _TIMED[kind](physics.num_segments), data["gait"][kind]
            if set(given) != set(names):
                raise CaterpillarError(
                    f"gait.{kind} must have the keys {', '.join(names)}; got {', '.join(given)}"
                )
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
        except (LookupError, TypeError, ValueError, AttributeError, OverflowError) as error:
            raise CaterpillarError(f"a field of the robot is missing or invalid: {error}") from None

    def save(self, path: str | Path, advice: str = ELSEWHERE) -> None:
        """Write the robot as JSON, with a digest by which `load` detects damage.

        Args:
            path: path of the file.
            advice: advice for the message if the file cannot be written.
        """
        write_json(Path(path), with_digest(self.to_dict()), advice)

    @classmethod
    def load(cls, path: str | Path) -> Robot:
        """Read a robot from its JSON file, or the best one from a run folder.

        Raises:
            CaterpillarError: the file does not exist, does not describe a robot, or does not match its
                digest.
        """
        path, advice = Path(path), "give a run folder or the JSON file of one robot"
        if os.path.isdir(path):
            if os.access(path, os.X_OK) and not (path / "best.json").exists():
                raise CaterpillarError(
                    f"{path} holds no best.json: it is not a run folder, or no robot of the run has "
                    f"crawled forwards without failing yet; {advice}"
                )
            path = path / "best.json"
        return read(path, cls.from_dict, f"{advice} (for a trained policy, use caterpillar rl eval)")


def wave_robot() -> Robot:
    """Return the nominal robot with a hand-designed wave gait from tail to head.

    Each pair is powered for a fifth of the period. Ventral pairs follow dorsal pairs by half a period.
    """
    on = np.array([0, 3, 4, 1, 2, 5]) / 6
    on_s, off_s = (GAIT_PERIOD_S * share for share in (on, (on + 0.2) % 1))
    return Robot(Morphology(), GaitTimings(GAIT_PERIOD_S, on_s, off_s), Physics())


def stack(robots: Sequence[Robot]) -> tuple[list[Body], GaitTimings]:
    """Return the bodies and the timings of robots, for `simulate`.

    Raises:
        CaterpillarError: the robots have different gait periods or numbers of timings.
    """
    timings = [robot.timings for robot in robots]
    if len({(t.period_s, t.on_s.shape) for t in timings}) > 1:
        raise CaterpillarError(
            "robots must have the same gait period and the same number of on and off times"
        )
    on_s, off_s = np.stack([t.on_s for t in timings]), np.stack([t.off_s for t in timings])
    return [robot.morphology for robot in robots], GaitTimings(timings[0].period_s, on_s, off_s)


def _segment(data: Any) -> Morphology:
    """Read the morphology of a segment. Unlike in `Morphology.of`, no parameter may be missing."""
    return Morphology.of({**dict.fromkeys(NAMES), **data} if isinstance(data, dict) else data)
