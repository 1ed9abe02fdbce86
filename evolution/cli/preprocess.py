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
from evolution.priors.distributions import Uniform
from evolution.priors.preprocessor import Clipping, GenePrior, design_parameters, paper_priors
from evolution.report import figures


@dataclass(frozen=True)
class PreprocessArgs:
    """Print Table I: what the preprocessor says of each gene, and draw the densities."""

    json: bool = False
    """Print JSON instead of a table: gene, kind, mu, sigma, lower, upper, reason."""
    out: Path = Path("preprocess.png")
    """File to draw the densities in: .png, .svg, .pdf."""
    genome: GenomeKind = "shared"
    """full: times of every spring; per-segment: a body for every segment."""
    floor_ratio: float = 3.0
    """Greatest over least density of a preprocessed gene; the paper's third is 3."""
    clipping: Clipping = "truncated"
    """What becomes of a Gaussian beyond the bounds of its gene."""
    mirrored: bool = False
    """Every peak at the opposite end: the prior that misleads on purpose."""
    gait_period_s: float = GAIT_PERIOD_S
    """Period of the gait in s, a whole multiple of 0.1; on and off times end with it."""
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
    print(f"densities drawn in {args.out}", file=sys.stderr)
    return 0


def _table(priors: Sequence[GenePrior], names: Sequence[str]) -> Table:
    table = Table(title="Mutation distributions (Saunders 2009, Table I)", title_justify="left")
    for heading in ("gene", "range", *names, "mu", "sigma", "reason"):
        table.add_column(heading, no_wrap=heading == "gene")
    for prior in priors:
        gene, data, signs = prior.gene, prior.to_dict(), dict(prior.signs)
        gaussian = not isinstance(prior.distribution, Uniform)
        table.add_row(
            gene.name,
            f"{gene.lower:g} - {gene.upper:g}",
            *({1: "+", -1: "-", 0: ""}[signs.get(name, 0)] for name in names),
            f"{data['mu']:.4g}" if gaussian else "uniform",
            f"{data['sigma']:.4g}" if gaussian else "",
            prior.reason,
        )
    return table
