import { ApiError, request, messageOf } from "../api/client";
import { session } from "./session.svelte";

/** Key of the emergency stop, with Shift for all drones. No other control may use it. */
export const STOP_KEY = "F8";

const TRIES = 5;
const WAIT_MS = 300;
const TRY_S = 6;
/** A stop that does not reach the server is sent again for so long: later it would surprise another flight. */
export const LONGEST_MS = 60_000;

export type Stop =
  | { kind: "idle" }
  | { kind: "sent" | "waiting"; drones: number[]; until: Date }
  | { kind: "done"; drones: number[] }
  | { kind: "failed"; drones: number[]; why: string };

/** Emergency stop: motors off, whoever commands. Repeats the kill until it is confirmed. */
class EmergencyStop {
  last = $state<Stop>({ kind: "idle" });
  private presses = 0;

  async press(all = false): Promise<void> {
    await this.stop(all ? [...session.numbers] : session.number === undefined ? [] : [session.number]);
  }

  async stop(drones: number[]): Promise<void> {
    if (drones.length === 0) return;
    const mine = (this.presses += 1);
    const until = new Date(Date.now() + LONGEST_MS);
    this.last = { kind: "sent", drones, until };
    const goesOn = (): boolean => {
      if (mine !== this.presses || Date.now() >= until.getTime()) return false;
      this.last = { kind: "waiting", drones, until };
      return true;
    };
    const answers = await Promise.all(drones.map((drone) => killed(drone, goesOn)));
    if (mine !== this.presses) return;
    const why = answers.filter((answer) => answer !== "").join(" ");
    this.last = why === "" ? { kind: "done", drones } : { kind: "failed", drones, why };
  }

  /** Close the message; a stop that waits is not sent again. */
  putAway(): void {
    this.presses += 1;
    this.last = { kind: "idle" };
  }

  /** Listen for the key before any control of the page. */
  listen(): () => void {
    const heard = (event: KeyboardEvent) => {
      if (event.key !== STOP_KEY) return;
      event.preventDefault();
      event.stopImmediatePropagation();
      if (!event.repeat) void this.press(event.shiftKey);
    };
    addEventListener("keydown", heard, { capture: true });
    return () => removeEventListener("keydown", heard, { capture: true });
  }
}

/** Kill a drone. Returns "" or why it is not confirmed. While the server is not reached, `goesOn` decides. */
async function killed(drone: number, goesOn: () => boolean): Promise<string> {
  let why = "";
  for (let attempt = 0; attempt < TRIES;) {
    try {
      await request("POST", `drones/${drone}/kill`, undefined, TRY_S);
      return "";
    } catch (failure) {
      why = messageOf(failure);
      // What is refused stays refused; what did not arrive, or was not seen, is said again.
      if (failure instanceof ApiError && [401, 403, 404].includes(failure.status)) return why;
      const unreached = failure instanceof ApiError && failure.status === 0;
      if (!unreached) attempt += 1;
      else if (!goesOn()) return why;
      await new Promise((done) => setTimeout(done, WAIT_MS));
      if (unreached && !goesOn()) return why; // withdrawn meanwhile
    }
  }
  return why;
}

export const emergencyStop = new EmergencyStop();
