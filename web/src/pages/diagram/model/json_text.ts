// JSON that keeps every number as it was written, and the text form that Python's `to_json` gives. A diagram that is
// opened and saved must not change by a byte, and `1.0` read as a JavaScript number would come back as `1`.

/** A number as it stands in the file: "1.0" and "1" are two. */
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

/** Text that is not JSON: where it stops being so, counted in characters. */
export class JsonFault extends Error {}

const MAX_DEPTH = 400; // 64 sub-diagrams within one another take 192
const MAX_LINE = 80;
const NUMBER = /-?(?:0|[1-9]\d*)(?:\.\d+)?(?:[eE][+-]?\d+)?/y;
const SPACE = /[ \t\n\r]*/y;
const PLAIN = /[^"\\\u0000-\u001f]*/y;
const ESCAPES: Readonly<Record<string, string>> = { b: "\b", f: "\f", n: "\n", r: "\r", t: "\t" };

/** A real number as Python writes it: at least one decimal, an exponent below 1e-4 and from 1e16. */
export function realText(value: number): string {
  if (!Number.isFinite(value)) throw new RangeError(`${value} is not a finite number`);
  if (value === 0) return Object.is(value, -0) ? "-0.0" : "0.0";
  const [mantissa = "", tail = "0"] = Math.abs(value).toExponential().split("e");
  const digits = mantissa.replace(".", "");
  const exponent = Number(tail);
  const sign = value < 0 ? "-" : "";
  if (exponent < -4 || exponent >= 16) {
    const fraction = digits.length > 1 ? `.${digits.slice(1)}` : "";
    return `${sign}${digits[0]}${fraction}e${exponent < 0 ? "-" : "+"}${String(Math.abs(exponent)).padStart(2, "0")}`;
  }
  if (exponent < 0) return `${sign}0.${"0".repeat(-exponent - 1)}${digits}`;
  const whole = digits.slice(0, exponent + 1).padEnd(exponent + 1, "0");
  return `${sign}${whole}.${digits.slice(exponent + 1) || "0"}`;
}

/** A real number for the file. */
export function real(value: number): Num {
  return new Num(realText(value));
}

/** A whole number for the file. */
export function whole(value: number): Num {
  return new Num(String(Object.is(value, -0) ? 0 : Math.trunc(value)));
}

function canonical(token: string): Num {
  if (/[.eE]/.test(token)) {
    const value = Number(token);
    if (!Number.isFinite(value)) throw new JsonFault(`${token.slice(0, 40)} is beyond the largest number`);
    return new Num(realText(value));
  }
  return new Num(token === "-0" ? "0" : token);
}

class Parser {
  private at = 0;

  constructor(private readonly text: string) {}

  whole(): Json {
    const value = this.value(0);
    this.skip(SPACE);
    if (this.at < this.text.length) throw this.fault("something stands behind the end");
    return value;
  }

  private value(depth: number): Json {
    if (depth > MAX_DEPTH) throw this.fault("it is nested too deeply");
    this.skip(SPACE);
    switch (this.text[this.at]) {
      case "{":
        return this.object(depth);
      case "[":
        return this.list(depth);
      case '"':
        return this.string();
    }
    for (const [word, value] of [
      ["null", null],
      ["true", true],
      ["false", false],
    ] as const) {
      if (this.text.startsWith(word, this.at)) {
        this.at += word.length;
        return value;
      }
    }
    const token = this.skip(NUMBER);
    if (!token) throw this.fault("a value is missing");
    return canonical(token);
  }

  private object(depth: number): JsonObject {
    const made = Object.create(null) as Record<string, Json>;
    this.at++;
    for (let first = true; !this.closed("}", first); first = false) {
      this.skip(SPACE);
      if (this.text[this.at] !== '"') throw this.fault("a key is missing");
      const key = this.string();
      if (key in made) throw this.fault(`the key ${JSON.stringify(key).slice(0, 80)} stands twice`);
      this.skip(SPACE);
      if (this.text[this.at++] !== ":") throw this.fault("a colon is missing");
      made[key] = this.value(depth + 1);
    }
    return made;
  }

  private list(depth: number): Json[] {
    const made: Json[] = [];
    this.at++;
    for (let first = true; !this.closed("]", first); first = false) made.push(this.value(depth + 1));
    return made;
  }

  /** Whether the list or object ends here; passes the comma between two items. */
  private closed(end: string, first: boolean): boolean {
    this.skip(SPACE);
    const here = this.text[this.at];
    if (here === end) {
      this.at++;
      return true;
    }
    if (first) return false;
    if (here !== ",") throw this.fault(`a comma or ${end} is missing`);
    this.at++;
    this.skip(SPACE);
    if (this.text[this.at] === end) throw this.fault("a comma stands before the end");
    return false;
  }

  private string(): string {
    this.at++;
    let made = "";
    for (;;) {
      made += this.skip(PLAIN);
      const here = this.text[this.at++];
      if (here === '"') return made;
      if (here !== "\\") throw this.fault("a text does not end");
      const mark = this.text[this.at++] ?? "";
      if (mark === "u") {
        const code = this.text.slice(this.at, this.at + 4);
        if (!/^[0-9a-fA-F]{4}$/.test(code)) throw this.fault("an escape is broken");
        made += String.fromCharCode(parseInt(code, 16));
        this.at += 4;
      } else if ('"\\/'.includes(mark) && mark) made += mark;
      else if (mark in ESCAPES) made += ESCAPES[mark];
      else throw this.fault("an escape is unknown");
    }
  }

  private skip(pattern: RegExp): string {
    pattern.lastIndex = this.at;
    const found = pattern.exec(this.text)?.[0] ?? "";
    this.at += found.length;
    return found;
  }

  private fault(what: string): JsonFault {
    return new JsonFault(`this is not JSON: ${what} (character ${this.at})`);
  }
}

/** Reads JSON text. Raises JsonFault. */
export function readJson(text: string): Json {
  return new Parser(text).whole();
}

function flat(value: Json): string {
  if (value === null || typeof value === "boolean") return String(value);
  if (typeof value === "string") return JSON.stringify(value);
  if (value instanceof Num) return value.text;
  if (isList(value)) return `[${value.map(flat).join(", ")}]`;
  const rows = Object.entries(value).map(([key, item]) => `${JSON.stringify(key)}: ${flat(item)}`);
  return `{${rows.join(", ")}}`;
}

/** JSON as `to_json` of twodof.blocks.schema writes it: a short value on one line, of a long one an item a line. */
export function writeJson(value: Json, indent = 0): string {
  const line = flat(value);
  if (typeof value !== "object" || value === null || value instanceof Num || fits(line)) return line;
  const pad = " ".repeat(indent + 1);
  const end = " ".repeat(indent);
  if (isList(value)) {
    return `[\n${value.map((item) => pad + writeJson(item, indent + 1)).join(",\n")}\n${end}]`;
  }
  const rows = Object.entries(value).map(([key, item]) => `${pad}${ascii(key)}: ${writeJson(item, indent + 1)}`);
  return `{\n${rows.join(",\n")}\n${end}}`;
}

/** Python counts characters, where JavaScript counts halves of those beyond U+FFFF. */
function fits(line: string): boolean {
  return line.length <= MAX_LINE || (line.length <= 2 * MAX_LINE && [...line].length <= MAX_LINE);
}

function ascii(key: string): string {
  return JSON.stringify(key).replace(/[\u007f-\uffff]/g, (c) =>
    c === "\u007f" ? c : `\\u${c.charCodeAt(0).toString(16).padStart(4, "0")}`,
  );
}

export function isList(value: Json | undefined): value is readonly Json[] {
  return Array.isArray(value);
}

export function isObject(value: Json | undefined): value is JsonObject {
  return typeof value === "object" && value !== null && !isList(value) && !(value instanceof Num);
}
