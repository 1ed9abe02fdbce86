"""`caterpillar preprocess`."""

from __future__ import annotations

import json
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from rich.table import Table

from caterpillar_env.files import writing
from caterpillar_env.gait import GAIT_PERIOD_S
from caterpillar_env.physics import Physics
from evolution import cli
from evolution.genome import Encoding, GenomeKind
from evolution.priors.distributions import Clipping
from evolution.priors.preprocessor import GenePrior, design_parameters, paper_priors


@dataclass(frozen=True)
class PreprocessArgs:
    """Print Table I of the paper: the mutation distribution of each gene. Plot the densities."""

    json: bool = False
    """Print JSON instead of a table, with values in SI units."""
    out: Path = Path("preprocess.png")
    """File for the plot of the densities: .png, .svg or .pdf."""
    genome: GenomeKind = "shared"
    """Kind of genome. full: separate times for every spring; per-segment: a body for every segment."""
    floor_ratio: float = 3.0
    """Ratio of the largest to the smallest density of a preprocessed gene; 3 in the paper."""
    clipping: Clipping = "truncated"
    """How a Gaussian is limited to the bounds of its gene."""
    mirrored: bool = False
    """Put every peak at the opposite bound, which gives a deliberately misleading prior."""
    gait_period_s: float = GAIT_PERIOD_S
    """Gait period in s, a multiple of 0.1. It is the upper bound of the on and off times."""
    num_segments: int = 4
    """Number of segments of the robot."""


def preprocess_command(argv: Sequence[str]) -> int:
    """Show the mutation distribution that the preprocessor gives to each gene."""
    from evolution.report import figures

    args = cli.parse(PreprocessArgs, argv, "preprocess")
    encoding = Encoding(Physics(num_segments=args.num_segments), args.gait_period_s, args.genome)
    priors = paper_priors(encoding, args.floor_ratio, args.clipping, mirrored=args.mirrored)
    if args.json:
        print(json.dumps([prior.to_dict() for prior in priors], indent=2))
    else:
        names = [parameter.name for parameter in design_parameters(encoding.physics)]
        cli.print_table(_make_table(priors, names), width=160)
    with writing(args.out):
        figures.save(figures.densities(priors), args.out)
    print(f"densities plotted in {args.out}", file=sys.stderr)
    return 0


def _make_table(priors: Sequence[GenePrior], names: Sequence[str]) -> Table:
    title = "Mutation distributions (Saunders 2009, Table I)"
    table = Table("gene", "range", *names, "mu", "sigma", "reason", title=title, title_justify="left")
    for prior in priors:
        factor, unit = prior.gene.shown
        data, signs = prior.to_dict(), dict(prior.signs)
        mu, sigma = (
            "" if data[name] is None else f"{factor * float(data[name] or 0.0):.4g}"
            for name in ("mu", "sigma")
        )
        table.add_row(
            prior.gene.title,
            f"{factor * prior.gene.lower:.4g} to {factor * prior.gene.upper:.4g} {unit}",
            *({1: "+", -1: "-", 0: ""}[signs.get(name, 0)] for name in names),
            mu or "uniform",
            sigma,
            prior.reason,
        )
    return table
