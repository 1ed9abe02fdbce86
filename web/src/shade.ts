import data from "./data.json";

const memorySize = 5;
const greediest = 0.2; // largest share of the population from which a target is drawn

/** Return a generator of numbers in [0, 1) with a seed (mulberry32), so that searches can be repeated. */
export function seeded(seed: number): () => number {
  let state = seed >>> 0;
  return () => {
    state = (state + 0x6d2b79f5) >>> 0;
    let mixed = Math.imul(state ^ (state >>> 15), state | 1);
    mixed ^= mixed + Math.imul(mixed ^ (mixed >>> 7), mixed | 61);
    return ((mixed ^ (mixed >>> 14)) >>> 0) / 2 ** 32;
  };
}

interface Trial {
  genome: number[];
  scale: number;
  rate: number;
}

/** SHADE (Tanabe and Fukunaga 2013), as `evolution.optimizers.shade` without priors and candidates. */
export class Shade {
  private genomes: number[][] = [];
  private fitness: number[] = [];
  private former: number[][] = [];
  private memory = Array.from({ length: memorySize }, () => ({ scale: 0.5, rate: 0.5 }));
  private oldest = 0;
  private trials: Trial[] = [];

  constructor(
    private readonly size: number,
    private readonly circular: boolean[],
    private readonly random: () => number,
  ) {}

  /** Return the genomes to evaluate next. There are twice as many in the first generation. */
  ask(): number[][] {
    if (this.genomes.length === 0) {
      return Array.from({ length: 2 * this.size }, () => this.circular.map(this.random));
    }
    const ranked = this.rank(this.fitness);
    this.trials = this.genomes.map((_, index) => this.mix(index, ranked));
    return this.trials.map((trial) => trial.genome);
  }

  /** Learn the fitness of the genomes of the last `ask`. */
  tell(genomes: number[][], fitness: number[]): void {
    if (this.genomes.length === 0) {
      const best = this.rank(fitness).slice(0, this.size);
      this.genomes = best.map((index) => genomes[index]);
      this.fitness = best.map((index) => fitness[index]);
      return;
    }
    const gains = fitness.map((value, index) => value - this.fitness[index]);
    this.remember(gains);
    gains.forEach((gain, index) => {
      if (gain > 0) this.former.push(this.genomes[index]);
      if (gain >= 0) [this.genomes[index], this.fitness[index]] = [genomes[index], fitness[index]];
    });
    while (this.former.length > this.size) this.former.splice(this.below(this.former.length), 1);
  }

  private rank(fitness: number[]): number[] {
    return fitness.map((_, index) => index).sort((a, b) => fitness[b] - fitness[a]);
  }

  private below(count: number): number {
    return Math.floor(this.random() * count);
  }

  /** Mix a genome with a mutant of it. */
  private mix(index: number, ranked: number[]): Trial {
    const { scale, rate } = this.draw();
    const x = this.genomes[index];
    const share = Math.min(2 / this.size, greediest);
    const best = Math.max(Math.floor((share + this.random() * (greediest - share)) * this.size), 1);
    const target = this.genomes[ranked[this.below(best)]];
    const others = this.genomes.filter((_, other) => other !== index);
    const a = others.splice(this.below(others.length), 1)[0];
    const pool = [...others, ...this.former];
    const b = pool[this.below(pool.length)];
    const forced = this.below(x.length);
    const genome = x.map((value, gene) => {
      if (this.random() >= rate && gene !== forced) return value;
      const step = this.subtract(target, x, gene) + this.subtract(a, b, gene);
      const mutant = value + scale * step;
      if (this.circular[gene]) return mutant - Math.floor(mutant);
      return mutant < 0 ? value / 2 : mutant > 1 ? (1 + value) / 2 : mutant;
    });
    return { genome, scale, rate };
  }

  /** Return a difference of genes, the shorter way round for circular ones. */
  private subtract(a: number[], b: number[], gene: number): number {
    const difference = a[gene] - b[gene];
    return this.circular[gene] ? difference - Math.round(difference) : difference;
  }

  /** Draw a scale (Cauchy, above 0) and a crossover rate (normal) around remembered ones. */
  private draw(): { scale: number; rate: number } {
    const { scale, rate } = this.memory[this.below(memorySize)];
    const lowest = 0.5 - Math.atan(scale / 0.1) / Math.PI;
    const tail = lowest + (1 - lowest) * this.random();
    const normal = Math.sqrt(-2 * Math.log(1 - this.random())) * Math.cos(2 * Math.PI * this.random());
    const clip = (value: number) => Math.min(Math.max(value, 1e-3), 1);
    return { scale: clip(scale + 0.1 * Math.tan(Math.PI * (tail - 0.5))), rate: clip(rate + 0.1 * normal) };
  }

  /** Replace the oldest entry of the memory by Lehmer means of what led to better genomes. */
  private remember(gains: number[]): void {
    const better = this.trials.map((trial, index) => ({ ...trial, gain: gains[index] })).filter(({ gain }) => gain > 0);
    if (better.length === 0) return;
    const lehmer = (key: "scale" | "rate") =>
      better.reduce((sum, trial) => sum + trial.gain * trial[key] ** 2, 0) /
      better.reduce((sum, trial) => sum + trial.gain * trial[key], 0);
    this.memory[this.oldest] = { scale: lehmer("scale"), rate: lehmer("rate") };
    this.oldest = (this.oldest + 1) % memorySize;
  }
}

/** Whether each gene of a body with a wave is circular. */
export const circularGenes = [...data.parameters.map(() => false), ...data.circular];
