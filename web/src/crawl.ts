import type { MjData, MjModel } from "@mujoco/mujoco";
import data from "./data.json";
import { power } from "./gait";
import { judge } from "./judge";
import { compile, type MuJoCo } from "./model";
import type { Robot } from "./robot";
import { Springs } from "./springs";

/** Progress of a robot since its start; see `Progress` in `caterpillar_env.task`. */
export interface Progress {
  timeS: number;
  distanceM: number;
  lateralM: number;
  energyJ: number;
  failure: string; // "ok", or its name
}

const substeps = Math.round(data.sma_step_s / data.timestep_s);
const stepsPerInterval = Math.round(data.control_interval_s / data.sma_step_s);

/** A crawling robot, as `caterpillar_env.task.Crawl` simulates it. Call `delete` in the end. */
export class Crawl {
  readonly model: MjModel;
  readonly data: MjData;
  readonly springs: Springs;
  progress: Progress = { timeS: 0, distanceM: 0, lateralM: 0, energyJ: 0, failure: "ok" };
  private readonly power: number[][];
  private readonly startM: number[];
  private readonly elements: number[];
  private readonly touching: { geom: number; halfAxes: number[] }[];
  private energyJ = 0;
  private borneS = 0;
  private steps = 0;
  private loads = [0, 0]; // on feet and skin, summed over the physics steps of an interval

  constructor(private readonly mujoco: MuJoCo, robot: Robot) {
    this.model = compile(mujoco, robot.body);
    this.data = new mujoco.MjData(this.model);
    this.power = power(robot.onS, robot.offS);
    this.springs = new Springs(this.model.nu);
    this.elements = Array.from({ length: this.model.nbody - 1 }, (_, i) => i + 1);
    this.touching = Array.from({ length: this.model.ngeom }, (_, geom) => geom)
      .filter((geom) => this.model.geom_conaffinity[geom] > 0)
      .map((geom) => {
        const size = Array.from<number>(this.model.geom_size.subarray(3 * geom, 3 * geom + 3));
        return { geom, halfAxes: size.map((axis) => axis || size[0]) }; // a sphere has only the first
      });
    mujoco.mj_fwdPosition(this.model, this.data);
    mujoco.mj_fwdVelocity(this.model, this.data);
    this.startM = this.centreM();
  }

  delete(): void {
    this.data.delete();
    this.model.delete();
  }

  /** Whether the robot has failed or its time is over. */
  get ended(): boolean {
    return this.progress.failure !== "ok" || this.timeS > data.episode_s - data.sma_step_s / 2;
  }

  /** Centre of mass in m. */
  centreM(): number[] {
    return Array.from(this.data.subtree_com.subarray(3, 6));
  }

  /** Advance by a thermal step. After every control interval, the robot is judged. */
  step(): void {
    const powered = this.power[this.steps % this.power.length];
    const before = this.springs.fraction.slice();
    this.energyJ += this.springs.step((spring) => powered[spring >> 1]); // two springs to a pair
    const after = this.springs.fraction;
    const { ctrl, sensordata } = this.data;
    for (let substep = 0; substep < substeps; substep++) {
      const share = (substep + 0.5) / substeps;
      for (let i = 0; i < after.length; i++) ctrl[i] = (after[i] - before[i]) * share + before[i];
      this.mujoco.mj_step(this.model, this.data);
      data.loads.forEach((sensor, i) => (this.loads[i] += sensordata[sensor]));
    }
    this.steps++;
    if (this.steps % stepsPerInterval === 0) this.judge();
  }

  /** Simulated time in s. */
  get timeS(): number {
    return this.steps * data.sma_step_s;
  }

  /** Vertical loads on the geoms that touch the ground in N, by their number. */
  contactLoadsN(): Map<number, number> {
    const loads = new Map<number, number>();
    const contacts = this.data.contact; // a copy, and so are its elements
    for (let i = 0; i < this.data.ncon; i++) {
      const contact = contacts.get(i);
      if (!contact) continue;
      const [, geom] = contact.geom; // the ground comes first
      const address = contact.efc_address;
      contact.delete();
      // `efc_force` is a view that is lost when the memory grows, so it is read each time.
      if (address >= 0) loads.set(geom, (loads.get(geom) ?? 0) + this.data.efc_force[address]);
    }
    contacts.delete();
    return loads;
  }

  /** Advance to the end and return the final progress. */
  finish(): Progress {
    while (!this.ended) this.step();
    return this.progress;
  }

  private judge(): void {
    const [x, y] = this.centreM();
    const mean = (column: number) =>
      this.elements.reduce((sum, element) => sum + this.data.xmat[9 * element + column], 0) / this.elements.length;
    const [feet, skin] = this.loads.map((sum) => sum / (substeps * stepsPerInterval));
    this.loads = [0, 0];
    this.borneS += Math.max(skin / Math.max(feet + skin, data.min_load_n), 0) * data.control_interval_s;
    const { timeS } = this;
    const lateralM = y - this.startM[1];
    const failure = judge({
      up: mean(8),
      headingRad: Math.atan2(mean(3), mean(0)),
      lateralM,
      clearanceM: this.clearanceM(),
      bodyLoad: this.borneS / Math.max(timeS, data.episode_s),
      diverged: this.hasDiverged(),
    });
    this.progress = { timeS, distanceM: x - this.startM[0], lateralM, energyJ: this.energyJ, failure };
  }

  /** Height of the lowest point of feet and skin above the ground, m. */
  private clearanceM(): number {
    const { geom_xpos: position, geom_xmat: matrix } = this.data;
    const heights = this.touching.map(
      ({ geom, halfAxes }) =>
        position[3 * geom + 2] - Math.hypot(...halfAxes.map((axis, i) => axis * matrix[9 * geom + 6 + i])),
    );
    return Math.min(...heights);
  }

  private hasDiverged(): boolean {
    const warnings = this.data.warning; // part of the data, so it must not be deleted
    let warned = false;
    for (let i = 0; i < warnings.size(); i++) {
      const warning = warnings.get(i); // a copy
      warned ||= (warning?.number ?? 0) > 0;
      warning?.delete();
    }
    return warned || ![...this.data.qpos, ...this.data.qvel].every(Number.isFinite);
  }
}

/** Return the final progress of a robot. */
export function simulate(mujoco: MuJoCo, robot: Robot): Progress {
  const crawl = new Crawl(mujoco, robot);
  try {
    return crawl.finish();
  } finally {
    crawl.delete();
  }
}
