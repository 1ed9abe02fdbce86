import data from "./data.json";

const spring = data.spring;
const c = spring.specific_heat_j_kg_k;
const latent = spring.latent_heat_j_kg;
// Exponential Euler in the enthalpy, as in `caterpillar_env.sma.advance`.
const spanS = -spring.time_constant_s * Math.expm1(-data.sma_step_s / spring.time_constant_s);
const gain = spring.heating_w_kg * spanS;
const decay = (spring.cooling_w_kg_k * spanS) / c;
const inflow = decay * c * spring.ambient_c;
const cutOff = c * spring.cut_off_c + latent;

/** Half cosine from 0 to 1 between two temperatures, as enthalpies and austenite fractions. */
function tabulate(lowC: number, highC: number): { enthalpy: number[]; fraction: number[] } {
  const shares = Array.from({ length: spring.nodes }, (_, node) => node / (spring.nodes - 1));
  const fraction = shares.map((share) => 0.5 - 0.5 * Math.cos(Math.PI * share));
  return { enthalpy: shares.map((share, i) => c * (lowC + share * (highC - lowC)) + latent * fraction[i]), fraction };
}

const heating = tabulate(spring.austenite_start_c, spring.austenite_finish_c);
const cooling = tabulate(spring.martensite_finish_c, spring.martensite_start_c);

function interpolate(x: number, { enthalpy, fraction }: typeof heating): number {
  let low = 0;
  let high = enthalpy.length - 1;
  if (x <= enthalpy[low]) return 0;
  if (x >= enthalpy[high]) return 1;
  while (high - low > 1) {
    const middle = (low + high) >> 1;
    if (enthalpy[middle] <= x) low = middle;
    else high = middle;
  }
  const share = (x - enthalpy[low]) / (enthalpy[high] - enthalpy[low]);
  return fraction[low] + share * (fraction[high] - fraction[low]);
}

/** Thermal state of springs, as in `caterpillar_env.sma`. */
export class Springs {
  readonly fraction: Float64Array;
  private readonly enthalpy: Float64Array;

  /** Springs at ambient temperature. */
  constructor(count: number) {
    this.fraction = new Float64Array(count);
    this.enthalpy = new Float64Array(count).fill(c * spring.ambient_c);
  }

  /** Advance by a thermal step, with a power in [0, 1] for each spring, and return the energy in J. */
  step(power: (index: number) => number): number {
    let used = 0;
    for (let i = 0; i < this.fraction.length; i++) {
      const unpowered = this.enthalpy[i] * (1 - decay) + this.fraction[i] * decay * latent + inflow;
      const enthalpy = Math.min(unpowered + power(i) * gain, cutOff);
      used += (enthalpy - unpowered) / gain;
      const heated = Math.max(this.fraction[i], interpolate(enthalpy, heating));
      this.fraction[i] = Math.min(heated, interpolate(enthalpy, cooling));
      this.enthalpy[i] = enthalpy;
    }
    return used * spring.drive_power_w * data.sma_step_s;
  }

  /** Temperature of a spring, degrees Celsius. */
  temperatureC(index: number): number {
    return (this.enthalpy[index] - latent * this.fraction[index]) / c;
  }
}
