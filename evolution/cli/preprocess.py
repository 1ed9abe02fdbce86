"""`caterpillar preprocess`."""

from __future__ import annotations

import json
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from rich.table import Table

from caterpillar_env.files import ELSEWHERE
from caterpillar_env.gait import GAIT_PERIOD_S
from caterpillar_env.physics import Physics
from evolution import cli
from evolution.genome import Encoding, GenomeKind, Timing
from evolution.priors import Control, Prior, Without, make_priors, searches
from evolution.priors.distributions import Clipping
from evolution.priors.preprocessor import Contradictions, GenePrior, Search


@dataclass(frozen=True)
class PreprocessArgs:
    """Print and plot the distribution of each gene, and print the maximum of each design parameter.

    The defaults reproduce Table I of the paper. `--timing wave --prior body+gait` adds the design
    parameters of the gait, K_4 and K_5.
    """

    json: bool = False
    """Print JSON instead of tables, with values in SI units."""
    out: Path = Path("preprocess.png")
    """File for the plot of the densities: .png, .svg or .pdf. With the K_i stroke and advance, a second
    plot, NAME-gait, is written beside it."""
    genome: GenomeKind = "shared"
    """Kind of genome. full: gait genes for every spring; per-segment: body genes for every segment."""
    timing: Timing = "on-off"
    """Gait genes. on-off: times, as in the paper; phase: delays, duties; wave: lag, offset, duties."""
    prior: Prior = "body"
    """Genes with a distribution from the preprocessor. body: as in the paper."""
    control: Control = "none"
    """Deliberately misleading prior. mirrored: peaks reflected; shuffled: distributions permuted,
    as in a run with the seed 0."""
    without: Without = "none"
    """Name of a design parameter to leave out, such as "lifting moment"."""
    contradictions: Contradictions = "uniform"
    """Prior of a gene on which two design parameters disagree. product: a Gaussian with its peak where
    the product of the design parameters is largest."""
    floor_ratio: float = 3.0
    """Ratio of the maximum to the minimum density of a Gaussian prior; 3 in the paper."""
    clipping: Clipping = "truncated"
    """How a Gaussian is limited to the bounds of its gene."""
    gait_period_s: float = GAIT_PERIOD_S
    """Gait period in s, a multiple of 0.1. It is the upper bound of the on and off times."""
    num_segments: int = 4
    """Number of segments of the robot."""


def preprocess_command(argv: Sequence[str]) -> int:
    """Show the distribution that the preprocessor gives to each gene."""
    from evolution.report import figures

    args = cli.parse(PreprocessArgs, argv, "preprocess")
    physics = Physics(num_segments=args.num_segments)
    encoding = Encoding(physics, args.gait_period_s, args.genome, args.timing)
    priors = make_priors(
        encoding,
        args.prior,
        floor_ratio=args.floor_ratio,
        clipping=args.clipping,
        contradictions=args.contradictions,
        control=args.control,
        without=args.without,
    )
    found = searches(encoding, args.prior, args.without)
    if args.json:
        print(json.dumps([prior.to_dict() for prior in priors], indent=2))
    else:
        cli.print_table(_make_table(priors, found), width=160)
        if found:
            cli.print_table(_make_search_table(found), width=160)
    drawings = {args.out: figures.densities(priors)}
    if {"stroke", "advance"} <= {search.parameter.name for search in found}:
        drawings[args.out.with_stem(f"{args.out.stem}-gait")] = figures.gait_search(found)
    for path, figure in drawings.items():
        figures.save(figure, path, ELSEWHERE)
    print(f"plots written to {' and '.join(map(str, drawings))}", file=sys.stderr)
    return 0


def _make_table(priors: Sequence[GenePrior], found: Sequence[Search]) -> Table:
    names = [search.parameter.name for search in found]
    title = "Distributions of the genes"
    table = Table("gene", "range", *names, "mu", "sigma", "reason", title=title, title_justify="left")
    table.caption = "+ and -: the K_i is largest at high or low values; o: circular gene"
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
            *({1: "+", -1: "-", 0: "o"}[signs[name]] if name in signs else "" for name in names),
            mu or "uniform",
            sigma,
            prior.reason,
        )
    return table


def _make_search_table(found: Sequence[Search]) -> Table:
    table = Table("K_i", "source", "best node", "maximum", "minimum on the grid", title_justify="left")
    table.title = "Maximum of each K_i on the grid"
    for search in found:
        k, places = search.parameter, []
        for gene, nodes, node in zip(search.genes, search.nodes, search.best, strict=True):
            factor, unit = gene.shown
            name = gene.parameter.removesuffix(f"_{gene.unit}").replace("_", " ")
            places.append(f"{name} {factor * nodes[node]:.3g} {unit}")
        best, least = search.values[search.best], search.values.min()
        table.add_row(k.name, k.source, ", ".join(places), f"{best:.3g} {k.unit}", f"{least:.3g}")
    return table
