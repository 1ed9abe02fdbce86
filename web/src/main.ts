import "./style.css";
import { drawChart } from "./chart";
import { makeTools } from "./console";
import { Crawl } from "./crawl";
import data from "./data.json";
import { loadMuJoCo, type MuJoCo } from "./model";
import { Panel } from "./panel";
import { fromLink, parameterIndex, type Robot, toLink, toPython, winners } from "./robot";
import { type Camera, Scene } from "./scene";
import { type Found, search } from "./search";

const find = <T extends Element = HTMLElement>(id: string): T => document.querySelector<T>(`#${id}`)!;
const [play, restart] = [find<HTMLButtonElement>("play"), find<HTMLButtonElement>("restart")];
const [speed, camera, menu] = ["speed", "camera", "winners"].map((id) => find<HTMLSelectElement>(id));
const [start, showBest] = [find<HTMLButtonElement>("search"), find<HTMLButtonElement>("show-best")];
const [leastBudgetMs, greatestBudgetMs] = [12, 250]; // for the physics of one frame
const compileDelayMs = 120;

/** Write a text, only if it has changed: screen readers announce each change. */
function write(id: string, text: string): void {
  if (find(id).textContent !== text) find(id).textContent = text;
}

/** The page around one robot. */
class Page {
  private robot: Robot = winners[0].robot;
  private crawl!: Crawl; // since the first restart
  private readonly scene = new Scene(find<HTMLCanvasElement>("view"));
  private readonly panel = new Panel(find, (robot) => this.change(robot));
  private isPlaying = false;
  private dueS = 0; // simulated time that the next frames owe
  private lastMs = performance.now();
  private changed: Robot | null = null; // by the sliders, not yet shown
  private pending = 0;
  private own: Robot | null = null; // the last robot that is not in the menu
  private searching: AbortController | null = null;
  private seed = 0;
  private found: Found | null = null;

  constructor(private readonly mujoco: MuJoCo) {
    this.fillMenu();
    this.listen();
    this.followLink();
    this.setPlaying(!matchMedia("(prefers-reduced-motion: reduce)").matches);
    requestAnimationFrame((ms) => this.frame(ms));
  }

  /** Show a robot at its start, in the picture, the sliders, the menu and the address. */
  private show(robot: Robot): void {
    clearTimeout(this.pending);
    this.changed = null;
    this.robot = robot;
    this.panel.show(robot);
    history.replaceState(null, "", toLink(robot));
    const known = winners.findIndex((winner) => toLink(winner.robot) === toLink(robot));
    if (known < 0) this.own = robot;
    menu.options[0].disabled = !this.own;
    menu.value = String(known);
    find("name").textContent = known < 0 ? "Your robot" : winners[known].name;
    this.restart();
  }

  /** Show another robot from the chosen camera, and play. */
  private present(robot: Robot): void {
    write("notice", "");
    this.show(robot);
    this.turnCamera();
    this.setPlaying(true);
  }

  /** Show the robot in the address, or the current one if the address holds none. */
  private followLink(): void {
    const { hash } = location;
    const linked = fromLink(hash);
    this.show(linked ?? this.robot);
    this.turnCamera();
    write("notice", hash && !linked ? "The link is incomplete, so the page shows another robot." : "");
  }

  /** Take a robot from the sliders. Compiling waits until they rest. */
  private change(robot: Robot): void {
    clearTimeout(this.pending);
    this.changed = robot;
    this.pending = window.setTimeout(() => this.applyChange(), compileDelayMs);
  }

  private applyChange(): void {
    if (!this.changed) return;
    const playing = this.isPlaying || this.crawl.ended;
    this.show(this.changed);
    this.setPlaying(playing);
  }

  private restart(): void {
    const former = this.crawl as Crawl | undefined;
    this.crawl = new Crawl(this.mujoco, this.robot);
    this.scene.setRobot(this.crawl);
    former?.delete();
    this.dueS = 0;
    this.write();
  }

