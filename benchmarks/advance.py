"""Compare K_5 with the simulator: `python -m benchmarks.advance`. Takes a few minutes.

Prints Spearman's correlation between the advance that K_5 predicts and the distance that robots crawl in
30 s, for random waves in the nominal body and in random bodies. Robots that fail count with the distance
until then.
"""

from __future__ import annotations

import numpy as np
from scipy.stats import spearmanr

from caterpillar_env.gait import GAIT_PERIOD_S
from caterpillar_env.morphology import NAMES, Morphology
from evolution.genome import Encoding
from evolution.priors.gait import gait_parameters
from evolution.run.evaluators import evaluate

WAVES = 200
DUTY = (0.05, 0.5)  #: range of the duty of all pairs


def main() -> None:
    """Print the correlation for both sets of bodies."""
    encoding = Encoding(timing="wave")
    _, advance = gait_parameters(encoding.physics, GAIT_PERIOD_S)
    for bodies in ("nominal body", "random bodies"):
        rng = np.random.default_rng(42)
        genomes = rng.random((WAVES, len(encoding.genes)))
        upper = encoding.genes[-1].upper
        genomes[:, -3] = genomes[:, -1] = rng.uniform(*DUTY, WAVES) / upper
        if bodies == "nominal body":
            genomes[:, : len(NAMES)] = Morphology().to_unit()
        lag, duty, offset, _ = encoding.values(genomes)[:, -4:].T
        predicted_m = advance.formula(lag, offset, duty)
        crawled = evaluate(genomes, encoding)
        correlation = spearmanr(predicted_m, crawled.distance_m).statistic
        best = np.argsort(predicted_m)[-WAVES // 10 :]
        shares = [1000 * np.median(d) for d in (crawled.fitness(), crawled.fitness()[best])]
        print(
            f"{bodies}: Spearman's correlation {correlation:.2f} over {WAVES} waves; median distance "
            f"{shares[0]:.0f} mm, of the tenth with the largest K_5 {shares[1]:.0f} mm"
        )


if __name__ == "__main__":
    main()
