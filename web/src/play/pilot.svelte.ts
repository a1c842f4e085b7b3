import type { Command, Flight, Safety, Start } from "./flight";
import { KNOBS, MODES, type FlyMode } from "./knobs";

/** Half a period of the automatic steps [s]. */
const HALF = 2.5;

export class Pilot {
  start: Start = $state({ rig: "lab", seed: 1, noise: true, rings: true });
  mode: FlyMode = $state.raw(MODES[0]!);
  wanted = $state(0);
  armed = $state(true);
  link = $state(true);
  running = $state(true);
  speed = $state(1);
  stepping = $state(true);
  values: Record<string, number> = $state({});
  refusal = $state("");
  safety: Safety = $state.raw({ state: "", action: "", reasons: [] });
  private readonly defaults: Record<string, number>;
  private frame = 0;
  private before = 0;
  private owed = 0;
  private charge = 1;

  constructor(readonly flight: Flight) {
    this.values = Object.fromEntries(KNOBS.map(({ path }) => [path, flight.get(path)]));
    this.defaults = { ...this.values };
    this.take(new URLSearchParams(location.hash.replace(/^#/, "")));
    this.again();
  }

  default(path: string): number {
    return this.defaults[path] ?? NaN;
  }

  again(change: Partial<Start> = {}): void {
    Object.assign(this.start, change);
    const troubles = { ...this.values };
    this.owed = 0; // what the flight before has left of a control step
    this.flight.start(this.start);
    // The rig's own are set by the start; what the person has set stays.
    this.flight.set(troubles);
    this.flight.charge(this.charge);
    this.armed = true;
    this.link = true;
    this.refusal = "";
    this.show();
  }

  setCharge(share: number): void {
    this.charge = share;
    this.flight.charge(share);
  }

  set(path: string, value: number): void {
    try {
      this.flight.set({ [path]: value });
      this.values[path] = value;
      this.refusal = "";
    } catch (reason) {
      this.refusal = reason instanceof Error ? reason.message : String(reason);
    }
    this.show();
  }

  choose(mode: FlyMode): void {
    this.mode = mode;
    this.wanted = 0;
    if (this.start.rings && mode.movesCart) this.again({ rings: false }); // they lock the cart
    this.show();
  }

  /** Fly in real time. Returns a function that ends it. */
  fly(): () => void {
    const turn = (now: number): void => {
      this.frame = requestAnimationFrame(turn);
      const passed = this.before ? Math.min(0.25, (now - this.before) / 1000) : 0;
      this.before = now;
      if (this.running) this.advance(passed * this.speed);
    };
    this.frame = requestAnimationFrame(turn);
    return () => cancelAnimationFrame(this.frame);
  }

  advance(seconds: number): void {
    this.owed += seconds / this.flight.period;
    const steps = Math.floor(this.owed);
    this.owed -= steps;
    const half = Math.round(HALF / this.flight.period);
    for (let left = steps; left > 0;) {
      const at = this.flight.steps;
      let count = left;
      if (this.stepping) {
        const up = Math.floor(at / half) % 2 === 1;
        this.wanted = up ? this.mode.step : this.mode.name === "velocity" ? -this.mode.step : 0;
        count = Math.min(left, half - (at % half)); // it steps in the control step, not in the frame
      }
      this.flight.advance(count, this.command());
      left -= count;
    }
    const now = this.flight.safety();
    if (now.state !== this.safety.state || now.reasons.join() !== this.safety.reasons.join()) this.safety = now;
  }

  private command(): Command {
    const none = { theta: 0, q: 0, x: 0, v: 0 };
    return {
      ...none,
      [this.mode.loop]: this.wanted,
      mode: this.mode.mode,
      thrust: 0.4,
      arm: this.armed,
      link: this.link,
    };
  }

  /** Write the changed settings into the address. */
  show(): void {
    const said = new URLSearchParams();
    for (const { path, key } of KNOBS)
      if (this.values[path] !== this.defaults[path]) said.set(key, String(this.values[path]));
    if (this.mode.name !== "attitude") said.set("mode", this.mode.name);
    if (this.start.rig !== "lab") said.set("rig", this.start.rig);
    if (this.start.seed !== 1) said.set("seed", String(this.start.seed));
    if (!this.start.noise) said.set("noise", "0");
    if (!this.start.rings) said.set("rings", "0");
    const link = said.size ? `#${said}` : location.pathname;
    if (location.hash !== `#${said}`) history.replaceState(null, "", link);
  }

  private take(said: URLSearchParams): void {
    for (const { path, key } of KNOBS) if (said.has(key)) this.set(path, Number(said.get(key)));
    this.mode = MODES.find((one) => one.name === said.get("mode")) ?? this.mode;
    if (said.get("rig") === "paper") this.start.rig = "paper";
    const seed = Number(said.get("seed") ?? 1);
    if (Number.isInteger(seed) && seed >= 0 && seed < 2 ** 32) this.start.seed = seed;
    this.start.noise = said.get("noise") !== "0";
    this.start.rings = said.get("rings") !== "0" && !this.mode.movesCart;
  }
}
