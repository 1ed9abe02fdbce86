import data from "./data.json";

/** Delay and duty of each pair as shares of the period; see `GaitTimings.from_phases` in Python. */
export interface Phases {
  delay: number[];
  duty: number[];
}

const period = data.gait_period_s;
const wrap = (share: number) => share - Math.floor(share);

/** Return the times of pairs, dorsal and ventral in turn, from their phases. */
export function fromPhases({ delay, duty }: Phases): { onS: number[]; offS: number[] } {
  const on: number[] = [];
  let dorsal = 0;
  delay.forEach((value, pair) => {
    if (pair % 2 === 0) dorsal += value;
    on.push(pair % 2 === 0 ? dorsal : dorsal + value);
  });
  return {
    onS: on.map((share) => wrap(share) * period),
    offS: on.map((share, pair) => wrap(share + duty[pair]) * period),
  };
}

/** Return the phases of pairs from their times. A pair that is always powered gets the largest duty. */
export function toPhases(onS: number[], offS: number[]): Phases {
  const on = onS.map((time) => time / period);
  return {
    delay: on.map((share, pair) => wrap(share - (pair === 0 ? 0 : on[pair % 2 === 0 ? pair - 2 : pair - 1]))),
    duty: onS.map((time, pair) =>
      offS[pair] - time === period ? data.max_duty : wrap((offS[pair] - time) / period),
    ),
  };
}

/** Return the phases of a wave: lag, dorsal duty, offset and ventral duty as shares of the period. */
export function waveToPhases([lag, dorsalDuty, offset, ventralDuty]: number[]): Phases {
  return {
    delay: data.pairs.map((_, pair) => (pair === 0 ? 0 : pair % 2 === 0 ? lag : offset)),
    duty: data.pairs.map((_, pair) => (pair % 2 === 0 ? dorsalDuty : ventralDuty)),
  };
}

/** Return the wave that a gait resembles, in the order of `waveToPhases`. */
export function phasesToWave({ delay, duty }: Phases): number[] {
  return [delay[2], duty[0], delay[1], duty[1]];
}

/** Return the share of each thermal step of a period in which a pair is powered, (steps, pairs). */
export function power(onS: number[], offS: number[]): number[][] {
  const steps = Math.round(period / data.sma_step_s);
  const stepS = period / steps;
  const poweredUntil = (time: number, on: number, off: number) => {
    const inside = Math.min(Math.max(time, Math.min(on, off)), Math.max(on, off));
    return off >= on ? inside : time - inside;
  };
  return Array.from({ length: steps }, (_, step) =>
    onS.map((on, pair) => {
      const [before, after] = [step, step + 1].map((edge) => poweredUntil(edge * stepS, on, offS[pair]));
      return Math.min(Math.max((after - before) / stepS, 0), 1);
    }),
  );
}
