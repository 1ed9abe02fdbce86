"""Reinforcement learning against evolution; see the extra `rl`."""
