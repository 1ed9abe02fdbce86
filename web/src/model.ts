import load, { type MainModule, type MjModel } from "@mujoco/mujoco";
import wasm from "@mujoco/mujoco/mujoco.wasm?url";
import data from "./data.json";
import { parameterIndex } from "./robot";

export type MuJoCo = MainModule;

/** Load MuJoCo. */
export function loadMuJoCo(): Promise<MuJoCo> {
  return load({ locateFile: () => wasm });
}

/** Return the XML of a robot from its eight body parameters; see `caterpillar_env.model` in Python. */
export function toXml(body: number[]): string {
  const { pieces, slots, coefficients } = data.model;
  const limitRad = body[parameterIndex("joint_limit_rad")];
  const terms = [1, ...body, limitRad ** -2]; // the last one is for the stiffness, 1 / q^2
  const values = coefficients.map((row) => row.reduce((sum, factor, i) => sum + factor * terms[i], 0));
  return slots.reduce((xml, slot, i) => {
    const isStretch = xml.endsWith('springref="'); // of the axial joints, 0 if the springs are slack
    return xml + (isStretch ? Math.max(values[slot], 0) : values[slot]) + pieces[i + 1];
  }, pieces[0]);
}

/** Compile a robot. The caller deletes the model. */
export function compile(mujoco: MuJoCo, body: number[]): MjModel {
  const model = mujoco.MjModel.from_xml_string(toXml(body));
  model.ten_J_rownnz.set(data.tendons.ten_J_rownnz); // steps are nearly twice as fast
  model.ten_J_colind.set(data.tendons.ten_J_colind);
  return model;
}
