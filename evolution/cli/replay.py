"""`caterpillar replay`."""

from __future__ import annotations

import json
import sys
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any

import tyro

from caterpillar_env.drawing.rendering import RenderingError
from caterpillar_env.drawing.video import Recording, VideoConfig, check_path, write_video
from caterpillar_env.errors import CaterpillarError
from caterpillar_env.files import name_of
from caterpillar_env.robot import Robot
from caterpillar_env.task import Failure
from evolution import cli
from evolution.run.history import History


@dataclass(frozen=True)
class ReplayArgs:
    """Simulate recorded robots again, compare them with their records, and make a video.

    Several robots are shown side by side. To film an evolution, show the best robots after some of the
    generations: `caterpillar replay RUN --generations 0 5 10 25 50`.
    """

    source: Annotated[tuple[Path, ...], tyro.conf.Positional]
    """Run folders, or JSON files of robots (best.json)."""
    generations: tuple[int, ...] = ()
    """Show the best robot after each of these generations of a run. Give the run folder before
    this option."""
    timestep_s: float | None = None
    """Timestep in s, such as 0.0005; by default, the recorded timestep."""
    json: bool = False
    """Print JSON instead of text: an object, or a list of objects for several robots."""
    video: bool = True
    """Write a video."""
    out: Path | None = None
    """Video file, .mp4, .gif or .webp. By default, replay.mp4 (film.mp4 with --generations) beside the
    first source."""
    picture: VideoConfig = field(default_factory=VideoConfig)

    def __post_init__(self) -> None:
        if not self.source:
            raise CaterpillarError("give one or more run folders, or JSON files of robots (best.json)")
        if self.generations and (len(self.source) > 1 or min(self.generations) < 0):
            raise CaterpillarError(
                "--generations needs one run folder, and numbers that are not negative; got "
                f"{' '.join(map(str, self.source))} and {' '.join(map(str, self.generations))}"
            )


def replay_command(argv: Sequence[str]) -> int:
    """Simulate recorded robots again, and make a video."""
    args = cli.parse(ReplayArgs, argv, "replay")
    robots = _load_robots(args)
    if args.timestep_s is not None:
        robots = [(title, robot.with_physics(timestep_s=args.timestep_s)) for title, robot in robots]
    first = args.source[0]
    name = "film.mp4" if args.generations else "replay.mp4"
    out = args.out or (first if first.is_dir() else first.parent) / name
    if args.video:
        check_path(out)
        args.picture.layout(len(robots))  # raises an error if the video is too small
    recordings, comparisons = [], []
    for title, robot in robots:
        recording = Recording(robot, title)
        recordings.append(recording)
        comparisons.append({"title": title, **_compare(recording)})
        if not args.json:
            prefix = f"{title}: " if len(robots) > 1 else ""
            print(prefix + _describe(comparisons[-1]))
    if args.json:
        print(json.dumps(comparisons if len(robots) > 1 else comparisons[0], indent=2))
    if args.video:
        print(f"writing {out} ...", file=sys.stderr)
        try:
            write_video(recordings, out, args.picture)
        except RenderingError as error:
            if args.out is not None:
                raise
            print(f"no video: {error}", file=sys.stderr)
    return 0


def _load_robots(args: ReplayArgs) -> list[tuple[str, Robot]]:
    """Load the robots to show, with their titles."""
    if not args.generations:
        titles = [_title(path) for path in args.source]
        if len(set(titles)) < len(titles):
            titles = list(map(str, args.source))
        return [(title, Robot.load(path)) for title, path in zip(titles, args.source, strict=True)]
    leaders = History.read(args.source[0]).leaders()
    last = len(leaders) - 1
    numbers = dict.fromkeys(min(number, last) for number in args.generations)
    return [(f"generation {number}", leaders[number]) for number in numbers]


def _title(path: Path) -> str:
    """Return the name of the run folder for a folder or its best.json, else the stem of the file."""
    if path.is_dir():
        return name_of(path)
    return name_of(path.resolve().parent) if path.name == "best.json" else name_of(path.with_suffix(""))


def _compare(recording: Recording) -> dict[str, Any]:
    robot, outcomes = recording.robot, recording.outcomes
    fitness_m = float(outcomes.fitness()[0])
    return {
        "fitness_m": fitness_m,
        "recorded_fitness_m": robot.fitness_m,
        "identical": fitness_m == robot.fitness_m,
        "failure": Failure(outcomes.failure[0]).label,
        "distance_m": float(outcomes.distance_m[0]),
        "energy_j": float(outcomes.energy_j[0]),
        "simulated_s": float(outcomes.simulated_s[0]),
        "timestep_s": robot.physics.timestep_s,
    }


def _describe(comparison: dict[str, Any]) -> str:
    fitness_m, recorded_m = comparison["fitness_m"], comparison["recorded_fitness_m"]
    if recorded_m is None:
        verdict = "no recorded fitness to compare with"
    elif comparison["identical"]:
        verdict = "identical to the record"
    elif not recorded_m:
        verdict = "different from the recorded 0.0 m"
    else:
        change = 100 * (fitness_m / recorded_m - 1)
        verdict = f"{change:+.1f} % relative to the recorded {recorded_m!r} m"
    energy = f"{comparison['energy_j']:.1f} J"
    return f"fitness {fitness_m!r} m ({comparison['failure']}), {energy}, {verdict}"
