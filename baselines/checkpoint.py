"""Checkpoints of training runs: the weights, the optimizers, the replay buffer and the co-design.

The robots and the random generators are not stored. After every evaluation, they are reset with seeds
that depend on the number of the evaluation. A checkpoint holds tensors and numbers only: loading it runs
no code.
"""

from __future__ import annotations

import io
from hashlib import sha256
from pathlib import Path
from typing import Any

import torch
from stable_baselines3.common.base_class import BaseAlgorithm

from caterpillar_env.errors import CaterpillarError
from caterpillar_env.files import COPY, write_bytes

_DIGEST_BYTES = 32
_COLUMNS = ("observations", "next_observations", "actions", "rewards", "dones", "timeouts")


def path_of(folder: Path, number: int) -> Path:
    """Return the file of the checkpoint after an evaluation."""
    return folder / f"checkpoint-{number}.pt"


def save(folder: Path, number: int, model: BaseAlgorithm, more: dict[str, Any]) -> None:
    """Write the checkpoint after an evaluation.

    Args:
        folder: folder of the training run.
        number: number of the evaluation.
        model: algorithm between two rollouts.
        more: further values to store by name: tensors, numbers, or lists of these.

    Raises:
        CaterpillarError: the file cannot be written.
    """
    state: dict[str, Any] = {
        "parameters": model.get_parameters(),
        "steps": model.num_timesteps,
        "updates": getattr(model, "_n_updates", 0),
        "more": more,
    }
    if (buffer := getattr(model, "replay_buffer", None)) is not None:
        rows = buffer.buffer_size if buffer.full else buffer.pos
        columns = {name: torch.from_numpy(getattr(buffer, name)[:rows]) for name in _COLUMNS}
        state["buffer"] = {"pos": buffer.pos, "full": buffer.full, "columns": columns}
    stream = io.BytesIO()
    torch.save(state, stream)
    content = stream.getvalue()
    write_bytes(path_of(folder, number), sha256(content).digest() + content, COPY)


def load(folder: Path, number: int, model: BaseAlgorithm) -> dict[str, Any]:
    """Restore a new algorithm from the checkpoint after an evaluation. Return what `save` got as `more`.

    Raises:
        CaterpillarError: the file is missing, damaged, or of another algorithm.
    """
    path = path_of(folder, number)
    try:
        data = path.read_bytes()
        digest, content = data[:_DIGEST_BYTES], data[_DIGEST_BYTES:]
        if sha256(content).digest() != digest:
            raise ValueError("the digest differs")
        state = torch.load(io.BytesIO(content), weights_only=True)
        model.set_parameters(state["parameters"])
        model.num_timesteps, model._n_updates = state["steps"], state["updates"]
        if (buffer := getattr(model, "replay_buffer", None)) is not None:
            buffer.pos, buffer.full = state["buffer"]["pos"], state["buffer"]["full"]
            for name in _COLUMNS:
                column = state["buffer"]["columns"][name].numpy()
                getattr(buffer, name)[: len(column)] = column
        more: dict[str, Any] = state["more"]
    except Exception as error:  # damaged files raise errors of many kinds
        why = error.strerror if isinstance(error, OSError) else "it is damaged, or of another version"
        raise CaterpillarError(
            f"cannot resume from {path}: {why}; restore a copy of it, or train again in another folder"
        ) from None
    return more


def remove(folder: Path, keep: int | None = None) -> None:
    """Delete all checkpoints but the one after the evaluation `keep`."""
    for path in folder.glob("checkpoint-*.pt"):
        if keep is None or path != path_of(folder, keep):
            path.unlink(missing_ok=True)
