"""One evolved robot as plain JSON: body, gait and physics in SI units, and what it achieved."""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from caterpillar_env.errors import CaterpillarError
from caterpillar_env.gait import GaitTimings, pair_names, spring_names
from caterpillar_env.morphology import Body, Morphology, segments_of
from caterpillar_env.physics import Physics
from caterpillar_env.simulation import Trace
from evolution.files import read, write_json
from evolution.fitness import Outcomes, simulate
from evolution.genome import Encoding, gene_values

FORMAT = "caterpillar-individual-1"
_TIMED = {"pairs": pair_names, "springs": spring_names}


class IndividualError(CaterpillarError):
    """A file does not hold an individual."""


class Robot(Protocol):
    """A body and whatever drives it: an `Individual`, or a trained policy. A dataclass."""

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
        on_interval: Callable[[Trace | None], None] | None = None,
        trace: bool = False,
    ) -> Outcomes:
        """Let it crawl once more, at its own timestep or another; see `fitness.simulate`."""
        ...

    def save(self, path: Path) -> None:
        """Keep it as JSON, with what belongs to it beside that."""
        ...


@dataclass(frozen=True)
class Individual:
    """A body with its gait, in the physics that it was evaluated in."""

    morphology: Body
    timings: GaitTimings  #: of the mirrored pairs or the springs, arrays of shape (pairs,) or (springs,)
    physics: Physics
    fitness_m: float | None = None  #: as recorded
    generation: int | None = None

    @classmethod
    def of_genome(
        cls,
        genome: NDArray[np.float64],
        encoding: Encoding,
        *,
        fitness_m: float | None = None,
        generation: int | None = None,
    ) -> Individual:
        """The individual of a genome (n,) in [0, 1]."""
        (body,), timings = encoding.decode(genome[None])
        gait = GaitTimings(timings.period_s, timings.on_s[0], timings.off_s[0])
        return cls(body, gait, encoding.physics, fitness_m, generation)

    def simulate(self, timestep_s: float | None = None, **kwargs: Any) -> Outcomes:
        """Let it crawl once more, at its own timestep or another; keywords as for `fitness.simulate`."""
        physics = self.physics if timestep_s is None else replace(self.physics, timestep_s=timestep_s)
        return simulate([self.morphology], self._gaits, physics, **kwargs)

    @property
    def _gaits(self) -> GaitTimings:
        """The timings as those of one robot among many, arrays of shape (1, n)."""
        return replace(self.timings, on_s=self.timings.on_s[None], off_s=self.timings.off_s[None])

    @property
    def _kind(self) -> str:
        return "springs" if len(self.timings.on_s) == self.physics.num_springs else "pairs"

    @property
    def timed(self) -> list[str]:
        """Names of what `timings` are of: mirrored pairs or springs."""
        return _TIMED[self._kind](self.physics.num_segments)

    def gene_values(self) -> NDArray[np.float64]:
        """What each gene says, in the order of the genes, SI units, (n,)."""
        values: NDArray[np.float64] = gene_values([self.morphology], self._gaits)[0]
        return values

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
    def from_dict(cls, data: Any) -> Individual:
        """The individual in plain JSON.

        Raises:
            CaterpillarError: a part is missing or unusable.
        """
        if not isinstance(data, dict) or data.get("format") != FORMAT:
            raise IndividualError(
                f'no robot: expected JSON with "format": "{FORMAT}", as in best.json (a trained policy '
                "crawls by caterpillar rl eval)"
            )
        try:
            physics = Physics.of(data["physics"])
            kind = "springs" if "springs" in data["gait"] else "pairs"
            names, given = _TIMED[kind](physics.num_segments), data["gait"][kind]
            if set(given) != set(names):
                raise IndividualError(f"gait.{kind} must be {', '.join(names)}; got {', '.join(given)}")
            body = data["morphology"]
            if isinstance(body, list) and body and isinstance(body[0], dict):
                body = segments_of(tuple(Morphology.of(m) for m in body), physics.num_segments)
            else:
                body = Morphology.of(body)
            timings = GaitTimings(
                data["gait"]["period_s"],
                np.array([float(given[n]["on_s"]) for n in names]),
                np.array([float(given[n]["off_s"]) for n in names]),
            )
            return cls(body, timings, physics, data.get("fitness_m"), data.get("generation"))
        except CaterpillarError:
            raise
        except (KeyError, TypeError, ValueError, AttributeError) as error:
            raise IndividualError(f"the robot lacks a part, or one is unusable: {error}") from None

    def save(self, path: Path) -> None:
        """Write `path`."""
        write_json(path, self.to_dict())

    @classmethod
    def load(cls, path: Path) -> Individual:
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
            raise IndividualError(
                f"{path} holds no best.json: it is no run folder, or no robot of the run has crawled "
                "forwards without failing yet; give another run folder or the JSON file of one robot"
            )
        return read(file, cls.from_dict, IndividualError, otherwise)


def digest_of(data: dict[str, Any]) -> str:
    """Tells a robot, as plain JSON, from any other."""
    return hashlib.blake2b(json.dumps(data).encode(), digest_size=16).hexdigest()
