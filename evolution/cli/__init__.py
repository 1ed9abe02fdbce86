"""The `caterpillar` command: it finds a subcommand, runs it, and reports errors in one line.

Each subcommand is an entry point of the group `caterpillar.commands`: a function that takes the
remaining arguments and returns an exit status. Other packages can add their own. The first line of the
function's docstring is its summary in `caterpillar --help`.
"""

from __future__ import annotations

import contextlib
import io
import signal
import sys
import threading
from collections.abc import Callable, Iterator, Mapping, Sequence
from importlib.metadata import entry_points, version
from typing import IO, TYPE_CHECKING, Any, TypeVar, cast

from caterpillar_env.errors import CaterpillarError

if TYPE_CHECKING:
    from pathlib import Path

    from rich.console import Console
    from rich.progress import Progress
    from rich.table import Table

    from caterpillar_env.drawing.video import Recording

T = TypeVar("T")
Command = Callable[[list[str]], int]
Commands = Mapping[str, Callable[[], Command]]  #: functions that load the commands, by name


def main(argv: Sequence[str] | None = None) -> int:
    """Run `caterpillar` and return its exit status (see `dispatch`)."""
    if isinstance(sys.stdout, io.TextIOWrapper):
        sys.stdout.reconfigure(errors="surrogateescape")  # for names of files that are not UTF-8
    arguments = list(sys.argv[1:] if argv is None else argv)
    if arguments[:1] == ["--version"]:
        print(version("caterpillar-sma"))
        return 0
    points = sorted(entry_points(group="caterpillar.commands"), key=lambda point: point.name)
    return dispatch({point.name: point.load for point in points}, arguments)


def dispatch(commands: Commands, arguments: Sequence[str], prog: str = "caterpillar") -> int:
    """Run the command that the first argument names, and pass it the other arguments.

    Args:
        commands: functions that load the commands, by name. Help loads all of them.
        arguments: name and arguments of the command.
        prog: program name for messages, such as "caterpillar rl".

    Returns:
        The exit status: 0, 1 (an error), 2 (wrong usage) or 130 (interrupted).
    """
    name, *rest = arguments or [""]
    if name in ("-h", "--help", "help"):
        print(_overview(commands, prog))
        return 0
    if name not in commands:
        problem = f"unknown command {name!r}" if name else "no command given"
        choices = ", ".join(commands)
        print(f"{prog}: error: {problem}; choose from {choices} (see {prog} --help)", file=sys.stderr)
        return 2
    try:
        with _stopping_on_signals():
            return commands[name]()(rest)
    except BrokenPipeError:
        return 1
    except (CaterpillarError, OSError) as error:
        with contextlib.suppress(OSError):  # the terminal was closed
            print(f"{prog} {name}: error: {CaterpillarError(str(error))}", file=sys.stderr)
        return 1
    except SystemExit as stop:  # from the parser: 0 after --help, 2 after wrong usage
        return int(stop.code or 0)
    except KeyboardInterrupt:
        with contextlib.suppress(OSError):
            print(f"{prog} {name}: stopped", file=sys.stderr)
        return 130


@contextlib.contextmanager
def _stopping_on_signals() -> Iterator[None]:
    """Let SIGTERM and SIGHUP stop a command as Ctrl-C does, unless they are ignored (nohup)."""
    before = {}
    if threading.current_thread() is threading.main_thread():
        for number in (signal.SIGTERM, signal.SIGHUP):
            if signal.getsignal(number) is signal.SIG_DFL:
                before[number] = signal.signal(number, signal.default_int_handler)
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


def parse(kind: type[T], argv: Sequence[str], command: str, default: T | None = None) -> T:
    """Create a dataclass from command-line flags.

    Args:
        kind: the dataclass. Its fields become flags, and the docstrings of the fields become help texts.
        argv: arguments of the command.
        command: name of the command for messages, such as "evolve" or "rl train".
        default: values of flags that are not given; None uses the defaults of the dataclass.

    Raises:
        SystemExit: with status 0 after `--help`, and with status 2 after reporting wrong usage.
    """
    import tyro

    messages = io.StringIO()
    try:
        with contextlib.redirect_stderr(messages):
            return tyro.cli(
                kind,
                prog=f"caterpillar {command}",
                args=list(argv),
                default=tyro.MISSING_NONPROP if default is None else default,
                config=(tyro.conf.OmitArgPrefixes, tyro.conf.DisallowNone),
                registry=_make_registry(),
            )
    except SystemExit as stop:
        error = _find_own_error(stop)
        text = messages.getvalue() if error is None else f"caterpillar {command}: error: {error}\n"
        sys.stderr.write(text)
        raise


