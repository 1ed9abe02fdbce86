import data from "./data.json";

/** The quantities that decide whether a robot has failed; see `caterpillar_env.task.update_failures`. */
export interface Posture {
  up: number; // vertical component of the upward axis
  headingRad: number;
  lateralM: number;
  clearanceM: number; // height of the lowest point
  bodyLoad: number; // share of the load that the body carries
  diverged: boolean;
}

/** Return the name of the most severe failure, or "ok". */
export function judge(posture: Posture): string {
  const limits = data.thresholds;
  if (posture.diverged) return "diverged";
  if (posture.up < limits.flipped_up) return "flipped";
  if (posture.up < limits.tipped_up) return "tipped";
  if (posture.clearanceM > limits.jumped_clearance_m) return "jumped";
  if (Math.abs(posture.lateralM) > limits.veered_lateral_m) return "veered";
  if (Math.abs(posture.headingRad) > limits.veered_heading_rad) return "veered";
  return posture.bodyLoad > limits.sagged_share ? "sagged" : "ok";
}
