// Checks of the diagram's wires and blocks: asked of the server a moment after each change.
import * as api from "../../api/diagrams";
import { messageOf, patiently } from "../../api/client";
import { editor } from "./editor.svelte";
import type { Diagram } from "./model/diagram";
import { loopOnSheet, placeOfFinding, seenFrom, type Place } from "./model/blame";

const WAIT_MS = 60;
/** A diagram that takes too long each time is too large. */
const MOST_TRIES = 3;

export interface Found extends api.Finding {
  readonly place: Place;
  readonly kind: "problem" | "remark";
}

class Findings {
  checked = $state.raw<api.Check | undefined>(undefined);
  of = $state.raw<Diagram | undefined>(undefined);
  failure = $state("");
  busy = $state(false);
  private timer: ReturnType<typeof setTimeout> | undefined;

  readonly all: Found[] = $derived.by(() => {
    const root = this.of;
    if (root === undefined || this.checked === undefined) return [];
    const { problems, remarks, template } = this.checked;
    const placed = (kind: "problem" | "remark") => (one: api.Finding) => ({
      ...one,
      kind,
      place: placeOfFinding(root, one.where),
    });
    const misfits = (template !== null && !template.fits ? template.faults : []).map((what) => ({
      what,
      where: "",
      remedy: `the template ${template?.name} asks for it; without it the diagram does not fly`,
    }));
    return [...problems.map(placed("problem")), ...misfits.map(placed("remark")), ...remarks.map(placed("remark"))];
  });

  readonly problems: Found[] = $derived(this.all.filter((one) => one.kind === "problem"));

  /** Problems by id on the open sheet. */
  readonly byId: ReadonlyMap<string, string> = $derived.by(() => {
    void editor.known;
    const found = new Map<string, string>();
    const add = (id: string, what: string): void => {
      if (id !== "") found.set(id, found.has(id) ? `${found.get(id)}\n${what}` : what);
    };
    for (const one of this.problems) {
      const signals = one.loop ?? [];
      const ids =
        signals.length > 0
          ? signals.map((s) => seenFrom(editor.path, placeOfFinding(this.of!, s)))
          : [seenFrom(editor.path, one.place)];
      for (const id of new Set(ids)) add(id, `${one.what}: ${one.remedy}`);
    }
    for (const part of editor.here.parts) {
      const refusal = editor.shapes.refusal(part.item);
      const id = `p:${part.name}`;
      if (refusal !== undefined && !found.has(id)) add(id, `${refusal.what}: ${refusal.remedy}`);
    }
    return found;
  });

  readonly loop: ReadonlySet<string> = $derived.by(() => {
    const found = new Set<string>();
    for (const one of this.problems) {
      if (one.loop === undefined || this.of === undefined) continue;
      for (const id of loopOnSheet(this.of, editor.path, editor.here, one.loop)) found.add(id);
    }
    return found;
  });

  changed(root: Diagram): void {
    clearTimeout(this.timer);
    this.timer = setTimeout(() => void this.look(root), WAIT_MS);
  }

  private async look(root: Diagram): Promise<void> {
    if (this.busy) return this.changed(root); // one at a time: the latest counts
    this.busy = true;
    let tries = 0;
    try {
      const checked = await patiently(
        () => api.check(editor.text),
        () => editor.root !== root || (tries += 1) === MOST_TRIES,
      );
      if (editor.root === root) {
        [this.checked, this.of, this.failure] = [checked, root, ""];
      }
    } catch (failure) {
      this.failure = messageOf(failure);
    } finally {
      this.busy = false;
    }
    if (editor.root !== root) this.changed(editor.root);
  }
}

export const findings = new Findings();
