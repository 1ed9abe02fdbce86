import type { Progress } from "./crawl";
import data from "./data.json";
import { fromPhases, waveToPhases } from "./gait";
import type { Robot } from "./robot";
import { circularGenes, seeded, Shade } from "./shade";
import type { Answer } from "./worker";

/** What a search has found so far. */
export interface Found {
  simulatedS: number;
  distancesM: number[]; // of all robots, in order of completion, 0 for those that failed
  timesS: number[]; // simulated seconds of the search at the end of each robot
  best: Robot | null;
  bestM: number;
}

/** Return the robot of a genome: eight parameters of the body and four of a wave, all in [0, 1]. */
export function decode(genome: number[]): Robot {
  const count = data.parameters.length;
  const body = data.parameters.map(({ lower, upper }, i) => Math.min(lower + genome[i] * (upper - lower), upper));
  const wave = genome.slice(count).map((gene, i) => (data.circular[i] ? gene : gene * data.max_duty));
  return { body, ...fromPhases(waveToPhases(wave)) };
}

/** Web Workers, each of which simulates one robot at a time. */
class Pool {
  private readonly idle: Worker[];
  private readonly all: Worker[];
  private readonly waiting: ((worker: Worker) => void)[] = [];

  constructor(count: number) {
    this.all = Array.from(
      { length: count },
      () => new Worker(new URL("./worker.ts", import.meta.url), { type: "module" }),
    );
    this.idle = [...this.all];
  }

  async simulate(robot: Robot): Promise<Progress> {
    const worker = this.idle.pop() ?? (await new Promise<Worker>((resolve) => this.waiting.push(resolve)));
    const progress = await new Promise<Progress>((resolve, reject) => {
      worker.onmessage = ({ data: answer }: MessageEvent<Answer>) =>
        "error" in answer ? reject(new Error(answer.error)) : resolve(answer.progress);
      worker.onerror = (event) => reject(new Error(event.message));
      worker.postMessage(robot);
    });
    const next = this.waiting.shift();
    if (next) next(worker);
    else this.idle.push(worker);
    return progress;
  }

  terminate(): void {
    for (const worker of this.all) worker.terminate();
  }
}

/**
 * Search for the body and the wave that crawl farthest, until the budget is spent or `signal` aborts.
 * The robots depend on the seed only, not on the number of workers; the order of completion does.
 */
export async function search(seed: number, signal: AbortSignal, onFound: (found: Found) => void): Promise<void> {
  const pool = new Pool(Math.min(Math.max((navigator.hardwareConcurrency || 2) - 1, 1), 4));
  const stopped = new Promise<"stopped">((resolve) => signal.addEventListener("abort", () => resolve("stopped")));
  const found: Found = { simulatedS: 0, distancesM: [], timesS: [], best: null, bestM: 0 };
  const shade = new Shade(data.search.population, circularGenes, seeded(seed));
  const evaluate = async (genome: number[]): Promise<number> => {
    const robot = decode(genome);
    const { distanceM, failure, timeS } = await pool.simulate(robot);
    const fitness = failure === "ok" ? Math.max(distanceM, 0) : 0;
    found.simulatedS += timeS;
    found.timesS.push(found.simulatedS);
    found.distancesM.push(fitness);
    if (fitness > found.bestM) [found.best, found.bestM] = [robot, fitness];
    if (!signal.aborted) onFound(found);
    return fitness;
  };
  try {
    while (found.simulatedS < data.search.budget_s) {
      const genomes = shade.ask();
      const fitness = await Promise.race([stopped, Promise.all(genomes.map(evaluate))]);
      if (fitness === "stopped") return;
      shade.tell(genomes, fitness);
    }
  } finally {
    pool.terminate();
  }
}
