import { Crawl, type Progress } from "./crawl";
import { loadMuJoCo } from "./model";
import type { Robot } from "./robot";

/** The final progress of a robot, or what went wrong. */
export type Answer = { progress: Progress } | { error: string };

const mujoco = loadMuJoCo();

async function simulate(robot: Robot): Promise<Progress> {
  const crawl = new Crawl(await mujoco, robot);
  try {
    return crawl.finish();
  } finally {
    crawl.delete();
  }
}

/** Simulate each robot that arrives, one at a time. */
onmessage = async ({ data: robot }: MessageEvent<Robot>): Promise<void> => {
  let answer: Answer;
  try {
    answer = { progress: await simulate(robot) };
  } catch (error) {
    answer = { error: String(error) };
  }
  postMessage(answer);
};
