"""`caterpillar rl`, with one module per subcommand. The modules require stable-baselines3."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from importlib import import_module

from caterpillar_env.errors import CaterpillarError
from evolution import cli


def rl_command(argv: Sequence[str]) -> int:
    """Train policies by reinforcement learning, evaluate them, and compare training runs."""
    commands = {name: partial(_load, name) for name in ("train", "resume", "eval", "compare")}
    return cli.dispatch(commands, argv, "caterpillar rl")


def _load(name: str) -> Callable[[Sequence[str]], int]:
    try:
        import stable_baselines3  # noqa: F401
        import yaml  # noqa: F401
    except ImportError:
        raise CaterpillarError(
            "reinforcement learning needs stable-baselines3: pip install 'caterpillar-sma[rl]'"
        ) from None
    command: Callable[[Sequence[str]], int] = getattr(
        import_module(f"baselines.cli.{name}"), f"{name}_command"
    )
    return command
