import { ApiError, messageOf } from "../../api/client";
import { listModels, type ModelRow } from "../../api/models";
import type { Change, ParameterRow, PredictedStep, Preview } from "../../api/tuning";
import * as api from "../../api/tuning";
import { telemetry } from "../../api/telemetry";
import { toast, toastError, tried } from "../../state/toasts.svelte";
import { LatestOnly } from "../fly/latest_only";
import { asRecord, differences, withChanges, type Edits } from "./draft";

const WAIT_MS = 200;
const AGAIN_MS = 2000;
const TOO_SLOW = 504;
type For<Found> = Found & { changes: readonly Change[] };
/** Latest preview of each drone and model, shown where the page is opened again, until the next is there. */
const LAST = new Map<string, For<Preview>>();

/** Parameters of one drone: edits, preview and sent changes. */
export class Tuning {
  rows = $state.raw<readonly ParameterRow[]>([]);
  edits = $state.raw<Edits>(new Map());
  /** Parameters with a refused value in their field. */
  wrong = $state.raw<readonly string[]>([]);
  /** Models of the pitch; undefined until loaded. */
  models = $state.raw<readonly ModelRow[] | undefined>(undefined);
  model = $state<string | null>(null);
  /** Size of the predicted step [rad]. */
  goal = $state((10 * Math.PI) / 180);
  preview = $state.raw<For<Preview> | undefined>(undefined);
  /** Step that the slider has reached; undefined once the preview is there. */
  step = $state.raw<For<PredictedStep> | undefined>(undefined);
  /** Send when a slider is let go. */
  atRelease = $state(false);
  refused = $state("");
  previewing = $state(false);
  sending = $state(false);
  failure = $state("");
  loaded = $state(false);
  /** Last change by the server's pages that can be undone: also after another page, or a reload. */
  last = $state.raw<readonly Change[]>([]);
  readonly byName: ReadonlyMap<string, ParameterRow> = $derived(new Map(this.rows.map((row) => [row.name, row])));
  readonly changes = $derived(differences(this.rows, this.edits));
  /** Preview of the present edits; undefined while it is outdated. */
  readonly judged = $derived(
    JSON.stringify(this.preview?.changes) === JSON.stringify(this.changes) ? this.preview : undefined,
  );
  readonly outdated = $derived(this.previewing || (this.preview !== undefined && !this.judged));

  private asked = "";
  private asking = { question: "", done: Promise.resolve() };
  private waiting: ReturnType<typeof setTimeout> | undefined;
  private readonly previews = new LatestOnly<readonly Change[]>(
    (changes) => this.ask(changes),
    () => {},
  );
  private readonly steps = new LatestOnly<readonly Change[]>(
    async (changes) => {
      const found = await api.predictStep(this.drone, asRecord(changes), this.goal);
      if ("bands" in found && !this.judged) this.step = { ...found, changes };
    },
    () => {}, // the preview says what is wrong
  );

  constructor(readonly drone: number) {}

  /** Start; returns a function that stops it. */
  start(): () => void {
    void this.load();
    const timer = setInterval(() => this.loaded && this.rows.length === 0 && void this.load(), AGAIN_MS);
    const stop = telemetry.onEvent((event) => {
      // Somebody else tunes it too, a script perhaps.
      if (event.event === "parameters" && event.drone === this.drone) void this.refresh();
    });
    return () => (stop(), clearInterval(timer));
  }

  async load(): Promise<void> {
    await this.refresh();
    await this.loadModels();
    this.loaded = true;
    this.preview = LAST.get(`${this.drone} ${this.model}`);
    this.askSoon();
  }

  private async loadModels(): Promise<void> {
    await tried(async () => {
      const [models, guard] = await Promise.all([listModels(), api.guardOf(this.drone)]);
      this.models = models.filter((one) => one.pitch);
      this.model = guard.model;
    });
    this.models ??= [];
  }

  async choose(model: string | null): Promise<void> {
    await tried(async () => {
      this.model = (await api.chooseGuard(this.drone, model)).model;
      this.asked = "";
      this.askSoon();
    });
  }

  markWrong(name: string, wrong: boolean): void {
    this.wrong = wrong ? [...this.wrong, name] : this.wrong.filter((one) => one !== name);
  }

  edit(name: string, value: number): void {
    this.put(new Map(this.edits).set(name, value));
  }

