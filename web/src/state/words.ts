// How a drone stands, in words for a person; the drone's own sentence always goes first where it has one.
import type { DroneState } from "../api/drones";

export interface Word {
  kind: "good" | "warn" | "bad" | "plain";
  text: string;
  title?: string;
}

const ACTIONS: Record<string, string> = {
  none: "flies what is asked for",
  level: "holds it level",
  brake: "brakes the cart before the rail's end",
  descend: "levels it and fades the thrust out",
  off: "keeps the motors off until it is disarmed",
};

export function failsafeSentence(state: DroneState): string {
  if (state.failsafe === "none" || !state.armed) return "";
  const does = ACTIONS[state.failsafe] ?? state.failsafe;
  return `The failsafe ${does}: ${state.failsafe_reason || "it names no reason"}.`;
}

/** Why a drone that a page has stopped does nothing. */
export const RELEASE = "Stopped: press Release the stop first.";

const linkWord = ({ link }: DroneState): Word =>
  link === "heard" ? { kind: "good", text: "Link" } : { kind: "bad", text: "Link lost" };

/** Return whether the failsafe has stopped the motors, and neither Arm nor Disarm has acknowledged it. */
export const stoppedByFailsafe = (state: DroneState): boolean =>
  !state.armed && !state.killed && state.failsafe === "off";

export function armedWord(state: DroneState, heard = state.link === "heard"): Word {
  if (!heard) return { kind: "plain", text: `${armedWord(state, true).text} when last heard` };
  if (state.killed) return { kind: "bad", text: "Stopped" };
  if (stoppedByFailsafe(state)) return { kind: "bad", text: "Stopped by the failsafe" };
  return state.armed ? { kind: "warn", text: "Armed" } : { kind: "plain", text: "Disarmed" };
}

export function failsafeWord(state: DroneState): Word {
  if (!state.armed && !stoppedByFailsafe(state)) return { kind: "plain", text: "Failsafe ready" };
  if (state.failsafe === "none") return { kind: "good", text: "Failsafe watches" };
  return { kind: state.failsafe === "off" ? "bad" : "warn", text: `Failsafe: ${state.failsafe}` };
}

export function leaseWord(state: DroneState, watches = false, heard = state.link === "heard"): Word {
  if (!heard) return { kind: "plain", text: "Command unknown" };
  if (state.ours_leases) return { kind: "good", text: watches ? "Commanded from a page" : "You command" };
  if (state.lease_holder === null) return { kind: "plain", text: "Not commanded" };
  if (state.experiment) return { kind: "good", text: "Commanded by an experiment" };
  return { kind: "warn", text: `Commanded by client ${state.lease_holder[0]}` };
}

/** Return the words of a drone's state in the order of the status bar. */
export function stateWords(state: DroneState, watches = false): Word[] {
  return [
    linkWord(state),
    armedWord(state),
    { kind: "plain", text: modeWord(state) },
    { ...failsafeWord(state), title: failsafeSentence(state) },
    leaseWord(state, watches),
  ];
}

export const modeWord = ({ mode }: DroneState): string => mode.charAt(0).toUpperCase() + mode.slice(1);

export function controllerWords({ controller, changed_parameters: changed }: DroneState): string {
  return `${controller || "unknown"}${changed ? `, ${changed} ${changed === 1 ? "parameter" : "parameters"} changed` : ""}`;
}
