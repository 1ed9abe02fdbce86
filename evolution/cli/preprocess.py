"""`caterpillar preprocess`."""

from __future__ import annotations

import json
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from rich.console import Console
from rich.table import Table

from caterpillar_env.files import writing
from caterpillar_env.gait import GAIT_PERIOD_S
from caterpillar_env.physics import Physics
from evolution import cli
from evolution.genome import Encoding, GenomeKind
from evolution.priors.distributions import Clipping
from evolution.priors.preprocessor import GenePrior, design_parameters, paper_priors
from evolution.report import figures


@dataclass(frozen=True)
class PreprocessArgs:
    """Print the preprocessor's distribution of each gene (Table I) and plot the densities."""

    json: bool = False
    """Print JSON instead of a table: gene, kind, mu, sigma, lower, upper, reason."""
    out: Path = Path("preprocess.png")
    """File for the plot of the densities: .png, .svg or .pdf."""
    genome: GenomeKind = "shared"
    """full: times of every spring; per-segment: a body for every segment."""
    floor_ratio: float = 3.0
    """Highest over lowest density of a Gaussian gene; 3 in the paper ("one third")."""
    clipping: Clipping = "truncated"
    """Treatment of Gaussians beyond the bounds: cut off, or moved to the bound."""
    mirrored: bool = False
    """Move every peak to the opposite end, for a misleading prior."""
    gait_period_s: float = GAIT_PERIOD_S
    """Period of the gait in s, a multiple of 0.1; the upper bound of on and off times."""
    num_segments: int = 4
    """Number of segments of the robot."""


def preprocess_command(argv: Sequence[str]) -> int:
    """Show the mutation distribution that the preprocessor gives to each gene."""
    args = cli.parse(PreprocessArgs, argv, "preprocess")
    encoding = Encoding(Physics(num_segments=args.num_segments), args.gait_period_s, args.genome)
    priors = paper_priors(encoding, args.floor_ratio, args.clipping, mirrored=args.mirrored)
    if args.json:
        print(json.dumps([prior.to_dict() for prior in priors], indent=2))
    else:
        Console(width=None if sys.stdout.isatty() else 160).print(
            _table(priors, [k.name for k in design_parameters(encoding.physics)])
        )
    with writing(args.out):
        figures.save(figures.densities(priors), args.out)
    print(f"densities plotted in {args.out}", file=sys.stderr)
    return 0


def _table(priors: Sequence[GenePrior], names: Sequence[str]) -> Table:
    table = Table(title="Mutation distributions (Saunders 2009, Table I)", title_justify="left")
    for heading in ("gene", "range", *names, "mu", "sigma", "reason"):
        table.add_column(heading, no_wrap=heading == "gene")
    for prior in priors:
        gene, data, signs = prior.gene, prior.to_dict(), dict(prior.signs)
        table.add_row(
            gene.name,
            f"{gene.lower:g} - {gene.upper:g}",
            *({1: "+", -1: "-", 0: ""}[signs.get(name, 0)] for name in names),
            "uniform" if data["mu"] is None else f"{data['mu']:.4g}",
            "" if data["sigma"] is None else f"{data['sigma']:.4g}",
            prior.reason,
        )
    return table