  private setPlaying(playing: boolean): void {
    if (playing && this.crawl.ended) this.restart();
    this.isPlaying = playing;
    this.write();
  }

  private frame(ms: number): void {
    requestAnimationFrame((next) => this.frame(next));
    try {
      this.advance(ms);
    } catch (error) {
      this.isPlaying = false;
      throw error; // for the listener in index.html
    }
    this.scene.draw();
  }

  private advance(ms: number): void {
    const elapsedMs = Math.min(ms - this.lastMs, 2 * greatestBudgetMs);
    this.lastMs = ms;
    if (this.isPlaying) {
      this.dueS += (elapsedMs / 1000) * Number(speed.value);
      const deadline = performance.now() + Math.max(elapsedMs / 2, leastBudgetMs);
      while (this.dueS >= data.sma_step_s && !this.crawl.ended && performance.now() < deadline) {
        this.crawl.step();
        this.scene.extendPath(this.crawl);
        this.dueS -= data.sma_step_s;
      }
      if (this.dueS >= data.sma_step_s) this.dueS = 0; // a slow machine falls behind
      if (this.crawl.ended) this.isPlaying = false;
      this.scene.update(this.crawl);
      this.write();
    }
  }

  private write(): void {
    const { distanceM, energyJ, failure } = this.crawl.progress;
    const { ended, timeS } = this.crawl;
    write("time", `${timeS.toFixed(1)} s`);
    write("distance", `${Math.round(1000 * distanceM) || 0} mm`); // 0 instead of -0
    write("energy", `${energyJ.toFixed(0)} J`);
    const failed = failure !== "ok";
    find("status").classList.toggle("failed", failed);
    const end = failed ? `${failure} at ${timeS.toFixed(1)} s` : `done: ${(1000 * distanceM).toFixed(1)} mm`;
    write("status", ended ? end : this.isPlaying ? "crawling" : "paused");
    play.textContent = this.isPlaying ? "Pause" : ended ? "Play again" : "Play";
  }

  private turnCamera(): void {
    const segmentM = this.robot.body[parameterIndex("segment_length_m")];
    const lengthM = (segmentM * (data.pairs.length + 2)) / 2; // one gap less than segments
    this.scene.setCamera(camera.value as Camera, lengthM);
  }

  private fillMenu(): void {
    const groups = new Map<string, HTMLOptGroupElement>();
    menu.append(new Option("Your robot", "-1")); // the first option, see `show`
    winners.forEach(({ name, distanceM }, i) => {
      const [arm] = name.split(",");
      const group = groups.get(arm) ?? Object.assign(document.createElement("optgroup"), { label: arm });
      groups.set(arm, group);
      group.append(new Option(`${name}: ${(1000 * distanceM).toFixed(0)} mm`, String(i)));
    });
    menu.append(...groups.values());
  }

  private async search(): Promise<void> {
    if (this.searching) {
      this.searching.abort();
      return;
    }
    this.searching = new AbortController();
    start.textContent = "Stop";
    const seed = this.seed++;
    this.found = null;
    showBest.disabled = true;
    const tell = (state: string) => {
      const { distancesM, bestM } = this.found ?? { distancesM: [], bestM: 0 };
      find("progress").textContent =
        `Search ${seed + 1}, ${state}: ${distancesM.length} robots, the best crawls ${(1000 * bestM).toFixed(0)} mm.`;
    };
    tell("running");
    try {
      await search(seed, this.searching.signal, (found) => {
        this.found = found;
        showBest.disabled = !found.best;
        drawChart(find<SVGElement>("chart"), found);
        tell("running");
      });
      tell(this.searching.signal.aborted ? "stopped" : "done");
    } catch (error) {
      find("progress").textContent = `The search failed: ${String(error)}`;
    }
    this.searching = null;
    start.textContent = "Start again";
  }

  private pick(index: number): void {
    const robot = index < 0 ? this.own : winners[index].robot;
    if (robot) this.present(robot);
  }

