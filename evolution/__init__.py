"""Evolution of body and gait: the genetic algorithm of Saunders et al. (2009), and others.

The public API::

    from evolution import GaConfig, RunConfig, evolve, load

    history = evolve(RunConfig(ga=GaConfig(population=30)), "runs/mine")
    history = load("runs/mine")
    print(history.best_robot, history.table())
"""

from importlib import import_module as _import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from evolution.config import RunConfig
    from evolution.genome import Encoding
    from evolution.optimizers.cma_es import CmaConfig
    from evolution.optimizers.ga import GaConfig
    from evolution.optimizers.shade import ShadeConfig
    from evolution.run.cluster import RayEvaluator
    from evolution.run.evaluators import LocalEvaluator, evaluate
    from evolution.run.history import Generation, History, load
    from evolution.run.loop import evolve, resume

__all__ = [
    "CmaConfig",
    "Encoding",
    "GaConfig",
    "Generation",
    "History",
    "LocalEvaluator",
    "RayEvaluator",
    "RunConfig",
    "ShadeConfig",
    "evaluate",
    "evolve",
    "load",
    "resume",
]

_MODULES = {
    "CmaConfig": "optimizers.cma_es",
    "Encoding": "genome",
    "GaConfig": "optimizers.ga",
    "Generation": "run.history",
    "History": "run.history",
    "LocalEvaluator": "run.evaluators",
    "RayEvaluator": "run.cluster",
    "RunConfig": "config",
    "ShadeConfig": "optimizers.shade",
    "evaluate": "run.evaluators",
    "evolve": "run.loop",
    "load": "run.history",
    "resume": "run.loop",
}


def __getattr__(name: str) -> Any:
    """Import public names on first use, because their modules take a second to import."""
    if name not in _MODULES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(_import_module(f"{__name__}.{_MODULES[name]}"), name)
