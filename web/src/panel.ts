import data from "./data.json";
import { fromPhases, type Phases, phasesToWave, toPhases, waveToPhases } from "./gait";
import type { Robot } from "./robot";

interface Slider {
  set(value: number): void;
}

/** Add a slider to a fieldset. Values are in `unit` after multiplication by `factor`. */
function addSlider(
  fieldset: Element,
  options: { label: string; lower: number; upper: number; factor: number; unit: string; step: number },
  onInput: (value: number) => void,
): Slider {
  const { label, lower, upper, factor, unit, step } = options;
  const row = document.createElement("label");
  row.className = "slider";
  const output = document.createElement("output");
  const input = document.createElement("input");
  const [min, max] = [lower, upper].map((bound) => (bound * factor).toFixed(1));
  Object.assign(input, { type: "range", min, max, step });
  output.ariaLive = "off"; // the slider itself is announced
  const write = (shown: number) => {
    output.textContent = `${shown.toFixed(step < 1 ? 1 : 0)} ${unit}`;
    input.setAttribute("aria-valuetext", output.textContent);
  };
  const set = (value: number) => {
    write(value * factor);
    input.value = String(value * factor);
  };
  input.addEventListener("input", () => {
    write(Number(input.value));
    onInput(Math.min(Math.max(Number(input.value) / factor, lower), upper));
  });
  row.append(label, output, input);
  fieldset.append(row);
  return { set };
}

/** Sliders of body, wave and pairs. `onChange` gets the robot that the visitor has set. */
export class Panel {
  private robot: Robot = { body: [], onS: [], offS: [] };
  private readonly body: Slider[];
  private readonly wave: Slider[];
  private readonly delay: Slider[] = [];
  private readonly duty: Slider[] = [];

  constructor(find: (id: string) => Element, private readonly onChange: (robot: Robot) => void) {
    const share = { lower: 0, factor: 100, unit: "%", step: 1 };
    this.body = data.parameters.map(({ description, symbol, lower, upper, factor, shown }, i) => {
      const options = { label: `${description} (${symbol})`, lower, upper, factor, unit: shown, step: 0.1 };
      return addSlider(find("body"), options, (value) => {
        this.robot = { ...this.robot, body: this.robot.body.with(i, value) };
        this.onChange(this.robot);
      });
    });
    this.wave = data.wave.map((name, i) => {
      const upper = data.circular[i] ? 1 : data.max_duty;
      return addSlider(find("wave"), { ...share, label: name.replace("_", " "), upper }, (value) =>
        this.setPhases(waveToPhases(phasesToWave(this.phases).with(i, value))),
      );
    });
    data.pairs.forEach((name, pair) => {
      const label = name.replace("_", " ").replace("gap", "gap ");
      this.delay.push(
        addSlider(find("pairs"), { ...share, label: `${label}, delay`, upper: 1 }, (value) =>
          this.setPhases({ ...this.phases, delay: this.phases.delay.with(pair, value) }),
        ),
      );
      this.duty.push(
        addSlider(find("pairs"), { ...share, label: `${label}, duty`, upper: data.max_duty }, (value) =>
          this.setPhases({ ...this.phases, duty: this.phases.duty.with(pair, value) }),
        ),
      );
    });
  }

  /** Show a robot without a call of `onChange`. */
  show(robot: Robot): void {
    this.robot = robot;
    this.body.forEach((slider, i) => slider.set(robot.body[i]));
    this.showGait();
  }

  private get phases(): Phases {
    return toPhases(this.robot.onS, this.robot.offS);
  }

  private setPhases(phases: Phases): void {
    this.robot = { ...this.robot, ...fromPhases(phases) };
    this.showGait();
    this.onChange(this.robot);
  }

  private showGait(): void {
    const { phases } = this;
    phasesToWave(phases).forEach((value, i) => this.wave[i].set(value));
    phases.delay.forEach((value, pair) => this.delay[pair].set(value));
    phases.duty.forEach((value, pair) => this.duty[pair].set(value));
  }
}
