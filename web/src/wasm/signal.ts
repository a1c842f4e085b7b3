import type { Entry, Numbers } from "./table";

/** Refused value; nothing was changed. */
export class ProgramRefusal extends Error {}

export type Value = number | boolean | readonly number[];

/** Input, output, state or parameter in the memory of a program. */
export class Signal {
  constructor(
    readonly entry: Entry,
    readonly numbers: Numbers,
  ) {}

  value(): number | number[] {
    return this.entry.array ? Array.from(this.numbers) : this.numbers[0]!;
  }

  number(): number {
    return this.numbers[0]!;
  }

  /** Set an input or a state. Set parameters by `Program.set`, which checks them. */
  set(value: Value): void {
    if (typeof value === "object" && value.length !== this.entry.count)
      throw new ProgramRefusal(`${this.entry.path} takes ${this.entry.count} numbers, not ${value.length}`);
    write(this.numbers, value);
  }
}

export function write(numbers: Numbers, value: Value): void {
  if (typeof value === "object") numbers.set(value);
  else numbers[0] = Number(value);
}
