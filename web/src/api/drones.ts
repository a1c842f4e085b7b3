import { get, send } from "./client";

/** How a drone stands, as the server last told it; angles in radians, all else SI. */
export interface DroneState {
  /** Its MAVLink system: the number by which calls name it. */
  system: number;
  name: string;
  url: string;
  link: "heard" | "lost";
  /** One of ours, not another's PX4. */
  ours: boolean;
  virtual: boolean;
  armed: boolean;
  mode: string;
  /** "off": pressed, it may be armed. */
  safety_switch: "on" | "off";
  killed: boolean;
  killed_by: readonly [number, number] | null;
  /** What the failsafe does: "none", "level", "brake", "descend", "off". */
  failsafe: string;
  /** What decided, in words. */
  failsafe_reason: string;
  /** What it sees now, in words: it speaks against arming. */
  warnings: readonly string[];
  /** The system and component that command it; null for nobody. */
  lease_holder: readonly [number, number] | null;
  /** Whether this server holds the lease. */
  ours_leases: boolean;
  /** An experiment that this server began flies it. */
  experiment?: boolean;
  controller: string;
  /** How many parameters differ from their defaults. */
  changed_parameters: number;
  rings_locked: boolean;
  seed: number;
  battery: { voltage: number | null; charge: number | null };
  /** Drone time [s]. */
  time: number;
  rig: string;
}

/** A line that a drone said; `time` is the drone's [s], null where it is not known. */
export interface DroneText {
  drone: number;
  severity: string;
  text: string;
  time: number | null;
}

/** The loops that take a set-point. */
export type Loop = "theta" | "q" | "M" | "v" | "x";

/** How a virtual drone begins anew. */
export interface Reset {
  seed: number;
  /** Place on the rail [m]. */
  x: number;
  /** Gain of its noise; 0 is none. */
  noise: number;
  rings: boolean;
}

/** An excitation in the form of the library's `to_dict`, in SI. */
export type Excitation = { kind: string; version: number } & Record<string, unknown>;

export const listDrones = () => get<DroneState[]>("drones");

/** What it said before this page was opened, the oldest first. */
export const listTexts = (drone: number) => get<{ severity: string; text: string }[]>(`drones/${drone}/texts`);

export const arm = (drone: number) => send<DroneState>("POST", `drones/${drone}/arm`);
export const disarm = (drone: number) => send<DroneState>("POST", `drones/${drone}/disarm`);
export const release = (drone: number) => send<DroneState>("POST", `drones/${drone}/release`);
export const setMode = (drone: number, mode: string) => send<DroneState>("POST", `drones/${drone}/mode`, { mode });
export const takeLease = (drone: number) => send<DroneState>("POST", `drones/${drone}/lease`);
export const giveLeaseBack = (drone: number) => send<DroneState>("DELETE", `drones/${drone}/lease`);
export const reset = (drone: number, how: Reset) => send<DroneState>("POST", `drones/${drone}/reset`, how);

/** A set-point in SI; `thrust` 0 to 1, left out: as it is. The server keeps it alive. */
export function setSetpoint(drone: number, loop: Loop, value: number, thrust?: number): Promise<DroneState> {
  const asked = thrust === undefined ? { loop, value } : { loop, value, thrust };
  return send<DroneState>("PUT", `drones/${drone}/setpoint`, asked);
}

/** Plays it on board, added to what `loop` follows; answers when it starts. */
export function excite(drone: number, loop: Loop, excitation: Excitation): Promise<{ duration: number }> {
  return send("POST", `drones/${drone}/excitation`, { excitation, loop });
}
export const stopExcitation = (drone: number) => send<DroneState>("DELETE", `drones/${drone}/excitation`);
