"""The subcommands `evolve`, `resume` and `preprocess`: their output and files."""

from __future__ import annotations

import itertools
import json
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Annotated, Literal

import tyro
from rich.console import Console
from rich.progress import BarColumn, Progress, TaskID, TextColumn, TimeRemainingColumn
from rich.table import Table

from caterpillar_env.errors import CaterpillarError
from caterpillar_env.gait import GAIT_PERIOD_S
from evolution import cli
from evolution.distributions import Uniform
from evolution.evaluators import Evaluator, LocalEvaluator, RayEvaluator
from evolution.genome import GenomeKind
from evolution.individual import Robot
from evolution.journal import Journal
from evolution.optimizers.ga import GaConfig
from evolution.preprocessor import Clipping, GenePrior, design_parameters, paper_priors
from evolution.run import Generation, RunConfig, RunResult, Told, evolve, read_configuration, resume
from evolution.tracking import FOLDER as TENSORBOARD
from evolution.tracking import TensorBoard

PRESETS = {
    "paper": RunConfig(),
    "quick": RunConfig(generations=6, ga=GaConfig(population=20, hall_of_fame=2)),
}


@dataclass(frozen=True)
class WorkerArgs:
    """Where a run is computed, which makes no difference to its results."""

    evaluator: Literal["local", "ray"] = "local"
    """local: threads of this machine; ray: a Ray cluster."""
    ray_address: str | None = None
    """Address of a running cluster; by default one is started here and ended with the run."""
    threads: int = 0
    """Threads of the local evaluator; 0 for all cores."""
    video: bool = True
    """Write best.mp4."""
    track: Literal["nowhere", "tensorboard"] = "nowhere"
    """tensorboard: log to the run's folder too; a run that does goes on doing so when resumed."""

    def __post_init__(self) -> None:
        if self.threads < 0:
            raise CaterpillarError(f"threads = {self.threads} must not be negative; 0 is all cores")

    def make(self) -> Evaluator:
        """The evaluator."""
        return (
            LocalEvaluator(self.threads) if self.evaluator == "local" else RayEvaluator(self.ray_address)
        )

    @contextmanager
    def following(self, reporter: _Reporter, folder: Path) -> Iterator[Told]:
        """What a run tells its generations to."""
        if self.track == "nowhere" and not (folder / TENSORBOARD).is_dir():
            yield reporter.generation
            return
        with TensorBoard(folder) as board:

            def told(generation: Generation) -> None:
                reporter.generation(generation)
                board.generation(generation)

            yield told


@dataclass(frozen=True)
class EvolveArgs:
    """Evolve body and gait. Without options: the paper's run, 200 genomes for 50 generations."""

    preset: Literal["paper", "quick"] = "paper"
    """quick: 20 genomes for 6 generations, about a minute on two cores. Other flags change a preset."""
    out: Path | None = None
    """Run folder to make; by default a new one under runs/."""
    workers: WorkerArgs = field(default_factory=WorkerArgs)
    config: RunConfig = field(default_factory=RunConfig)


@dataclass(frozen=True)
class ResumeArgs:
    """Go on with a run where it ended; what is in its journal is not computed again."""

    folder: Annotated[Path, tyro.conf.Positional]
    """The run folder."""
    generations: int | None = None
    """Raise the number of generations."""
    repair: bool = False
    """Keep what is whole of a damaged journal, first."""
    workers: WorkerArgs = field(default_factory=WorkerArgs)


def evolve_command(argv: Sequence[str]) -> int:
    """`caterpillar evolve`."""
    args = cli.parse(EvolveArgs, argv, "evolve", EvolveArgs(config=PRESETS[_preset(argv)]))
    config = args.config
    folder = args.out or unused(Path("runs"), f"{config.optimizer}-{config.prior}-seed{config.seed}")
    console = cli.console()
    workers = args.workers
    with _Reporter(config, console) as reporter, workers.following(reporter, folder) as told:
        result = evolve(
            config, folder, evaluator=workers.make(), on_generation=told, on_progress=reporter.progress,
        )  # fmt: skip
    return _finish(result, folder, console, video=args.workers.video)


