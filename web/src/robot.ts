import data from "./data.json";

/** A body with a gait: the eight parameters in SI units, and the times of the mirrored pairs. */
export interface Robot {
  body: number[];
  onS: number[];
  offS: number[];
}

/** Return the place of a parameter in `body`. */
export function parameterIndex(name: string): number {
  return data.parameters.findIndex((parameter) => parameter.name === name);
}

/** The winners of the published study, longest distance first. */
export const winners = data.winners
  .map((winner) => ({
    name: winner.name,
    distanceM: winner.distance_m,
    robot: { body: winner.body, onS: winner.on_s, offS: winner.off_s } as Robot,
  }))
  .sort((a, b) => b.distanceM - a.distanceM);

/** Return the part of the page's address after "#" that holds a robot. */
export function toLink(robot: Robot): string {
  return `#body=${robot.body.join()}&on=${robot.onS.join()}&off=${robot.offS.join()}`;
}

/** Return the robot in the part of an address after "#", or null if there is none or it is invalid. */
export function fromLink(hash: string): Robot | null {
  const fields = new URLSearchParams(hash.replace(/^#/, ""));
  const read = (name: string) => (fields.get(name) ?? "").split(",").map((text) => (text ? Number(text) : NaN));
  const robot = { body: read("body"), onS: read("on"), offS: read("off") };
  const within = (values: number[], count: number, bounds: (i: number) => { lower: number; upper: number }) =>
    values.length === count && values.every((value, i) => value >= bounds(i).lower && value <= bounds(i).upper);
  const times = () => ({ lower: 0, upper: data.gait_period_s });
  const valid =
    within(robot.body, data.parameters.length, (i) => data.parameters[i]) &&
    within(robot.onS, data.pairs.length, times) &&
    within(robot.offS, data.pairs.length, times);
  return valid ? robot : null;
}

/** Return a line of Python that simulates the robot with the package. */
export function toPython({ body, onS, offS }: Robot): string {
  return (
    "from caterpillar_env import GaitTimings, Morphology, Physics, simulate; " +
    `print(simulate([Morphology(${body.join(", ")})], ` +
    `GaitTimings(${data.gait_period_s}, [[${onS.join(", ")}]], [[${offS.join(", ")}]]), Physics()))`
  );
}
