// Run by tests/web/test_page_code.py, which names a file of texts that Python's `to_json` wrote.
import { describe, expect, it } from "vitest";
import { readDiagram, writeDiagram } from "../../src/pages/diagram/model/diagram";

const file = import.meta.env["VITE_TWODOF_TEXTS"] as string | undefined;
const read = async (path: string): Promise<string[]> =>
  ((await import(/* @vite-ignore */ path)) as { default: string[] }).default;
const texts = file === undefined ? [] : await read(file);
/** Python breaks long values into lines; a line feed within a string is escaped, so these are all of the layout. */
const onOneLine = (text: string): string => text.trim().replace(/,\n */g, ", ").replace(/\n */g, "");

describe.skipIf(texts.length === 0)("a diagram that Python wrote", () => {
  it.each(texts.map((text, i) => [i, text] as const))("is written by the page as the same JSON (%i)", (_, text) => {
    expect(writeDiagram(readDiagram(text))).toBe(onOneLine(text));
  });
});
