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
    from rich.progress import Progress

T = TypeVar("T")

_SUMMARIES = {
    "doctor": "say what is installed, whether drawing works, and how fast this machine is",
    "evolve": "evolve body and gait: the paper's genetic algorithm, CMA-ES or random search",
    "export": "write the evaluations of a run as a table, or a robot as a MuJoCo model",
    "preprocess": "print and draw what the physics-based preprocessor says of each gene",
    "resume": "go on with a run that was stopped, or with a finished one for more generations",
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
        what = f"no command {name!r}" if name else "a command is missing"
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
    told = io.TextIOWrapper(io.BytesIO(), encoding=sys.stdout.encoding or "utf-8")  # else without boxes
    try:
        with contextlib.redirect_stderr(noise), contextlib.redirect_stdout(told):
            return tyro.cli(
                kind,
                prog=f"caterpillar {command}",
                args=list(argv),
                default=tyro.MISSING_NONPROP if default is None else default,
                config=(tyro.conf.OmitArgPrefixes, tyro.conf.DisallowNone),
            )
    except SystemExit as stop:
        if stop.code:
            line = f"caterpillar {command}: error: {_wrong(stop, noise.getvalue())}"
            print(f"{line} (see caterpillar {command} --help)", file=sys.stderr)
        else:
            told.seek(0)
            print(_NO_DEFAULT.sub(lambda m: re.sub(r"[^\s│]", " ", m[0]), told.read()), end="")
        raise


_NO_DEFAULT = re.compile(r"\(default:[\s│]*(None)?\)")  #: what it is then, the text before tells
#: What the parser says, and in plain English.
_PLAIN = (
    (r"╭.*╮|\A.*\n *-{5,}|[╰╯─│]+|-{5,}", " "),  # the box or, where there is no UTF-8, lines; the title
    (r"\s+", " "),
    (r" (Argument|For full) helptext.*", ""),
    (r"^ Error parsing ", ""),
    (r"no type matching .*? Got errors: - \S.*?: ", ""),
    (r"invalid literal for int\(\) with base 10: (.*)", r"must be a whole number; got \1"),
    (r"could not convert string to float: (.*)", r"must be a number; got \1"),
    (r"Could not find valid parse for arguments: (.*)", r"must be numbers; got \1"),
    (
        r"invalid choice (.*) for argument '(\S+)'\. Expected one of \((.*?),?\)\.",
        r"\2: must be one of \3; got \1",
    ),
    (r"'None', |, 'None'", ""),
    (r"Missing value for argument '(\S+)'.*", r"\1: a value must follow it"),
    (r"Failed to parse key-value pairs!", "must be groups of a name and all of its values"),
    (r"Missing from .*?: (\S+) (.*) \(required\)", r"\1 is missing: \2"),
    (r" Perhaps you meant: (--[^\s,]+).*", r"; perhaps \1 was meant"),
)


def _wrong(stop: SystemExit, said: str) -> str:
    """What was wrong with the usage, in one line."""
    error: BaseException | None = stop
    while error is not None:  # one of our own is behind it where a value was no good
        if isinstance(error, CaterpillarError):
            return str(error)
        error = error.__context__
    for pattern, plain in _PLAIN:
        said = re.sub(pattern, plain, said)
    return said.strip()


def console() -> Console:
    """Where progress and remarks go: stderr. Folders' names are no markup, and stay in one line."""
    from rich.console import Console

    return Console(stderr=True, markup=False, highlight=False, soft_wrap=True)


def bar(console: Console) -> Progress:
    """Share done and time left, on a terminal; nothing elsewhere."""
    from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn

    return Progress(
        TextColumn("{task.description}"), BarColumn(), TextColumn("{task.percentage:.0f} %, left"),
        TimeRemainingColumn(), console=console, disable=not console.is_terminal,
    )  # fmt: skip


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
            "caterpillar COMMAND --help tells its options, caterpillar --version the version.",
        ]
    )
