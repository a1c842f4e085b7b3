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
  private readonly done: Step[] = [];
  private readonly undone: Step[] = [];

  get canUndo(): boolean {
    return this.done.length > 0;
  }

  get canRedo(): boolean {
    return this.undone.length > 0;
  }

  record(before: Diagram, after: Diagram, called: string, tag = ""): void {
    if (before === after) return;
    const last = this.done.at(-1);
    if (tag !== "" && last?.tag === tag && this.undone.length === 0) {
      this.done[this.done.length - 1] = { ...last, after };
    } else {
      this.done.push({ before, after, called, tag });
      if (this.done.length > MOST) this.done.shift();
    }
    this.undone.length = 0;
  }

  undo(): Step | undefined {
    const step = this.done.pop();
    if (step !== undefined) this.undone.push(step);
    return step;
  }

  redo(): Step | undefined {
    const step = this.undone.pop();
    if (step !== undefined) this.done.push(step);
    return step;
  }

  clear(): void {
    this.done.length = this.undone.length = 0;
  }
}
