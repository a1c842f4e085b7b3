// What a host must know of a compiled module: `WasmModule.interface` of the library, docs/reference/compilation.md.

/** Signal, state or parameter: `count` numbers of `type` at `address`. */
export interface Entry {
  path: string;
  unit: string;
  type: keyof typeof ARRAYS;
  count: number;
  array: boolean;
  address: number;
}

/** Parameter with bounds. Without `tunable` it is set before the first step only. */
export interface ParameterEntry extends Entry {
  low: number | null;
  high: number | null;
  tunable: boolean;
}

interface Place {
  address: number;
  size: number;
}
interface RowPlace {
  address: number;
  stride: number;
}

export interface ProgramTable {
  twodof: number;
  name: string;
  dt: number;
  precision: "float64" | "float32";
  functions: Record<"defaults" | "prepare" | "init" | "step" | "run" | "tick", string>;
  structs: Record<"P" | "S" | "U" | "Y", Place>;
  rows: { count: number; U: RowPlace; Y: RowPlace };
  parameters: ParameterEntry[];
  inputs: Entry[];
  outputs: Entry[];
  states: Entry[];
}

export type Numbers = InstanceType<(typeof ARRAYS)[keyof typeof ARRAYS]>;

const ARRAYS = {
  float64: Float64Array,
  float32: Float32Array,
  int32: Int32Array,
  uint32: Uint32Array,
  bool: Uint8Array,
  int8: Int8Array,
  uint8: Uint8Array,
  int16: Int16Array,
  uint16: Uint16Array,
} as const;

export function numbersAt(memory: ArrayBuffer, entry: Entry, offset = 0): Numbers {
  return new ARRAYS[entry.type](memory, entry.address + offset, entry.count);
}

export function roomFor(entry: Entry, count: number): Numbers {
  return new ARRAYS[entry.type](count);
}
