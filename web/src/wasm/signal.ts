import type { Entry, Numbers } from "./table";

/** A value that was refused; nothing was changed. */
export class ProgramRefusal extends Error {}

export type Value = number | boolean | readonly number[];

/** An input, output, state or parameter in the memory of a program: read it, or set it, at any time. */
export class Signal {
  constructor(
    readonly entry: Entry,
    readonly numbers: Numbers,
  ) {}

  /** The number, or the numbers of an array. */
  value(): number | number[] {
    return this.entry.array ? Array.from(this.numbers) : this.numbers[0]!;
  }

  /** The first number: of what is not an array the only one. */
  number(): number {
    return this.numbers[0]!;
  }

  /** Sets an input or a state; parameters are set by `Program.set`, which checks them. */
  set(value: Value): void {
    if (typeof value === "object" && value.length !== this.entry.count)
      throw new ProgramRefusal(`${this.entry.path} takes ${this.entry.count} numbers, not ${value.length}`);
    write(this.numbers, value);
  }
}

/** Puts a value into its place. */
export function write(numbers: Numbers, value: Value): void {
  if (typeof value === "object") numbers.set(value);
  else numbers[0] = Number(value);
}
