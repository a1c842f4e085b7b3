import { route } from "../app/route.svelte";
import { ApiError, labSession, TOKEN } from "../api/client";
import { listDrones, listTexts, type DroneState, type DroneText } from "../api/drones";
import { telemetry, type LabEvent, type Telemetry } from "../api/telemetry";
import { ClockWatch, type ClockEvent } from "./clock_watch";
import { toast, toastError, tried } from "./toasts.svelte";

const TEXTS_KEPT = 500;
const LOOK_MS = 1000;

class Session {
  /** By number. */
  drones = $state.raw<ReadonlyMap<number, DroneState>>(new Map());
  /** A watcher may only stop drones. */
  role = $state<"command" | "watch">("command");
  readonly watchOnly = $derived(this.role === "watch" ? "This link can only watch." : "");
  connected = $state(false);
  /** The server is there and refuses the token: it is of an earlier start. */
  refused = $state(false);
  /** Why the server cannot be reached, or "". */
  readonly serverLost = $derived(
    this.connected ? "" : this.refused ? "The server does not accept this link." : "No connection to the server.",
  );
  /** Why nothing can be changed, or "". The emergency stop is never off. */
  readonly off = $derived(this.serverLost || this.watchOnly);
  texts = $state.raw<readonly DroneText[]>([]);
  clockEvent = $state<ClockEvent | undefined>(undefined);
  everConnected = $state(false);
  /** `tellOnce` waits for an answer. */
  busy = $state(false);
  readonly numbers = $derived([...this.drones.keys()].sort((a, b) => a - b));
  /** Drone of the last link that named one; links to logs name none. */
  private named = $state<string | null>(route.now.query.get("drone"));
  readonly number = $derived(chosen(route.now.query.get("drone") ?? this.named, this.numbers));
  readonly drone = $derived(this.number === undefined ? undefined : this.drones.get(this.number));
  /** Why the chosen drone cannot be commanded, or "". */
  readonly droneOff = $derived(this.off || (this.drone?.link === "lost" ? "The link is lost." : ""));

  private readonly clocks = new ClockWatch();

  start(from: Telemetry = telemetry): void {
    from.onEvent((event) => this.take(event));
    from.onConnection((connected) => {
      if (connected && !this.connected) {
        void this.catchUp();
        if (this.everConnected) toast("Connected to the server again.", "good");
      }
      this.connected = connected;
      this.everConnected ||= connected;
      if (connected) this.refused = false;
      else void this.lookForRefusal();
    });
    from.start();
    setInterval(() => this.lookAtClocks(), LOOK_MS);
    addEventListener("online", () => from.hurry());
    addEventListener("hashchange", () => (this.named = route.now.query.get("drone") ?? this.named));
    const back = () => {
      this.lookAtClocks();
      if (!document.hidden) from.hurry();
    };
    document.addEventListener("visibilitychange", back);
    document.addEventListener("resume", back);
  }

  choose(drone: number): void {
    this.named = String(drone);
    route.ask({ drone: String(drone) });
  }

  /**
   * Calls what tells the chosen drone to do something; shows the server's sentence where it is refused. Answers whether
   * it was done.
   */
  async tell(call: (drone: number) => Promise<unknown>): Promise<boolean> {
    const { number } = this;
    return number !== undefined && tried(() => call(number));
  }

  /** Tell the drone one thing at a time: presses meanwhile are ignored, as a disabled button would lose the focus. */
  async tellOnce(call: (drone: number) => Promise<unknown>): Promise<void> {
    if (this.busy) return;
    this.busy = true;
    await this.tell(call);
    this.busy = false;
  }

  private take(event: LabEvent): void {
    if (event.event === "drone") {
      this.drones = new Map(this.drones).set(event.drone, event.state);
    } else if (event.event === "text") {
      const { drone, severity, text, time } = event;
      this.texts = [...this.texts, { drone, severity, text, time }].slice(-TEXTS_KEPT);
    }
  }

  /** Load what was missed while disconnected. */
  private async catchUp(): Promise<void> {
    try {
      const [drones, me] = await Promise.all([listDrones(), labSession()]);
      this.drones = new Map(drones.map((one) => [one.system, one]));
      this.role = me.role;
      const said = await Promise.all(drones.filter((one) => one.link === "heard").map((one) => before(one.system)));
      // What was said since the socket is open came over it as well.
      if (this.texts.length === 0) this.texts = said.flat().slice(-TEXTS_KEPT);
    } catch (failure) {
      if (!(failure instanceof ApiError && failure.status === 0)) toastError(failure);
    }
  }

  /** A socket does not tell why it is closed; an answer does. */
  private async lookForRefusal(): Promise<void> {
    try {
      await labSession();
    } catch (failure) {
      this.refused = !this.connected && failure instanceof ApiError && failure.status === 401;
      if (this.refused) sessionStorage.removeItem(TOKEN); // a server that was started without one lets this page in
    }
  }

  private lookAtClocks(): void {
    const noticed = this.clocks.look();
    if (noticed === undefined) return;
    this.clockEvent = noticed;
    // What was told meanwhile may have been let go; how all stands now is asked for.
    if (this.connected) void this.catchUp();
  }
}

async function before(drone: number): Promise<DroneText[]> {
  return (await listTexts(drone)).map((one) => ({ drone, ...one, time: null }));
}

function chosen(asked: string | null, numbers: readonly number[]): number | undefined {
  const wanted = asked === null ? NaN : Number(asked);
  return numbers.includes(wanted) ? wanted : numbers[0];
}

export const session = new Session();