  /** Send what a slider has changed, if that is wished and the model finds no unstable drone. */
  async released(): Promise<void> {
    if (!this.atRelease || this.changes.length === 0 || this.sending) return;
    if (await this.unstable()) this.failure = "Not sent: these gains may be unstable. Press Send.";
    else await this.send();
  }

  /** Return whether the model finds drones that the present edits make unstable; asks if the preview is outdated. */
  async unstable(): Promise<boolean> {
    clearTimeout(this.waiting);
    if (this.model !== null && !this.judged) await this.ask(this.changes);
    return this.judged !== undefined && this.judged.unstable && this.judged.touches;
  }

  take(changes: readonly Change[]): void {
    this.put(withChanges(this.rows, this.edits, changes));
  }

  forget(name?: string): void {
    const next = new Map(name === undefined ? [] : this.edits);
    if (name !== undefined) next.delete(name);
    this.put(next);
  }

  private put(edits: Edits): void {
    this.edits = edits;
    this.failure = "";
    this.askSoon();
  }

  /** Send all edits in one transaction; `confirm` is the token of an unstable preview. */
  async send(confirm = ""): Promise<boolean> {
    this.sending = true;
    this.failure = "";
    try {
      const { changed } = await api.changeParameters(this.drone, asRecord(this.changes), confirm);
      // At once, and not with the list that comes next: until then an edit would be compared with what was before.
      const now = new Map(changed.map((one) => [one.name, one.value]));
      this.rows = this.rows.map((row) => ({ ...row, value: now.get(row.name) ?? row.value }));
      this.edits = new Map();
      toast(`Sent: ${changed.map(({ name }) => this.byName.get(name)?.label ?? name).join(", ")}`, "good");
      await this.refresh();
      return true;
    } catch (failure) {
      this.failure = messageOf(failure);
      return false;
    } finally {
      this.sending = false;
      this.askSoon();
    }
  }

  async undo(): Promise<void> {
    const { last } = this;
    if (last.length === 0) return;
    try {
      await api.undoChange(this.drone);
      toast("The last change was undone", "good");
      await this.refresh();
      this.askSoon();
    } catch (failure) {
      if (!(failure instanceof ApiError && failure.status === 409)) return void toastError(failure);
      // It can be looked at, and sent as any change can, once more confirmed where the model does not keep it stable.
      this.take(last.map((one) => ({ ...one, before: one.value, value: one.before })));
      this.failure = `Not undone: ${failure.what}. The earlier values are in the fields: check them, then send.`;
    }
  }

  askSoon(): void {
    clearTimeout(this.waiting);
    if (this.model !== null && this.changes.length > 0) this.steps.give(this.changes);
    this.waiting = setTimeout(() => {
      if (this.model !== null) this.previews.give(this.changes);
      else this.preview = undefined;
    }, WAIT_MS);
  }

  private async refresh(): Promise<void> {
    try {
      const [rows, guard] = await Promise.all([api.listParameters(this.drone), api.guardOf(this.drone)]);
      this.rows = rows;
      this.last = guard.undo;
      this.failure = "";
    } catch (failure) {
      this.failure = messageOf(failure);
    }
  }

  /** Ask for the preview of these changes, unless it is there or under way. */
  private ask(changes: readonly Change[]): Promise<void> {
    const question = JSON.stringify([changes, this.goal, this.model, this.rows.map((row) => row.value)]);
    if (question === this.asked) return Promise.resolve();
    if (!this.previewing || question !== this.asking.question)
      this.asking = { question, done: this.find(changes, question) };
    return this.asking.done;
  }

  private async find(changes: readonly Change[], question: string): Promise<void> {
    this.previewing = true;
    try {
      const found = await api.previewTuning(this.drone, asRecord(changes), this.goal);
      this.preview = "bands" in found ? { ...found, changes } : undefined;
      if (this.preview) LAST.set(`${this.drone} ${this.model}`, this.preview);
      this.step = undefined;
      this.asked = question;
      this.refused = found.why;
    } catch (failure) {
      this.preview = undefined;
      this.refused = messageOf(failure);
      if (failure instanceof ApiError && failure.status === TOO_SLOW) this.askSoon(); // a busy computer: once more
    } finally {
      this.previewing = false;
    }
  }
}
