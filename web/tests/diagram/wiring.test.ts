import { describe, expect, it } from "vitest";
import { diagramFrom, type Diagram } from "../../src/pages/diagram/model/diagram";
import { EditFault } from "../../src/pages/diagram/model/edits";
import type { Json } from "../../src/pages/diagram/model/json_text";
import { Shapes, type Port } from "../../src/pages/diagram/model/shapes";
import { joined } from "../../src/pages/diagram/model/wiring";

/** A sum with a, b and c of which b is fed, gains, and a block with two outputs of which the first is read. */
function given(): { d: Diagram; shapes: Shapes } {
  const port = (name: string): Port => ({ name, kind: "real", width: null, unit: "" });
  const block = (type: string): Json => ({ type });
  const d = diagramFrom({
    name: "d",
    inputs: [{ name: "u" }],
    parts: [
      { name: "sum", block: block("sum") },
      { name: "gain", block: block("gain") },
      { name: "two", block: block("two") },
      { name: "end", block: block("end") },
    ],
    connections: [
      ["u", "sum.b"],
      ["two.x", "gain.u"],
    ],
    outputs: [["y", null]],
  });
  const shapes = new Shapes();
  const learn = (type: string, inputs: string[], outputs: string[]): void => {
    const [of, to] = [inputs.map(port), outputs.map(port)];
    shapes.learn(`{"type": "${type}"}`, { inputs: of, outputs: to, params: [], structure: type });
  };
  learn("sum", ["a", "b", "c"], ["y"]);
  learn("gain", ["u"], ["y"]);
  learn("two", [], ["x", "z"]);
  learn("end", ["u"], []);
  for (const key of shapes.unknown(d).keys()) throw new Error(`${key} is not known`);
  return { d, shapes };
}
const wires = (from: string[], to: string): unknown => {
  const { d, shapes } = given();
  const after = joined(d, shapes, from, to);
  return [...after.connections.slice(d.connections.length), ...after.outputs.filter(([, source]) => source !== null)];
};

describe("a block that is clicked with Ctrl", () => {
  it("takes the first output that is free into its first input that is", () => {
    expect(wires(["p:gain"], "p:sum")).toEqual([["gain", "sum.a"]]);
    expect(wires(["p:two"], "p:end")).toEqual([["two.z", "end.u"]]);
    expect(wires(["i:u"], "p:end")).toEqual([["u", "end.u"]]);
    expect(wires(["p:sum"], "o:y")).toEqual([["y", "sum"]]); // an output and its source
  });
  it("takes several in their order, as many as it has inputs", () => {
    expect(wires(["p:two", "p:gain", "i:u"], "p:sum")).toEqual([
      ["two.z", "sum.a"],
      ["gain", "sum.c"],
    ]);
  });
  it("says why there is no wire", () => {
    expect(() => wires(["p:sum"], "p:gain")).toThrow(new EditFault("gain has no free input"));
    expect(() => wires(["p:end"], "p:sum")).toThrow(EditFault);
    expect(() => wires(["p:sum"], "i:u")).toThrow("is an input");
  });
});
