"""The main loop: ask for genomes, evaluate and record them, and tell the optimizer their fitness.

A run is resumed by replaying it: a new optimizer proposes the same genomes again, and the journal
supplies the outcomes of genomes that were evaluated before.
"""

from __future__ import annotations

import math
import shlex
from collections.abc import Callable, Sequence
from contextlib import closing
from pathlib import Path
from typing import Any

from caterpillar_env.arrays import Array
from caterpillar_env.errors import CaterpillarError, check_number
from caterpillar_env.files import make_folder
from evolution.config import RunConfig
from evolution.objective import Objective, score
from evolution.optimizers.base import Optimizer
from evolution.run.evaluators import Evaluator, Job, LocalEvaluator, OnProgress, run_jobs
from evolution.run.history import Generation, History
from evolution.run.journal import Journal, fingerprint
from evolution.run.racing import race


def evolve(
    config: RunConfig,
    folder: Path | str,
    *,
    evaluator: Evaluator | None = None,
    optimizer: Optimizer | None = None,
    objective: Objective | None = None,
    on_generation: Callable[[Generation], None] | None = None,
    on_progress: OnProgress | None = None,
) -> History:
    """Run an optimizer and record the run in a new folder.

    The folder receives `journal.sqlite`, written as evaluations finish, and `best.json`, written
    whenever the best robot changes. A KeyboardInterrupt stops the run; `resume` continues it.

    Args:
        config: configuration of the run.
        folder: run folder. It is created if needed, and must be empty.
        evaluator: evaluates the genomes; by default, a `LocalEvaluator` that uses all cores.
        optimizer: your own optimizer instead of `config.optimizer`, see
            `evolution.optimizers.base.Optimizer`.
        objective: your own objective instead of `config.objective`. Takes the `Outcomes` of P robots and
            returns P finite numbers, shape (P,). Higher is better. Robots that failed receive
            `config.failed_fitness` instead.
        on_generation: called with a summary of each completed generation.
        on_progress: called with the share of the current generation that is evaluated, in [0, 1].

    Returns:
        The history of the run. `history.finished` is False if the run was stopped.

    Raises:
        CaterpillarError: the folder is not empty or cannot be written, the optimizer proposed an invalid
            genome, or your own objective returned a wrong shape or non-finite values.
    """
    folder = Path(folder)
    own = {"own_optimizer": _name(optimizer), "own_objective": _name(objective)}
    # If the next two lines fail, no folder is made.
    optimizer = config.make_optimizer() if optimizer is None else optimizer
    with LocalEvaluator() if evaluator is None else evaluator as workers:
        make_folder(
            folder,
            f", or continue the existing run with `caterpillar resume {shlex.quote(str(folder))}`",
        )
        with Journal.create(folder, config.to_dict() | own) as journal:
            history = History(journal, objective)
            return _run(history, optimizer, workers, on_generation, on_progress)