def resume_command(argv: Sequence[str]) -> int:
    """`caterpillar resume`."""
    args = cli.parse(ResumeArgs, argv, "resume")
    console = cli.console()
    if args.repair:
        kept = Journal.repair(args.folder)
        console.print(f"kept {kept} evaluations; the old file is journal.sqlite.damaged")
    with Journal(args.folder) as journal:
        config, _ = read_configuration(journal)
    config = replace(config, generations=args.generations or config.generations)
    workers = args.workers
    with _Reporter(config, console) as reporter, workers.following(reporter, args.folder) as told:
        result = resume(
            args.folder, generations=args.generations, evaluator=workers.make(),
            on_generation=told, on_progress=reporter.progress,
            on_warning=lambda text: console.print(f"warning: {text}"),
        )  # fmt: skip
    return _finish(result, args.folder, console, video=args.workers.video)


def _preset(argv: Sequence[str]) -> str:
    """The preset named in the arguments: it makes the defaults for all other flags."""
    for flag, value in itertools.pairwise([*argv, ""]):
        name = value if flag == "--preset" else flag.removeprefix("--preset=")
        if flag.startswith("--preset") and name in PRESETS:
            return name
    return "paper"


def unused(parent: Path, name: str) -> Path:
    """A folder of this name that is not there yet, numbered if need be."""
    number = 1
    while (folder := parent / (name if number == 1 else f"{name}-{number}")).exists():
        number += 1
    return folder


def _finish(result: RunResult, folder: Path, console: Console, *, video: bool) -> int:
    """Leave pictures of the best robot; the exit status."""
    status = 0 if result.finished else 130
    if not result.finished:
        console.print(f"stopped; go on with: caterpillar resume {folder}")
    picture(folder, console, video=video)
    return status


def picture(folder: Path, console: Console, *, video: bool) -> Path:
    """Tell the best robot of a run, and leave its pictures and its page in the folder; the page."""
    from evolution import run_report
    from evolution.video import shows

    record = run_report.Record.read(folder)
    best = record.best
    if best is None:
        if record.generations():
            console.print(f"no robot crawled forwards without failing; see caterpillar export {folder}")
    else:
        print(
            f"best: {1000 * (best.fitness_m or 0):.1f} mm in 30 s "
            f"(generation {best.generation}), in {folder}"
        )
        path = folder / "best.mp4"
        if video and not (path.exists() and shows(path, best)):
            film(best, path, console)
    return run_report.write(folder)


def film(robot: Robot, path: Path, console: Console, timestep_s: float | None = None) -> None:
    """Write a video; a machine that cannot draw costs only the video."""
    from evolution.video import Recording, write_video

    console.print(f"writing {path} ...")
    try:
        write_video([Recording(robot, timestep_s=timestep_s)], path)
    except CaterpillarError as error:
        console.print(f"no video: {error}")


