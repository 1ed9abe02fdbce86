"""The `caterpillar` command: finds the subcommand, parses its arguments, and says errors in one line.

Subcommands are entry points of the group `caterpillar.commands`: callables that take the remaining
arguments and return an exit status. Other packages add theirs in the same way.
"""

from __future__ import annotations

import contextlib
import io
import re
import sys
from collections.abc import Callable, Sequence
from importlib.metadata import entry_points, version
from typing import TYPE_CHECKING, TypeVar

from caterpillar_env.errors import CaterpillarError

if TYPE_CHECKING:
    from rich.console import Console

T = TypeVar("T")

_SUMMARIES = {
    "doctor": "say what is installed, whether drawing works, and how fast this machine is",
    "evolve": "evolve body and gait: the paper's genetic algorithm, CMA-ES or random search",
    "export": "write the evaluations of a run as CSV, Parquet or JSON",
    "preprocess": "print and draw what the physics-based preprocessor says of each gene",
    "resume": "go on with a run that was stopped, or for more generations",
    "runs": "list the runs in a folder",
    "report": "write the figures and the page of a run or a study",
    "replay": "simulate a recorded robot once more and make a video",
    "study": "run arms and seeds side by side, and compare them",
    "rl": "train a policy by reinforcement learning, and look at it",
    "validate": "check the physics against closed forms, data sheets and finer timesteps",
    "view": "see a robot crawl in the browser, and change it by hand",
}


def main(argv: Sequence[str] | None = None) -> int:
    """Run one subcommand; the exit status is 0, 1 (an error), 2 (wrong usage) or 130 (Ctrl-C)."""
    arguments = list(sys.argv[1:] if argv is None else argv)
    commands = {e.name: e for e in entry_points(group="caterpillar.commands")}
    if arguments[:1] in (["-h"], ["--help"], ["help"]):
        print(_overview(sorted(commands)))
        return 0
    if arguments[:1] == ["--version"]:
        print(version("caterpillar-sma"))
        return 0
    name, *rest = arguments or [""]
    if name not in commands:
        what = f"no subcommand {name!r}" if name else "a subcommand is missing"
        known = ", ".join(sorted(commands))
        print(
            f"caterpillar: error: {what}; choose from {known} (see caterpillar --help)", file=sys.stderr
        )
        return 2
    try:
        run: Callable[[list[str]], int] = commands[name].load()
        return run(rest)
    except CaterpillarError as error:
        print(f"caterpillar {name}: error: {error}", file=sys.stderr)
        return 1
    except SystemExit as stop:  # from the parser: 0 after --help, 2 after wrong usage
        return int(stop.code or 0)
    except BrokenPipeError:
        return 1
    except KeyboardInterrupt:
        print(f"caterpillar {name}: stopped", file=sys.stderr)
        return 130


def parse(kind: type[T], argv: Sequence[str], command: str, default: T | None = None) -> T:
    """A dataclass from command-line flags; wrong usage exits with status 2 after one line."""
    import tyro

    noise = io.StringIO()
    try:
        with contextlib.redirect_stderr(noise):
            return tyro.cli(
                kind,
                prog=f"caterpillar {command}",
                args=list(argv),
                default=tyro.MISSING_NONPROP if default is None else default,
                config=(tyro.conf.OmitArgPrefixes,),
            )
    except SystemExit as stop:
        if stop.code:
            line = re.sub(r"\s+", " ", re.sub(r"[╭╮╰╯─│]+", " ", noise.getvalue())).strip()
            print(f"caterpillar {command}: error: {line}", file=sys.stderr)
        raise


def console() -> Console:
    """Where progress and remarks go: stderr. Folders' names are no markup, and stay in one line."""
    from rich.console import Console

    return Console(stderr=True, markup=False, highlight=False, soft_wrap=True)


def _overview(commands: Sequence[str]) -> str:
    width = max(map(len, commands), default=0)
    lines = [f"  {c:<{width}}  {_SUMMARIES.get(c, 'added by another package')}" for c in commands]
    return "\n".join(
        [
            "usage: caterpillar COMMAND [OPTIONS]",
            "",
            "commands:",
            *lines,
            "",
            "caterpillar COMMAND --help tells the options of one; --version the version.",
        ]
    )
