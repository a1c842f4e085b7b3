import type { Loop } from "../../api/drones";
import { shownValue } from "../../design/units";
import type { Now } from "./live.svelte";

/** A loop that takes set-points: what it is called, its unit, and how far its slider and its number go, in SI. */
export interface LoopRow {
  loop: Loop;
  label: string;
  /** What a sighted person reads on the tab. */
  short: string;
  unit: string;
  /** Of the slider; what is typed may go up to `most`. */
  slides: number;
  /** What one arrow key on the slider gives, in SI. */
  step: number;
  most: number;
  /** Buttons for clean steps, in SI. */
  steps: readonly number[];
  /** The loop moves the cart, which the rings may lock, and commands the thrust. */
  movesCart: boolean;
}

const DEG = Math.PI / 180;
const degrees = (values: number[]) => values.map((value) => value * DEG);

export const LOOPS: readonly LoopRow[] = [
  {
    loop: "theta",
    label: "Pitch θ",
    short: "Pitch",
    unit: "rad",
    slides: 20 * DEG,
    step: 0.5 * DEG,
    most: 50 * DEG,
    steps: degrees([-10, -5, 0, 5, 10]),
    movesCart: false,
  },
  {
    loop: "x",
    label: "Position x",
    short: "Position",
    unit: "m",
    slides: 0.35,
    step: 0.005,
    most: 0.4,
    steps: [-0.2, -0.1, 0, 0.1, 0.2],
    movesCart: true,
  },
  {
    loop: "v",
    label: "Velocity v",
    short: "Velocity",
    unit: "m/s",
    slides: 0.5,
    step: 0.01,
    most: 2,
    steps: [-0.2, -0.1, 0, 0.1, 0.2],
    movesCart: true,
  },
  {
    loop: "q",
    label: "Pitch rate q",
    short: "Rate",
    unit: "rad/s",
    slides: 60 * DEG,
    step: DEG,
    most: 180 * DEG,
    steps: degrees([-30, -15, 0, 15, 30]),
    movesCart: false,
  },
  {
    loop: "M",
    label: "Moment M, no loop closed",
    short: "Moment",
    unit: "-",
    slides: 0.1,
    step: 0.001,
    most: 1,
    steps: [-0.03, -0.01, 0, 0.01, 0.03],
    movesCart: false,
  },
];

export const loopRow = (loop: Loop): LoopRow => LOOPS.find((one) => one.loop === loop) ?? LOOPS[0]!;

/** By place in signals.MODES. */
const FLOWN: readonly (Loop | undefined)[] = [undefined, "M", "q", "theta", "v", "x"];

/** What the drone follows now, as it tells, whoever gave it. */
export function followed(now: Now, armed: boolean): string {
  const loop = FLOWN[now.mode];
  if (!armed || loop === undefined) return "follows nothing";
  if (loop === "M") return "flies a moment, no loop";
  const row = loopRow(loop);
  return `follows ${row.short.toLowerCase()} ${shownValue(now.wanted[loop], row.unit)}`;
}
