"""The subcommand `view`, where viser may not be installed."""

from __future__ import annotations

import sys
import threading
import webbrowser
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

from caterpillar_env.errors import CaterpillarError
from caterpillar_env.robot import Robot
from evolution import cli
from evolution.viewer.session import nominal_robot


@dataclass(frozen=True)
class ViewArgs:
    """See a robot crawl in the browser, and change it by hand meanwhile. Ctrl-C ends it."""

    source: Annotated[Path | None, tyro.conf.Positional] = None
    """A run folder, or the JSON file of one robot (best.json); by default the nominal body."""
    port: int = 8080
    """Port of 127.0.0.1 to serve the page on; 0 for any free one."""
    open: bool = False
    """Open the page in the browser."""


def view_command(argv: Sequence[str]) -> int:
    """Watch a robot crawl in the browser, and change it by hand."""
    args = cli.parse(ViewArgs, argv, "view")
    individual = nominal_robot() if args.source is None else Robot.load(args.source)
    try:
        import viser  # noqa: F401
    except ImportError:
        raise CaterpillarError("the viewer needs viser: pip install 'caterpillar-sma[view]'") from None
    from evolution.viewer.server import Viewer

    with Viewer(individual, args.port) as viewer:
        print(f"{viewer.url} shows {args.source or 'the nominal robot'}; Ctrl-C ends it", flush=True)
        if args.open and not webbrowser.open(viewer.url):
            print("no browser found; open the page yourself", file=sys.stderr)
        threading.Event().wait()
    return 0
