import { type Progress, simulate } from "./crawl";
import { loadMuJoCo } from "./model";
import type { Robot } from "./robot";

/** The final progress of a robot, or what went wrong. */
export type Answer = { progress: Progress } | { error: string };

const mujoco = loadMuJoCo();

/** Simulate each robot that arrives, one at a time. */
onmessage = async ({ data: robot }: MessageEvent<Robot>): Promise<void> => {
  let answer: Answer;
  try {
    answer = { progress: simulate(await mujoco, robot) };
  } catch (error) {
    answer = { error: String(error) };
  }
  postMessage(answer);
};