def _make_registry() -> Any:
    """Return the rule that reads a world from one argument, such as "slope:angle_deg=5"."""
    from tyro.constructors import ConstructorRegistry, PrimitiveConstructorSpec, PrimitiveTypeInfo

    from caterpillar_env.worlds import WORLDS, World

    registry = ConstructorRegistry()

    @registry.primitive_rule
    def read_world(info: PrimitiveTypeInfo) -> PrimitiveConstructorSpec[World] | None:
        if info.type is not World:
            return None
        return PrimitiveConstructorSpec(
            nargs=1,
            metavar="{" + ",".join(WORLDS) + "}[:FIELD=VALUE,...]",
            instance_from_str=lambda words: World.of(words[0]),
            is_instance=lambda value: isinstance(value, World),
            str_from_instance=lambda world: [str(world)],
        )

    return registry


def _find_own_error(stop: SystemExit) -> CaterpillarError | None:
    """Return the error of a dataclass that rejected its values, or None if the parser failed."""
    error: BaseException | None = stop
    while error is not None and not isinstance(error, CaterpillarError):
        error = error.__context__
    return error


def _overview(commands: Commands, prog: str) -> str:
    width = max(map(len, commands), default=0)
    lines = [f"  {name:<{width}}  {_summary(load)}" for name, load in commands.items()]
    return (
        f"usage: {prog} COMMAND [OPTIONS]\n\ncommands:\n"
        + "\n".join(lines)
        + f"\n\nRun {prog} COMMAND --help for the options of a command."
    )


def _summary(load: Callable[[], Command]) -> str:
    try:
        text = load().__doc__ or ""
    except (ImportError, CaterpillarError) as error:
        return f"cannot be loaded: {error}"
    return text.strip().partition("\n")[0]


def console() -> Console:
    """Return a console on stderr for progress and messages, without markup or line wrapping."""
    from rich.console import Console

    file = cast(IO[str], _Progress(sys.stderr or io.StringIO()))  # None if stderr is closed
    return Console(file=file, markup=False, highlight=False, soft_wrap=True)


class _Progress:
    """A stream that ignores errors, so that a closed terminal does not end a run."""

    def __init__(self, stream: IO[str]) -> None:
        self._stream = stream

    def __getattr__(self, name: str) -> Any:
        return getattr(self._stream, name)

    def write(self, text: str) -> int:
        with contextlib.suppress(OSError):
            self._stream.write(text)
        return len(text)

    def flush(self) -> None:
        with contextlib.suppress(OSError):
            self._stream.flush()


def bar(console: Console) -> Progress:
    """Return a progress bar with percentage and time left. It is shown on terminals only."""
    from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn

    return Progress(
        TextColumn("{task.description}"), BarColumn(), TextColumn("{task.percentage:.0f} %, time left"),
        TimeRemainingColumn(), console=console, disable=not console.is_terminal,
        speed_estimate_period=300.0,  # seconds; uses the last 1000 updates at most
    )  # fmt: skip


def time_left(bar: Progress, console: Console) -> str:
    """Return the estimated time left for a line of text, or "" on a terminal, where the bar shows it."""
    left_s = bar.tasks[0].time_remaining
    if console.is_terminal or not left_s:
        return ""
    return f", {left_s:.0f} s left" if left_s < 120 else f", {left_s / 60:.0f} min left"


def print_table(table: Table, width: int = 150) -> None:
    """Print a table to stdout: as wide as the terminal, or with `width` characters in a file or pipe."""
    from rich.console import Console

    Console(width=None if sys.stdout.isatty() else width, markup=False).print(table)


def film(recording: Recording, path: Path, console: Console) -> None:
    """Write a video. If this fails, print the reason instead."""
    from caterpillar_env.drawing.video import write_video

    console.print(f"writing {path} ...")
    try:
        write_video([recording], path)
    except CaterpillarError as error:
        console.print(f"no video: {error}")
