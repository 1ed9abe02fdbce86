"""The subcommand `rl`, where stable-baselines3 may not be installed."""

from __future__ import annotations

import sys
from collections.abc import Callable, Sequence
from importlib import import_module

from caterpillar_env.errors import CaterpillarError

_NAMES = ("train", "eval", "compare")
_USAGE = """usage: caterpillar rl {train,eval,compare} [OPTIONS]

commands:
  train    train a policy, within a budget of simulated seconds
  eval     let a trained policy crawl, on other ground too
  compare  put trainings side by side: a table and learning curves

caterpillar rl COMMAND --help tells the options of one."""


def rl_command(argv: Sequence[str]) -> int:
    """`caterpillar rl`."""
    name, *rest = argv or [""]
    if name in ("-h", "--help"):
        print(_USAGE)
        return 0
    if name not in _NAMES:
        what = f"no command {name!r}" if name else "a command is missing"
        known = ", ".join(_NAMES)
        print(
            f"caterpillar rl: error: {what}; choose from {known} (see caterpillar rl --help)",
            file=sys.stderr,
        )
        return 2
    try:
        import sb3_contrib  # noqa: F401
        import yaml  # noqa: F401
    except ImportError:
        raise CaterpillarError(
            "reinforcement learning needs stable-baselines3: pip install 'caterpillar-sma[rl]'"
        ) from None
    command: Callable[[Sequence[str]], int] = getattr(
        import_module(f"baselines.cli.{name}"), f"{name}_command"
    )
    try:
        return command(rest)
    except CaterpillarError as error:
        print(f"caterpillar rl {name}: error: {error}", file=sys.stderr)
        return 1
