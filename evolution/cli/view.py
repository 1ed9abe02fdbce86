"""`caterpillar view`: shows a robot in the browser."""

from __future__ import annotations

import sys
import threading
import webbrowser
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import tyro

from caterpillar_env.errors import CaterpillarError
from caterpillar_env.robot import Robot, wave_robot
from evolution import cli
from evolution.run.history import History
from evolution.run.journal import FILE as JOURNAL


@dataclass(frozen=True)
class ViewArgs:
    """Watch a robot crawl in the browser, and change it by hand. Ctrl-C ends the server."""

    source: Annotated[Path | None, tyro.conf.Positional] = None
    """Run folder, or JSON file of one robot (best.json); default: the nominal robot."""
    timing: Literal["on-off", "phase"] | None = None
    """Sliders of the gait. on-off: on and off times; phase: delays and duties. By default, as in the
    run; on-off for a JSON file."""
    port: int = 8080
    """Port of 127.0.0.1 for the page; if it is in use, the next free port. 0 means any free port."""
    open: bool = False
    """Open the page in the browser."""

    def __post_init__(self) -> None:
        if not 0 <= self.port < 2**16:
            raise CaterpillarError(f"port = {self.port} must be an integer from 0 to {2**16 - 1}")


def view_command(argv: Sequence[str]) -> int:
    """Watch a robot crawl in the browser, and change it by hand."""
    args = cli.parse(ViewArgs, argv, "view")
    robot = wave_robot() if args.source is None else Robot.load(args.source)
    timing = args.timing or _find_timing(args.source)
    try:
        import viser  # noqa: F401
    except ImportError:
        raise CaterpillarError("the viewer needs viser: pip install 'caterpillar-sma[view]'") from None
    from evolution.viewer.server import Viewer

    with Viewer(robot, args.port, timing) as viewer:
        print(f"{viewer.url} shows {args.source or 'the nominal robot'}; stop with Ctrl-C", flush=True)
        if args.open and not webbrowser.open(viewer.url):
            print(f"no browser was found; open {viewer.url} yourself", file=sys.stderr)
        threading.Event().wait()
    return 0


def _find_timing(source: Path | None) -> Literal["on-off", "phase"]:
    """Return the sliders that match the gait genes of a run."""
    if source is None or not (source / JOURNAL).is_file():
        return "on-off"
    return "on-off" if History.read(source).config.timing == "on-off" else "phase"
