// Charts of a drone as it flies: what they show, and the latest rows of it.
import type { Rows } from "../api/rows";
import { telemetry } from "../api/telemetry";
import { History } from "../chart/history";
import { DEGREES, type Panel } from "../chart/kinds";

export const PITCH: Panel = {
  label: "Pitch θ",
  least: 4,
  channels: [
    { column: "setpoint.theta", label: "set-point", kind: "set-point", unit: "deg", factor: DEGREES },
    { column: "estimate.theta", label: "estimate", kind: "estimate", unit: "deg", factor: DEGREES },
  ],
};
export const POSITION: Panel = {
  label: "Position x",
  least: 0.1,
  channels: [
    { column: "setpoint.x", label: "set-point", kind: "set-point", unit: "m" },
    { column: "estimate.x", label: "estimate", kind: "estimate", unit: "m" },
  ],
};
export const MOMENT: Panel = {
  label: "Moment M",
  least: 0.02,
  channels: [{ column: "command.M", label: "command", kind: "input", unit: "" }],
};

/**
 * Keep the rows of a drone, `rate` [Hz] a second, and the times of changed parameters in its history. Returns a function
 * that ends it.
 */
export function keepHistory(history: History, drone: number, rate: number, also?: (rows: Rows) => void): () => void {
  const rows = telemetry.subscribe(drone, history.names, rate, (these) => {
    history.append(these);
    also?.(these);
  });
  const events = telemetry.onEvent((event) => {
    if (event.event === "parameters" && event.drone === drone) history.noteChange();
  });
  return () => (rows(), events());
}

/**
 * The latest `kept` rows of what these panels show of a drone, `rate` [Hz] a second, for as long as the component lives
 * that asks for it.
 */
export function liveHistory(drone: () => number, panels: readonly Panel[], rate: number, kept: number): History {
  const columns = panels.flatMap((panel) => panel.channels.map((one) => one.column));
  const history = new History(columns, kept);
  $effect(() => keepHistory(history, drone(), rate));
  return history;
}
