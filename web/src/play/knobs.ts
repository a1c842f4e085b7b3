import { controlLoop } from "../loops";

/** Parameter with a slider from 0 to `high`. */
export interface Knob {
  path: string;
  label: string;
  unit: string;
  high: number;
  key: string;
}

const CASCADE = "flight.cascade.";

export const GAINS: readonly { loop: string; knobs: readonly Knob[] }[] = [
  {
    loop: "Rate",
    knobs: [
      { path: `${CASCADE}rate.kp`, label: "Kp", unit: "s/rad", high: 0.12, key: "rate_kp" },
      { path: `${CASCADE}rate.ki`, label: "Ki", unit: "1/rad", high: 0.5, key: "rate_ki" },
      { path: `${CASCADE}rate.kd`, label: "Kd", unit: "s²/rad", high: 0.003, key: "rate_kd" },
    ],
  },
  { loop: "Attitude", knobs: [{ path: `${CASCADE}attitude.kp`, label: "Kp", unit: "1/s", high: 15, key: "att_kp" }] },
  {
    loop: "Velocity",
    knobs: [
      { path: `${CASCADE}velocity.kp`, label: "Kp", unit: "N s/m", high: 4, key: "vel_kp" },
      { path: `${CASCADE}velocity.ki`, label: "Ki", unit: "N/m", high: 4, key: "vel_ki" },
    ],
  },
  { loop: "Position", knobs: [{ path: `${CASCADE}position.kp`, label: "Kp", unit: "1/s", high: 2.5, key: "pos_kp" }] },
];

export const TROUBLES: readonly Knob[] = [
  { path: "rig.gust", label: "Gusts", unit: "N·m", high: 0.03, key: "gust" },
  { path: "rig.delay", label: "Delay", unit: "s", high: 0.06, key: "delay" },
];

export const KNOBS: readonly Knob[] = [...GAINS.flatMap((one) => one.knobs), ...TROUBLES];

/** Loops that can be flown: bound and automatic step of the set-point, in SI. */
export const MODES = [
  { ...controlLoop("theta"), title: "Attitude", limit: 0.52, step: 0.17 },
  { ...controlLoop("q"), title: "Rate", limit: 1.5, step: 0.5 },
  { ...controlLoop("v"), title: "Velocity", limit: 0.4, step: 0.15 },
  { ...controlLoop("x"), title: "Position", limit: 0.3, step: 0.2 },
];
export type FlyMode = (typeof MODES)[number];
