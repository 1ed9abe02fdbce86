"""The subcommand `rl`, where stable-baselines3 may not be installed."""

from __future__ import annotations

from collections.abc import Sequence

from caterpillar_env.errors import CaterpillarError

_USAGE = "usage: caterpillar rl {train,eval} [OPTIONS] (caterpillar rl train --help)"


def rl_command(argv: Sequence[str]) -> int:
    """`caterpillar rl`."""
    name, *rest = argv or [""]
    if name in ("-h", "--help"):
        print(_USAGE)
        return 0
    if name not in ("train", "eval"):
        raise CaterpillarError(f"choose from train, eval; got {name or 'nothing'}")
    try:
        import sb3_contrib  # noqa: F401
    except ImportError:
        raise CaterpillarError(
            "reinforcement learning needs stable-baselines3: pip install 'caterpillar-sma[rl]'"
        ) from None
    from baselines import subcommands

    return subcommands.train_command(rest) if name == "train" else subcommands.eval_command(rest)
