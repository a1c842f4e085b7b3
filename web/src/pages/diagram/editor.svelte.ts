// The editor: which diagram is open, where in it one is, what is selected, what was done. All edits go through `apply`.
import { patiently } from "../../api/client";
import * as api from "../../api/diagrams";
import { toastError } from "../../state/toasts.svelte";
import type { Opened } from "./address";
import { presumed } from "./canvas/arrange";
import { staying } from "./canvas/places";
import { diagramAt, EMPTY, partId, readDiagram, writeDiagram, type Diagram } from "./model/diagram";
import { edited, EditFault, settled } from "./model/edits";
import { History } from "./model/history.svelte";
import { writeJson } from "./model/json_text";
import { Shapes } from "./model/shapes";

class Editor {
  root = $state.raw<Diagram>(EMPTY);
  path = $state.raw<readonly string[]>([]);
  selected = $state.raw<ReadonlySet<string>>(new Set());
  catalogue = $state.raw<api.Catalogue | undefined>(undefined);
  /** Saved name, or "". */
  file = $state("");
  /** Starter that was opened, or "". */
  starter = $state("");
  saved = $state.raw<Diagram>(EMPTY);
  opened = $state(0);
  /** Announcement for screen readers. */
  said = $state("");
  /** Counter of learnt shapes; drawings depend on it. */
  known = $state(0);
  readonly shapes = new Shapes();
  readonly history = new History();
  private asked = new Set<string>();

  readonly here: Diagram = $derived(diagramAt(this.root, this.path) ?? this.root);
  readonly dirty: boolean = $derived(this.root !== this.saved);

  readonly parts: string[] = $derived([...this.selected].filter((id) => id.startsWith("p:")).map((id) => id.slice(2)));

  async start(): Promise<void> {
    if (this.catalogue !== undefined) return;
    const found = await patiently(api.catalogue);
    for (const entry of found.blocks) {
      this.shapes.learn(writeJson({ type: entry.type, config: entry.config }), entry.shape);
    }
    this.catalogue = found;
    this.known++;
  }

  /** Open a diagram's text. Raises JsonFault or DiagramFault. */
  async open(text: string, { file, starter }: Opened): Promise<void> {
    const read = readDiagram(text);
    await this.learn(read);
    const diagram = await presumed(read, this.shapes);
    this.root = this.saved = diagram;
    this.path = [];
    this.selected = new Set();
    this.file = file;
    this.starter = starter;
    this.history.clear();
    this.opened++;
    this.say(`${diagram.name} is open: ${diagram.parts.length} block${diagram.parts.length === 1 ? "" : "s"}`);
  }

  get text(): string {
    return writeDiagram(this.root);
  }

  /** Ask the server for the shapes of new blocks. */
  async learn(diagram: Diagram): Promise<void> {
    const unknown = [...this.shapes.unknown(diagram).keys()].filter((key) => !this.asked.has(key));
    for (let at = 0; at < unknown.length; at += 500) {
      const keys = unknown.slice(at, at + 500);
      keys.forEach((key) => this.asked.add(key));
      try {
        const answers = await patiently(() => api.shapes(keys));
        keys.forEach((key, i) => this.shapes.learn(key, answers[i]!));
      } catch (failure) {
        toastError(failure);
      } finally {
        keys.forEach((key) => this.asked.delete(key));
      }
    }
    if (unknown.length > 0) this.known++;
  }

  /** Edit the open sheet, or that at `path`. Returns "" or why it was refused. */
  apply(called: string, edit: (d: Diagram) => Diagram, tag = "", path = this.path): string {
    const before = this.root;
    let after: Diagram;
    try {
      after = edited(before, path, edit);
      // The sheets around it too: a sub-diagram with another port has another size.
      for (let depth = path.length; depth >= 0; depth--) {
        const at = path.slice(0, depth);
        const was = diagramAt(before, at)!;
        after = edited(after, at, (d) => (d === was ? d : settled(staying(was, d, this.shapes))));
      }
    } catch (failure) {
      if (!(failure instanceof EditFault)) throw failure;
      this.say(failure.message);
      return failure.message;
    }
    if (after === before) return "";
    this.history.record(before, after, called, tag);
    this.root = after;
    void this.learn(after);
    if (tag === "") this.say(called);
    return "";
  }

  undo(): void {
    const step = this.history.undo();
    if (step === undefined) return this.say("nothing to undo");
    this.show(step.before, `undone: ${step.called}`);
  }

  redo(): void {
    const step = this.history.redo();
    if (step === undefined) return this.say("nothing to redo");
    this.show(step.after, `redone: ${step.called}`);
  }

  private show(diagram: Diagram, said: string): void {
    this.root = diagram;
    while (diagramAt(diagram, this.path) === undefined) this.path = this.path.slice(0, -1);
    this.say(said);
  }

  select(ids: Iterable<string>): void {
    const next = new Set(ids);
    if (next.size === this.selected.size && [...next].every((id) => this.selected.has(id))) return;
    this.selected = next;
  }

  enter(path: readonly string[]): void {
    const there = diagramAt(this.root, path);
    if (there === undefined) return;
    this.path = path;
    this.selected = new Set();
    this.say(`${path.at(-1) ?? this.root.name}: ${there.parts.length} block${there.parts.length === 1 ? "" : "s"}`);
  }

  leave(): void {
    const from = this.path.at(-1);
    if (from === undefined) return;
    this.enter(this.path.slice(0, -1));
    this.select([partId(from)]);
  }

  say(text: string): void {
    // The same words again are told again.
    this.said = this.said === text ? `${text}\u00a0` : text;
  }
}

export const editor = new Editor();
