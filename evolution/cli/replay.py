"""The subcommand `replay`: recorded robots once more, compared with their records, and on video."""

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
from caterpillar_env.robot import Robot
from caterpillar_env.task import label
from evolution import cli
from evolution.run.history import History


@dataclass(frozen=True)
class ReplayArgs:
    """Simulate recorded robots once more, compare with their records, and make a video.

    Several robots are shown side by side. The film of an evolution shows the best robot of a run
    after some of its generations: `caterpillar replay RUN --generations 0 5 10 25 50`.
    """

    source: Annotated[tuple[Path, ...], tyro.conf.Positional]
    """Run folders, or JSON files of one robot each (best.json)."""
    generations: tuple[int, ...] = ()
    """Of one run, named before the flag: show the best robot so far after each of these generations."""
    timestep_s: float | None = None
    """Another timestep than the recorded one, in s: 0.0005, say."""
    json: bool = False
    """Print JSON instead of sentences; for several robots a list."""
    video: bool = True
    """Write a video."""
    out: Path | None = None
    """File to write, .mp4 or .gif; by default replay.mp4 or film.mp4 beside the source, or here."""
    picture: VideoConfig = field(default_factory=VideoConfig)

    def __post_init__(self) -> None:
        if not self.source:
            raise CaterpillarError(
                "give a run folder or the JSON file of a robot (best.json), or several"
            )
        if self.generations and (len(self.source) > 1 or min(self.generations) < 0):
            raise CaterpillarError(
                "--generations takes one run folder and numbers from 0; got "
                f"{' '.join(map(str, self.source))} and {' '.join(map(str, self.generations))}"
            )
        if self.out is not None and not self.video:
            raise CaterpillarError(
                f"--out {self.out} names a video, and --no-video wants none: give one of them"
            )


def replay_command(argv: Sequence[str]) -> int:
    """Simulate recorded robots again, and make a video."""
    args = cli.parse(ReplayArgs, argv, "replay")
    robots = _robots(args)
    out = args.out or _beside(args)
    if args.video:
        check_path(out)
        args.picture.layout(len(robots))
    recordings, told = [], []
    for title, robot in robots:
        recording = Recording(robot, title, timestep_s=args.timestep_s)
        recordings.append(recording)
        said = _compared(recording, args.timestep_s)
        told.append({"title": title, **said} if len(robots) > 1 else said)
        if not args.json:
            print(f"{title}: " * (len(robots) > 1) + _sentence(said))
    if args.json:
        print(json.dumps(told if len(robots) > 1 else told[0], indent=2))
    if args.video:
        print(f"writing {out} ...", file=sys.stderr)
        try:
            write_video(recordings, out, args.picture)
        except RenderingError as error:
            if args.out is not None:
                raise
            print(f"no video: {error}", file=sys.stderr)
    return 0


def _robots(args: ReplayArgs) -> list[tuple[str, Robot]]:
    """The robots with their titles."""
    if not args.generations:
        titles = [_title(path) for path in args.source]
        unique = len(set(titles)) == len(titles)
        names = titles if unique else list(map(str, args.source))
        return [(name, Robot.load(path)) for name, path in zip(names, args.source, strict=True)]
    best = History.read(args.source[0]).leaders()
    last = len(best) - 1
    if max(args.generations) > last:
        print(f"{args.source[0]} ends with generation {last}, shown for later ones", file=sys.stderr)
    chosen = dict.fromkeys(min(number, last) for number in args.generations)
    return [(f"generation {number}", best[number]) for number in chosen]


def _title(path: Path) -> str:
    """Of a run folder or its best.json the folder's name, else the file's."""
    if path.is_dir():
        return path.resolve().name
    return path.resolve().parent.name if path.name == "best.json" else path.stem


def _beside(args: ReplayArgs) -> Path:
    if len(args.source) > 1:
        return Path("replay.mp4")
    (source,) = args.source
    folder = source if source.is_dir() else source.parent
    return folder / ("film.mp4" if args.generations else "replay.mp4")


def _compared(recording: Recording, timestep_s: float | None) -> dict[str, Any]:
    robot, outcomes = recording.robot, recording.outcomes
    fitness_m = float(outcomes.fitness()[0])
    return {
        "fitness_m": fitness_m,
        "recorded_fitness_m": robot.fitness_m,
        "identical": fitness_m == robot.fitness_m,
        "failure": label(outcomes.failure[0]),
        "distance_m": float(outcomes.distance_m[0]),
        "energy_j": float(outcomes.energy_j[0]),
        "simulated_s": float(outcomes.simulated_s[0]),
        "timestep_s": timestep_s or robot.physics.timestep_s,
    }


def _sentence(said: dict[str, Any]) -> str:
    recorded = said["recorded_fitness_m"]
    if not recorded:
        verdict = "nothing recorded to compare with"
    elif said["identical"]:
        verdict = "the same as recorded, bit for bit"
    else:
        verdict = f"recorded {recorded!r} m: {100 * (said['fitness_m'] / recorded - 1):+.1f} %"
    return f"fitness {said['fitness_m']!r} m ({said['failure']}), {said['energy_j']:.1f} J, {verdict}"
