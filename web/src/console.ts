import { Crawl, type Progress, simulate } from "./crawl";
import data from "./data.json";
import { fromPhases, power, toPhases } from "./gait";
import { judge } from "./judge";
import { type MuJoCo, toXml } from "./model";
import { fromLink, type Robot, toLink, toPython, winners } from "./robot";
import { decode } from "./search";
import { seeded, Shade } from "./shade";
import { Springs } from "./springs";

/** Functions for the console of the browser, as `caterpillar`. The tests compare them with Python. */
export function makeTools(mujoco: MuJoCo) {
  return {
    winners,
    toXml,
    toLink,
    fromLink,
    toPython,
    toPhases,
    fromPhases,
    power,
    judge,
    decode,
    version: (): string => mujoco.mj_versionString(),

    /** Return the size of MuJoCo's memory before and after many readings of the loads, bytes. */
    readLoads(count: number): [number, number] {
      const crawl = new Crawl(mujoco, winners[0].robot);
      for (let i = 0; i < 100; i++) crawl.step();
      const before = crawl.data.qpos.buffer.byteLength; // of all memory
      for (let i = 0; i < count; i++) crawl.contactLoadsN();
      const after = crawl.data.qpos.buffer.byteLength;
      crawl.delete();
      return [before, after];
    },

    /** Return the final progress of a robot. */
    crawl: (robot: Robot): Progress => simulate(mujoco, robot),

    /** Return the austenite fractions after each thermal step, (steps, springs), from the powers. */
    fractions(powers: number[][]): number[][] {
      const springs = new Springs(powers[0].length);
      return powers.map((powered) => {
        springs.step((spring) => powered[spring]);
        return [...springs.fraction];
      });
    },

    /** Return the best fitness of SHADE on a function of genomes after each generation. */
    maximize(fitness: (genome: number[]) => number, circular: boolean[], generations: number, seed: number): number[] {
      const shade = new Shade(data.search.population, circular, seeded(seed));
      let best = -Infinity;
      return Array.from({ length: generations }, () => {
        const genomes = shade.ask();
        const values = genomes.map(fitness);
        shade.tell(genomes, values);
        return (best = Math.max(best, ...values));
      });
    },
  };
}