def resume(
    folder: Path | str,
    *,
    generations: int | None = None,
    budget_s: float | None = None,
    evaluator: Evaluator | None = None,
    optimizer: Optimizer | None = None,
    objective: Objective | None = None,
    on_generation: Callable[[Generation], None] | None = None,
    on_progress: OnProgress | None = None,
    on_warning: Callable[[str], None] | None = None,
) -> History:
    """Continue a run. A finished run is only replayed, unless an argument makes it longer.

    Args:
        folder: run folder.
        generations: new total number of generations, to make the run longer.
        budget_s: new total budget in simulated seconds; not below both the former budget and the
            time that was simulated.
        evaluator: see `evolve`.
        optimizer: your own optimizer in its initial state, if the run used one.
        objective: your own objective, if the run used one.
        on_generation: see `evolve`; also called for replayed generations.
        on_progress: see `evolve`.
        on_warning: called with warnings about changes that may alter the result.

    Raises:
        JournalError: the journal cannot be opened, see `Journal`.
        CaterpillarError: the optimizer proposes genomes that differ from those in the journal, or your
            own optimizer or objective is missing, or the run did not use one.
    """
    with Journal(Path(folder)) as journal:
        history = History(journal, objective)
        given = {"optimizer": optimizer, "objective": objective}
        for what, name in (("optimizer", history.own_optimizer), ("objective", history.own_objective)):
            if name is not None and given[what] is None:
                raise CaterpillarError(
                    f"{folder} was run with your own {what} ({name}); resume the run in Python with "
                    f"evolution.resume(folder, {what}=...)"
                )
            if name is None and given[what] is not None:
                raise CaterpillarError(
                    f"{folder} was run without your own {what}; resume the run without {what}=..., or "
                    "start a new run"
                )
        if generations is not None:
            generations = check_number("generations", generations, 1, whole=True)
        if generations is not None and generations < history.config.generations:
            raise CaterpillarError(
                f"a run can only be made longer: it has {history.config.generations} generations, "
                f"and generations = {generations} is fewer"
            )
        if budget_s is not None:
            budget_s = check_number("budget_s", budget_s, 0)
            spent_s = sum(e.simulated_s for e in history.evaluations)
            if budget_s < min(history.config.budget_s or math.inf, spent_s):
                raise CaterpillarError(
                    f"a run can only be made longer: it has simulated {spent_s:g} s, and budget_s = "
                    f"{budget_s:g} is less"
                )
        if on_warning is not None:
            warn_of_versions(history, on_warning)
        optimizer = history.config.make_optimizer() if optimizer is None else optimizer
        with LocalEvaluator() if evaluator is None else evaluator as workers:
            if generations is not None:  # only once the evaluator is available
                history.change(generations=generations)
            if budget_s is not None:
                history.change(budget_s=budget_s)
            return _run(history, optimizer, workers, on_generation, on_progress)


def _run(
    history: History,
    optimizer: Optimizer,
    evaluator: Evaluator,
    on_generation: Callable[[Generation], None] | None,
    on_progress: OnProgress | None,
) -> History:
    config, begun = history.config, False
    try:
        while history.stop_reason() is None:
            # A copy, because the optimizer may change its genomes in `tell`.
            genomes = config.encoding.check(optimizer.ask()).copy()
            if not len(genomes):
                raise CaterpillarError("the optimizer proposed no genomes; `ask` must return some")
            recorded = history.count_recorded(genomes)
            if not (begun or history.replaying):  # a replay that fails leaves the journal unchanged
                history.begin()
                begun = True
            _evaluate(history, genomes[recorded:], evaluator, on_progress)
            outcomes = history.complete()
            fitness = score(history.objective, outcomes, config.failed_fitness)
            optimizer.tell(genomes.copy(), fitness)
            if on_generation is not None:
                on_generation(history.generations[-1])
        if not begun:
            history.begin()
        history.finish()
    except KeyboardInterrupt:
        pass
    return history


def _evaluate(
    history: History, genomes: Array, evaluator: Evaluator, on_progress: OnProgress | None
) -> None:
    """Evaluate and record genomes (P, n), one chunk at a time."""
    config = history.config
    if not len(genomes):
        return
    if config.race_share < 1.0:
        history.append(genomes, race(genomes, config, history.objective, evaluator, on_progress))
        return
    jobs = [Job(chunk) for chunk in evaluator.split(genomes)]
    with closing(run_jobs(evaluator, config.encoding, jobs, on_progress)) as results:
        for job, result in zip(jobs, results, strict=True):
            history.append(job.genomes, result.outcomes)


def _name(part: Any) -> str | None:
    return None if part is None else getattr(part, "__qualname__", type(part).__qualname__)


def warn_of_versions(
    history: History, warn: Callable[[str], None], packages: Sequence[str] = ()
) -> None:
    """Call `warn` with each session that ran with other versions or on another type of machine.

    Args:
        history: history of the run.
        warn: function to call.
        packages: names of further packages to compare, see `fingerprint`.
    """
    now = fingerprint(packages)
    for session in history.sessions:
        then = session.fingerprint
        changes = [f"{k} {then.get(k)} (now {v})" for k, v in now.items() if then.get(k) != v]
        if changes:
            rows = [e.number for e in history.evaluations if e.session == session.number]
            which = f"evaluations {rows[0]} to {rows[-1]}" if rows else "no evaluations"
            warn(
                f"session {session.number} ({which}) ran with {', '.join(changes)}: results from here "
                "on may differ from those of a run with one set of versions"
            )
