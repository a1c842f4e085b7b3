// JSON in which 1.0 and 1 stay two numbers: Python reads the first as a real and the second as an integer.

export class Num {
  constructor(readonly text: string) {}

  get value(): number {
    return Number(this.text);
  }
}

export type Json = null | boolean | string | Num | readonly Json[] | JsonObject;
export interface JsonObject {
  readonly [key: string]: Json;
}

export class JsonFault extends Error {}

/** Return `value` as a real number, with a decimal point or an exponent. */
export function real(value: number): Num {
  const text = Object.is(value, -0) ? "-0" : String(value);
  return new Num(/[.e]/.test(text) ? text : `${text}.0`);
}

const TOKENS = /"(?:[^"\\]|\\.)*"(\s*:)?|-?\d[\d.eE+-]*/g;

/** Read JSON text. Raises JsonFault. */
export function readJson(text: string): Json {
  // JSON.parse would turn 1.0 into 1. So each number becomes a string that begins with n, each string one with s.
  const mark = (token: string, colon?: string): string => {
    if (!token.startsWith('"')) return `"n${token}"`;
    return colon === undefined ? `"s${token.slice(1)}` : token;
  };
  const unmark = (_key: string, value: unknown): unknown => {
    if (typeof value !== "string") return value;
    return value.startsWith("n") ? new Num(value.slice(1)) : value.slice(1);
  };
  try {
    JSON.parse(text);
    return JSON.parse(text.replace(TOKENS, mark), unmark) as Json;
  } catch (failure) {
    throw new JsonFault(`the text is not JSON: ${(failure as Error).message}`);
  }
}

/** Write JSON on one line. The server breaks it into lines when it keeps a diagram. */
export function writeJson(value: Json): string {
  if (value instanceof Num) return value.text;
  if (isList(value)) return `[${value.map(writeJson).join(", ")}]`;
  if (!isObject(value)) return JSON.stringify(value);
  const rows = Object.entries(value).map(([key, item]) => `${JSON.stringify(key)}: ${writeJson(item)}`);
  return `{${rows.join(", ")}}`;
}

export function isList(value: Json | undefined): value is readonly Json[] {
  return Array.isArray(value);
}

export function isObject(value: Json | undefined): value is JsonObject {
  return typeof value === "object" && value !== null && !isList(value) && !(value instanceof Num);
}
