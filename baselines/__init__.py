"""Reinforcement learning baselines for comparison with evolution. They require the extra `rl`."""
