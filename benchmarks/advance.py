"""Compare the predicted advance (K_5) with simulated distances: `python -m benchmarks.advance`.

Predicts the advance of 200 random waves, with duties of 5 to 50 %, in the nominal body and in random
bodies, and simulates the same robots for 30 s. Prints Spearman's correlation of advance and distance,
where robots that fail count with the distance before the failure. Also prints median distances, where
robots that fail count as 0. Takes a few minutes.
"""

from __future__ import annotations

import numpy as np
from scipy.stats import spearmanr

from caterpillar_env.morphology import NAMES, Morphology
from evolution.genome import Encoding
from evolution.priors.gait import advance
from evolution.run.evaluators import evaluate

WAVES = 200
DUTY = (0.05, 0.5)  #: range of the duty of all pairs


def main() -> None:
    """Print the correlation for both sets of bodies."""
    encoding = Encoding(timing="wave")
    for bodies in ("nominal body", "random bodies"):
        rng = np.random.default_rng(42)
        genomes = rng.random((WAVES, len(encoding.genes)))
        upper = encoding.genes[-1].upper
        genomes[:, -3] = genomes[:, -1] = rng.uniform(*DUTY, WAVES) / upper
        if bodies == "nominal body":
            genomes[:, : len(NAMES)] = Morphology().to_unit()
        predicted_m = advance(*encoding.decode(genomes), encoding.physics)
        crawled = evaluate(genomes, encoding)
        correlation = spearmanr(predicted_m, crawled.distance_m).statistic
        best = np.argsort(predicted_m)[-WAVES // 10 :]
        medians_mm = [1000 * np.median(d) for d in (crawled.fitness(), crawled.fitness()[best])]
        print(
            f"{bodies}: Spearman's correlation {correlation:.2f} over {WAVES} waves; median distance: "
            f"{medians_mm[0]:.0f} mm for all, {medians_mm[1]:.0f} mm for the 10 % with the largest K_5"
        )


if __name__ == "__main__":
    main()
