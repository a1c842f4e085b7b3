import { get, send } from "./client";

/** Latest state of a drone; SI and radians. */
export interface DroneState {
  /** MAVLink system. */
  system: number;
  name: string;
  link: "heard" | "lost";
  virtual: boolean;
  armed: boolean;
  mode: string;
  /** "off": pressed, it may be armed. */
  safety_switch: "on" | "off";
  killed: boolean;
  killed_by: readonly [number, number] | null;
  ours_killed: boolean;
  /** What the failsafe does: "none", "level", "brake", "descend", "off". */
  failsafe: string;
  failsafe_reason: string;
  /** Reasons against arming. */
  warnings: readonly string[];
  /** System and component; null for none. */
  lease_holder: readonly [number, number] | null;
  ours_leases: boolean;
  experiment?: boolean;
  setpoint?: { loop: Loop; value: number; thrust?: number | null } | null;
  /** Ticks of the excitation of this server that plays, or null. */
  excitation?: { start_tick: number; end_tick: number } | null;
  controller: string;
  changed_parameters: number;
  rings_locked: boolean;
  seed: number;
  noise: number;
  battery: { voltage: number | null; charge: number | null };
}

/** Log message of a drone; `time` in drone time [s]. */
export interface DroneText {
  drone: number;
  severity: string;
  text: string;
  time: number | null;
}

/** Set-points by their names in telemetry. */
export type Loop = "theta" | "q" | "M" | "v" | "x";

export interface Reset {
  seed: number;
  x: number;
  noise: number;
  rings: boolean;
}

export type Excitation = { kind: string; version: number } & Record<string, unknown>;

export const listDrones = () => get<DroneState[]>("drones");

export const listTexts = (drone: number) => get<{ severity: string; text: string }[]>(`drones/${drone}/texts`);

export const arm = (drone: number) => send<DroneState>("POST", `drones/${drone}/arm`);
export const disarm = (drone: number) => send<DroneState>("POST", `drones/${drone}/disarm`);
export const release = (drone: number) => send<DroneState>("POST", `drones/${drone}/release`);
export const setMode = (drone: number, mode: string) => send<DroneState>("POST", `drones/${drone}/mode`, { mode });
export const takeLease = (drone: number) => send<DroneState>("POST", `drones/${drone}/lease`);
export const giveLeaseBack = (drone: number) => send<DroneState>("DELETE", `drones/${drone}/lease`);
export const reset = (drone: number, how: Reset) => send<DroneState>("POST", `drones/${drone}/reset`, how);
/** Put a virtual drone to the middle of the rail, at rest. */
export const restart = ({ system, seed, noise, rings_locked }: DroneState, rings = rings_locked) =>
  reset(system, { seed: seed || 1, x: 0, noise, rings });

/** Set a set-point, SI. The server repeats it to the drone. */
export function setSetpoint(drone: number, loop: Loop, value: number, thrust?: number): Promise<DroneState> {
  const asked = thrust === undefined ? { loop, value } : { loop, value, thrust };
  return send<DroneState>("PUT", `drones/${drone}/setpoint`, asked);
}

/** Play an excitation on board, added to a set-point. Resolves when it starts. */
export function excite(drone: number, loop: Loop, excitation: Excitation): Promise<{ duration: number }> {
  return send("POST", `drones/${drone}/excitation`, { excitation, loop });
}
export const stopExcitation = (drone: number) => send<DroneState>("DELETE", `drones/${drone}/excitation`);