class _Reporter:
    """Tells how a run goes: a live bar on a terminal, a line per generation elsewhere."""

    def __init__(self, config: RunConfig, console: Console) -> None:
        self._config, self._console = config, console
        self._bar: Progress | None = None
        self._task: TaskID | None = None
        self._done, self._step, self._replayed = 0.0, 1.0 / config.generations, 0.0

    def __enter__(self) -> _Reporter:
        if self._console.is_terminal:
            self._bar = Progress(
                TextColumn("{task.description}"), BarColumn(),
                TextColumn("{task.percentage:.0f} %, left"), TimeRemainingColumn(),
                console=self._console,
            )  # fmt: skip
            self._bar.start()
            self._task = self._bar.add_task("generation 0", total=1.0)
        return self

    def __exit__(self, *_: object) -> None:
        if self._bar is not None:
            self._bar.stop()

    def generation(self, told: Generation) -> None:
        """Print what a generation brought."""
        done = self._config.share_done(told)
        left = self._config.generations - told.number - 1
        # Of a budget it is not known how many generations are left: the next one is like the last.
        even = (1.0 - done) / left if left else 0.0
        self._step = even if self._config.budget_s is None else done - self._done
        self._done = done
        failures = ", ".join(f"{n} {reason}" for reason, n in told.failures.items() if n) or "none"
        line = (
            f"generation {told.number:3d}  best {1000 * told.best_m:6.1f} mm  "
            f"mean {1000 * told.mean_m:5.1f} mm  failed: {failures}  "
            f"simulated {told.simulated_s:,.0f} s"
        )
        if self._bar is None or self._task is None:
            if told.replayed:
                self._replayed = done  # it took no time, and says nothing of what is left
            computed = done - self._replayed
            if computed > 0:
                line += f"  left {told.elapsed_s / computed * (1.0 - done) / 60:.1f} min"
            self._console.print(line, soft_wrap=True)
        else:
            self._console.print(line)
            self._bar.update(self._task, completed=done, description=f"generation {told.number + 1}")

    def progress(self, share: float) -> None:
        """Move the bar within a generation."""
        if self._bar is not None and self._task is not None:
            self._bar.update(self._task, completed=self._done + share * self._step)


@dataclass(frozen=True)
class PreprocessArgs:
    """Print Table I: what the preprocessor says of each gene, and draw the densities."""

    json: bool = False
    """Print data instead of a table: gene, kind, mu, sigma, lower, upper, reason."""
    out: Path = Path("preprocess.png")
    """Where to draw the densities."""
    genome: GenomeKind = "shared"
    """full: times of every spring; per-segment: a body for every segment."""
    floor_ratio: float = 3.0
    """Greatest over least density of a Gaussian; the paper's third is 3."""
    clipping: Clipping = "truncated"
    """What becomes of a Gaussian beyond the bounds of its gene."""
    mirrored: bool = False
    """Every peak at the opposite end: the prior that misleads on purpose."""
    gait_period_s: float = GAIT_PERIOD_S
    """Gait period, the upper bound of the times."""
    num_segments: int = 4
    """Segments of the robot."""


def preprocess_command(argv: Sequence[str]) -> int:
    """`caterpillar preprocess`."""
    from evolution import plots

    args = cli.parse(PreprocessArgs, argv, "preprocess")
    physics = replace(RunConfig().physics, num_segments=args.num_segments)
    priors = paper_priors(
        physics, args.gait_period_s, args.floor_ratio, args.clipping,
        mirrored=args.mirrored, kind=args.genome,
    )  # fmt: skip
    if args.json:
        print(json.dumps([prior.to_dict() for prior in priors], indent=2))
    else:
        Console(width=None if sys.stdout.isatty() else 160).print(
            _table(priors, [k.name for k in design_parameters(physics)])
        )
    try:
        plots.save(plots.densities(priors), args.out)
    except (OSError, ValueError) as error:
        raise CaterpillarError(
            f"cannot write {args.out}: {error}; choose another file with --out"
        ) from None
    print(f"densities drawn in {args.out}", file=sys.stderr)
    return 0


def _table(priors: Sequence[GenePrior], names: Sequence[str]) -> Table:
    table = Table(title="Mutation distributions (Saunders 2009, Table I)", title_justify="left")
    for heading in ("gene", "range", *names, "mu", "sigma", "reason"):
        table.add_column(heading, no_wrap=heading == "gene")
    for prior in priors:
        gene, data, signs = prior.gene, prior.to_dict(), dict(prior.signs)
        gaussian = not isinstance(prior.distribution, Uniform)
        table.add_row(
            gene.name,
            f"{gene.lower:g} - {gene.upper:g}",
            *({1: "+", -1: "-", 0: ""}[signs.get(name, 0)] for name in names),
            f"{data['mu']:.4g}" if gaussian else "uniform",
            f"{data['sigma']:.4g}" if gaussian else "",
            prior.reason,
        )
    return table
