// Undo and redo: the diagrams before and after, each with what the step was called. They share all that did not change.
import type { Diagram } from "./diagram";

interface Step {
  readonly before: Diagram;
  readonly after: Diagram;
  readonly called: string;
  /** Successive edits with the same non-empty tag are one step. */
  readonly tag: string;
}

const MOST = 500;

export class History {
  private done = $state.raw<readonly Step[]>([]);
  private undone = $state.raw<readonly Step[]>([]);

  get canUndo(): boolean {
    return this.done.length > 0;
  }

  get canRedo(): boolean {
    return this.undone.length > 0;
  }

  record(before: Diagram, after: Diagram, called: string, tag = ""): void {
    if (before === after) return;
    const last = this.done.at(-1);
    const one = tag !== "" && last?.tag === tag && this.undone.length === 0;
    const step = one ? { ...last, after } : { before, after, called, tag };
    this.done = [...(one ? this.done.slice(0, -1) : this.done), step].slice(-MOST);
    this.undone = [];
  }

  undo(): Step | undefined {
    const step = this.done.at(-1);
    if (step === undefined) return undefined;
    this.done = this.done.slice(0, -1);
    this.undone = [...this.undone, step];
    return step;
  }

  redo(): Step | undefined {
    const step = this.undone.at(-1);
    if (step === undefined) return undefined;
    this.undone = this.undone.slice(0, -1);
    this.done = [...this.done, step];
    return step;
  }

  clear(): void {
    this.done = this.undone = [];
  }
}
