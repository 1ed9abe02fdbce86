"""Evolve the body and gait of a crawling robot, as in Saunders et al. (2009) or with other optimizers.

The public API::

    from evolution import GaConfig, RunConfig, evolve, load

    history = evolve(RunConfig(ga=GaConfig(population=30)), "runs/mine")
    history = load("runs/mine")
    print(history.best_robot, history.table())
"""

from importlib import import_module as _import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from evolution.config import RunConfig as RunConfig
    from evolution.genome import Encoding as Encoding
    from evolution.optimizers.cma_es import CmaConfig as CmaConfig
    from evolution.optimizers.ga import GaConfig as GaConfig
    from evolution.optimizers.shade import ShadeConfig as ShadeConfig
    from evolution.run.cluster import RayEvaluator as RayEvaluator
    from evolution.run.evaluators import LocalEvaluator as LocalEvaluator
    from evolution.run.evaluators import evaluate as evaluate
    from evolution.run.history import Generation as Generation
    from evolution.run.history import History as History
    from evolution.run.history import load as load
    from evolution.run.loop import evolve as evolve
    from evolution.run.loop import resume as resume

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
__all__ = list(_MODULES)


def __getattr__(name: str) -> Any:
    """Import public names on first use, because their modules take a second to import."""
    if name not in _MODULES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(_import_module(f"{__name__}.{_MODULES[name]}"), name)
