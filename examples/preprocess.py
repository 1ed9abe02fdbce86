"""Plot the distribution that the preprocessor gives to one gene, and samples from it."""

import numpy as np
from matplotlib.figure import Figure

from evolution import RunConfig

GENE = "attachment_z_m"

config = RunConfig()
index = [gene.name for gene in config.encoding.genes].index(GENE)
gene, prior = config.encoding.genes[index], config.distributions()[index]
unit = np.linspace(0, 1, 201)
samples = prior.sample(np.random.default_rng(0), 2000)

figure = Figure(figsize=(6, 3), layout="constrained")
axis = figure.subplots()
width_mm = 1000 * (gene.upper - gene.lower)
axis.hist(1000 * gene.value(samples), bins=20, density=True, alpha=0.3, label="2,000 samples")
axis.plot(1000 * gene.value(unit), prior.density(unit) / width_mm, label="density")
axis.set(xlabel=f"{GENE.removesuffix('_m').replace('_', ' ')}, mm", ylabel="density, 1/mm")
axis.legend()
figure.savefig("prior.png", dpi=120)
print(f"{GENE}: {prior}; see prior.png")