  private listen(): void {
    const copy = async (id: string, label: string, makeText: () => string) => {
      this.applyChange();
      const text = makeText();
      try {
        await navigator.clipboard.writeText(text);
        write(id, "Copied");
      } catch {
        prompt("Copy this:", text); // where the page may not use the clipboard
      }
      setTimeout(() => write(id, label), 1200);
    };
    play.onclick = () => this.setPlaying(!this.isPlaying);
    restart.onclick = () => this.restart();
    camera.onchange = () => this.turnCamera();
    menu.onchange = () => this.pick(Number(menu.value));
    start.onclick = () => void this.search();
    showBest.onclick = () => this.found?.best && this.present(this.found.best);
    find("copy-link").onclick = () => void copy("copy-link", "Copy link", () => location.href);
    find("copy-python").onclick = () => void copy("copy-python", "Copy Python", () => toPython(this.robot));
    window.onhashchange = () => this.followLink();
    const next = (select: HTMLSelectElement, by: number) => {
      const count = select.length;
      select.selectedIndex = (select.selectedIndex + by + count) % count;
      select.dispatchEvent(new Event("change"));
    };
    const keys: Record<string, () => void> = {
      " ": () => play.click(),
      r: () => restart.click(),
      c: () => next(camera, 1),
      "<": () => (speed.selectedIndex = Math.max(speed.selectedIndex - 1, 0)),
      ">": () => (speed.selectedIndex = Math.min(speed.selectedIndex + 1, speed.length - 1)),
      n: () => this.pick((Number(menu.value) + 1) % winners.length),
      e: () => start.click(),
    };
    window.addEventListener("keydown", (event) => {
      const isIn = (selector: string) => event.target instanceof Element && event.target.closest(selector);
      const action = keys[event.key.toLowerCase()];
      if (!action || event.ctrlKey || event.metaKey || event.altKey) return;
      if (isIn("select") || (event.key === " " && isIn("button, summary, a"))) return;
      event.preventDefault();
      action();
    });
  }
}

/** Write what does not change: the legend, the versions, the hint of the search. */
function writeFixed(version: string): void {
  const stops = data.colours.map((rgb) => `rgb(${rgb.map((value) => 100 * value + "%").join(" ")})`);
  find("ramp").style.background = `linear-gradient(to right, ${stops.join()})`;
  const { ambient_c: low, austenite_start_c: middle, cut_off_c: high } = data.spring;
  find("ticks").replaceChildren(
    ...[low, middle, high].map((temperatureC, i) => {
      const tick = document.createElement("span");
      tick.textContent = `${temperatureC}${i === 2 ? " °C" : ""}`;
      tick.style.left = `${(100 * (temperatureC - low)) / (high - low)}%`;
      return tick;
    }),
  );
  find("evolve-hint").textContent =
    "Searches for the body and the wave that crawl farthest, with SHADE (differential evolution, " +
    `${data.search.population} robots per generation) in Web Workers, for ${data.search.budget_s.toLocaleString("en")} ` +
    "simulated seconds. The first robots are drawn uniformly, and every robot is simulated to the end.";
  find("about").textContent =
    `This page runs MuJoCo ${version} as WebAssembly; the Python package runs MuJoCo ${data.mujoco}. Tests compare ` +
    "the two: robots that are not chaotic end within 0.001 mm of each other after 30 s. " +
    "MuJoCo has the Apache-2.0 licence, and three.js, which draws the picture, the MIT licence: ";
  find("about").append(Object.assign(document.createElement("a"), { href: "licences.md", textContent: "licences" }), ".");
}

try {
  const mujoco = await loadMuJoCo();
  writeFixed(mujoco.mj_versionString());
  Object.assign(window, { caterpillar: makeTools(mujoco) });
  new Page(mujoco);
  for (const button of [play, restart]) button.disabled = false;
} catch (error) {
  find("status").textContent = `The page did not start; it needs WebAssembly and WebGL. ${String(error)}`;
  find("status").classList.add("failed");
}
