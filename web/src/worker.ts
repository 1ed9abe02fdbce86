import { Crawl, type Progress } from "./crawl";
import { loadMuJoCo } from "./model";
import type { Robot } from "./robot";

const mujoco = loadMuJoCo();

/** Simulate each robot that arrives, and answer with its final progress. */
onmessage = async ({ data: robot }: MessageEvent<Robot>): Promise<void> => {
  const crawl = new Crawl(await mujoco, robot);
  const progress: Progress = crawl.finish();
  crawl.delete();
  postMessage(progress);
};
