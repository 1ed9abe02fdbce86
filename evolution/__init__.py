"""Evolution of body and gait: genomes, optimizers, runs with a record, and studies of many runs.

A genome's way: `genome` (what it stands for), `distributions` and `preprocessor` (what it is drawn
from), `optimizers`, `fitness` and `evaluators` (what becomes of it), `journal`, `run`, `individual`.
`config` says what a run computes; `records`, `plots`, `video` and `run_report` show it; `commands` are
its subcommands.
"""
