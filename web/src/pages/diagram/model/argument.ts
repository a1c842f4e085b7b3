// What is typed into the field of an argument: a number, a list, a matrix as Python's or MATLAB's users write it, a text.
import { isList, Num, readJson, real, type Json } from "./json_text";

const NUMBER = /^[+-]?(\d+[.,]?\d*|[.,]\d+)([eE][+-]?\d+)?$/;
const INFINITE = /^[+-]?inf(inity)?$/i;
const WORD = /^[A-Za-z_][\w-]*$/;

/**
 * The typed value as JSON keeps it, or why it is none. `given` is what the argument is by default: its kind decides, not
 * that of what stands there, which may be a mistake. A real stays a real, a whole number a whole one.
 */
export function readArgument(text: string, value: Json, given: Json = value): { value: Json } | { refused: string } {
  if (typeof given === "string") return { value: text };
  const typed = text.trim().replaceAll("\u2212", "-");
  const nothing = given === null || value === null;
  if (nothing && (typed === "" || typed === "none")) return { value: null };
  const wholes = isWhole(given) && isWhole(value);
  const plain = number(typed, wholes) ?? list(typed, wholes);
  if (plain !== undefined) return { value: plain };
  if (nothing && WORD.test(typed)) return { value: typed };
  const asked = given instanceof Num ? "Give a number" : "Give numbers, such as [1 2 3], or rows, such as [1 2; 3 4]";
  return { refused: `${asked}${nothing ? ", or none" : ""}.` };
}

/** Most digits that a person types; a number with more was computed. */
const TYPED_DIGITS = 7;

/** Write a number as it was typed, and a computed one with three digits. */
export function brief(one: Num): string {
  const digits = one.text
    .replace(/[eE].*/, "")
    .replace(/\D/g, "")
    .replace(/^0+|0+$/g, "");
  return digits.length <= TYPED_DIGITS ? one.text : String(Number(one.value.toPrecision(3)));
}

function isWhole(json: Json): boolean {
  if (isList(json)) return json.every(isWhole);
  return !(json instanceof Num) || !/[.eE]/.test(json.text);
}

function number(typed: string, wholes: boolean): Json | undefined {
  if (INFINITE.test(typed)) return { float: typed.startsWith("-") ? "-inf" : "inf" };
  if (!NUMBER.test(typed)) return undefined;
  const found = Number(typed.replace(",", "."));
  if (!Number.isFinite(found)) return undefined;
  return wholes && /^[+-]?\d+$/.test(typed) ? new Num(String(found)) : real(found);
}

/** Read JSON, or elements separated by spaces or commas in rows separated by semicolons. */
function list(typed: string, wholes: boolean): Json | undefined {
  try {
    const found = readJson(typed);
    return isList(found) ? inKind(found, wholes) : typeof found === "string" ? found : undefined;
  } catch {
    // It is not JSON.
  }
  const inside = /^\[([^[\]]*)\]$|^([^[\]]*)$/.exec(typed);
  const rows = (inside?.[1] ?? inside?.[2])?.split(";").map((row) => elements(row, wholes));
  if (rows === undefined || rows.includes(undefined)) return undefined;
  return rows.length === 1 ? rows[0] : (rows as Json[]);
}

/** Read a row of numbers or names. */
function elements(row: string, wholes: boolean): Json[] | undefined {
  const texts = row.trim().split(/\s*,\s*|\s+/);
  if (texts.length > 1 && texts.every((one) => WORD.test(one))) return texts;
  const read = texts.map((one) => number(one, wholes));
  return read.includes(undefined) ? undefined : (read as Json[]);
}

function inKind(json: Json, wholes: boolean): Json {
  if (isList(json)) return json.map((one) => inKind(one, wholes));
  return json instanceof Num && !wholes ? real(json.value) : json;
}
