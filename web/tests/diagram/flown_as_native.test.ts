// Run by tests/web/test_page_code.py, which names a file with a compiled loop and what the native build flew.
import { describe, expect, it } from "vitest";
import type { PortableLoop } from "../../src/api/diagrams";
import { readDiagram } from "../../src/pages/diagram/model/diagram";
import { readJson, writeJson } from "../../src/pages/diagram/model/json_text";
import { Shapes, type Answer } from "../../src/pages/diagram/model/shapes";
import { parameterValues, structureOf } from "../../src/pages/diagram/model/structure";
import { fly } from "../../src/pages/diagram/simulate/fly";
import { beginWith, flown } from "../../src/pages/diagram/simulate/scenario";
import { Program } from "../../src/wasm/program";

interface Given {
  loop: PortableLoop;
  shapes: [key: string, answer: Answer][];
  /** Of the compiled diagram, and of diagrams that differ from it in values only. */
  flights: { text: string; signals: Record<string, string> }[];
  steps: number;
}
const file = import.meta.env["VITE_TWODOF_LOOPS"] as string | undefined;
const read = async (path: string): Promise<Given[]> =>
  ((await import(/* @vite-ignore */ path)) as { default: Given[] }).default;
const all = file === undefined ? [] : await read(file);
const bytes = (text: string): Uint8Array => Uint8Array.from(atob(text), (c) => c.charCodeAt(0));

describe.skipIf(all.length === 0)("a loop flown by the page's code", () => {
  it.each(all.map((given) => [given.loop.template, given] as const))("has the native bits (%s)", async (_, given) => {
    const { loop, flights } = given;
    const shapes = new Shapes();
    for (const [key, answer] of given.shapes) shapes.learn(writeJson(readJson(key)), answer);
    const program = await Program.load(bytes(loop.module) as BufferSource, loop.interface);
    const structures = new Set<string>();
    for (const flight of flights) {
      const diagram = readDiagram(flight.text);
      expect(shapes.unknown(diagram).size).toBe(0);
      structures.add(structureOf(diagram, shapes));
      const plan = flown({ ...beginWith(loop.template), seconds: given.steps * 0.004 }, loop.template, loop.setpoints);
      const signals = fly(program, loop.ticks, {
        ...plan,
        parameters: { ...loop.parameters, ...plan.parameters, ...parameterValues(diagram, shapes, loop.prefix) },
        states: loop.states,
        wanted: Object.keys(flight.signals),
      });
      for (const [path, wanted] of Object.entries(flight.signals)) {
        expect(new Uint8Array(signals[path]!.buffer), path).toEqual(bytes(wanted));
      }
    }
    expect(structures.size).toBe(1);
  });
});
