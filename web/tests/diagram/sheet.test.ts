import { describe, expect, it, test } from "vitest";
import { loopOnSheet, placeOfFinding, seenFrom } from "../../src/pages/diagram/model/blame";
import { editor } from "../../src/pages/diagram/editor.svelte";
import { placesOn, staying } from "../../src/pages/diagram/canvas/places";
import {
  diagramAt,
  diagramFrom,
  diagramTo,
  findPart,
  readDiagram,
  wiresOf,
  writeDiagram,
  type Diagram,
  type Point,
} from "../../src/pages/diagram/model/diagram";
import { commented, commentToggled } from "../../src/pages/diagram/model/comment";
import {
  addInput,
  addParam,
  addPart,
  bind,
  changePart,
  connect,
  declare,
  freeBorder,
  moveThings,
  renameParam,
  renamePart,
  setRate,
  withParameter,
} from "../../src/pages/diagram/model/edits";
import { wiresAt } from "../../src/pages/diagram/model/wiring";
import { grouped, ungrouped } from "../../src/pages/diagram/model/grouping";
import { readJson, real, type Json, type Num } from "../../src/pages/diagram/model/json_text";
import { instead, searched } from "../../src/pages/diagram/model/search";
import { canBeParameter, Shapes, type Port, type Shape } from "../../src/pages/diagram/model/shapes";
import { originOf } from "../../src/pages/diagram/model/signals";
import { parameterValues, structureOf } from "../../src/pages/diagram/model/structure";

const port = (name: string): Port => ({ name, kind: "real", width: null, unit: "" });
function shape(inputs: string[], params: Record<string, number> = {}): Shape {
  return {
    inputs: inputs.map(port),
    outputs: [port("y")],
    params: Object.entries(params).map(([name, value]) => ({ ...port(name), value, low: null, high: null, text: "" })),
    structure: `of ${inputs.join()}`,
  };
}
/** A sheet with a sub-diagram, in which gains (k) stand behind one another. */
function given(k = 2): { d: Diagram; shapes: Shapes } {
  const gain = (value: number): Json => ({ type: "gain", config: readJson(`{"k": ${value}.0}`) });
  const json = {
    name: "top",
    inputs: [{ name: "u" }],
    params: [{ name: "p", value: readJson("5.0") }],
    parts: [
      { name: "a", block: gain(k), params: { k: "p" } },
      { name: "b", block: gain(k) },
      {
        name: "sub",
        diagram: {
          name: "inner",
          inputs: [{ name: "x" }],
          parts: [{ name: "g", block: gain(k) }],
          connections: [["x", "g.u"]],
          outputs: [["z", "g"]],
        },
      },
    ],
    connections: [
      ["u", "a.u"],
      ["a", "b.u"],
      ["b", "sub.x"],
    ],
    outputs: [["out", "sub.z"]],
  };
  const d = diagramFrom(json as unknown as Json);
  const shapes = new Shapes();
  for (const key of shapes.unknown(d).keys()) shapes.learn(key, shape(["u"], { k }));
  return { d, shapes };
}

describe("a finding's place", () => {
  it("is a block, a port of the sheet, or the sheet", () => {
    const { d } = given();
    expect(placeOfFinding(d, "b.k")).toEqual({ path: [], id: "p:b", rest: "k" });
    expect(placeOfFinding(d, "top.out")).toEqual({ path: [], id: "o:out", rest: "" });
    expect(placeOfFinding(d, "top.sub.g.k")).toEqual({ path: ["sub"], id: "p:g", rest: "k" });
    expect(placeOfFinding(d, "sub.x").id).toBe("p:sub");
    expect(placeOfFinding(d, "top").id).toBe("");
  });
  it("is seen from the sheets around it as the sub-diagram that holds it", () => {
    const place = placeOfFinding(given().d, "sub.g.u");
    expect(seenFrom([], place)).toBe("p:sub");
    expect(seenFrom(["sub"], place)).toBe("p:g");
    expect(seenFrom(["other"], place)).toBe("");
  });
  it("of an algebraic loop is its blocks and the wires between them", () => {
    const { d } = given();
    expect([...loopOnSheet(d, [], d, ["sub.g.y", "b.y", "a.y", "sub.g.y"])].sort()).toEqual(
      ["p:a", "p:b", "p:sub", "w:b.u", "w:sub.x"].sort(),
    );
  });
});

describe("what a program depends on", () => {
  it("is not the values of parameters, nor places and texts", () => {
    const [one, other] = [given(2), given(3)];
    expect(structureOf(one.d, one.shapes)).toBe(structureOf(other.d, other.shapes));
    expect(structureOf({ ...one.d, text: "words" }, one.shapes)).toBe(structureOf(one.d, one.shapes));
    const cut = { ...one.d, connections: one.d.connections.slice(1) };
    expect(structureOf(cut, one.shapes)).not.toBe(structureOf(one.d, one.shapes));
  });
  it("leaves the values of all parameters that are not bound to others", () => {
    const { d, shapes } = given(3);
    expect(parameterValues(d, shapes, "at.")).toEqual({ "at.p": 5, "at.b.k": 3, "at.sub.g.k": 3 });
  });
});

describe("a signal", () => {
  it("is followed into and out of sub-diagrams to the block that gives it", () => {
    const { d, shapes } = given();
    expect(originOf(d, [], "sub.z", shapes)).toEqual({ of: "block", path: "sub.g.y", sheet: ["sub"], source: "g.y" });
    expect(originOf(d, ["sub"], "x", shapes)).toEqual({ of: "block", path: "b.y", sheet: [], source: "b.y" });
    expect(originOf(d, [], "u", shapes)).toEqual({ of: "input", path: "u", sheet: [], source: "u" });
    expect(originOf(d, [], "nothing", shapes)).toBeUndefined();
  });
});

describe("the wires at a block", () => {
  it("are those into it and those out of it", () => {
    const { d } = given();
    expect(wiresAt(d, "p:b")).toEqual(["b.u", "sub.x"]);
    expect(wiresAt(d, "p:sub")).toEqual(["sub.x", "out"]);
    expect(wiresAt(d, "i:u")).toEqual(["a.u"]);
    expect(wiresAt(d, "o:out")).toEqual(["out"]);
  });
});

describe("grouping", () => {
  it("makes inputs and outputs of what crosses the border, and binds the parameters", () => {
    const { d, shapes } = given();
    const { diagram, name } = grouped(d, new Set(["a", "b"]), shapes);
    const sub = diagramAt(diagram, [name]);
    expect(name).toBe("sub_2");
    expect(sub?.parts.map((part) => part.name)).toEqual(["a", "b"]);
    expect(sub?.connections).toEqual([
      ["u", "a.u"],
      ["a", "b.u"],
    ]);
    expect(diagram.connections).toContainEqual(["u", "sub_2.u"]);
    expect(originOf(diagram, ["sub"], "x", shapes)).toEqual({
      of: "block",
      path: "sub_2.b.y",
      sheet: ["sub_2"],
      source: "b.y",
    });
    expect(diagram.parts.find((part) => part.name === name)?.params).toEqual({ p: "p" });
  });
});

describe("the palette", () => {
  const blocks = [
    { type: "low_pass", name: "LowPass", group: "filters", text: "A filter of the first order." },
    { type: "gain", name: "Gain", group: "math", text: "y = k u." },
    { type: "matrix_gain", name: "MatrixGain", group: "math", text: "y = K u." },
  ];
  it("finds by name before it finds by text", () => {
    expect(searched(blocks, "gain").map((one) => one.type)).toEqual(["gain", "matrix_gain"]);
    expect(searched(blocks, "FILTER")[0]?.type).toBe("low_pass");
    expect(searched(blocks, "low pass")[0]?.type).toBe("low_pass");
    const sum = { type: "sum", name: "Sum", group: "math", text: "The signed sum." };
    expect(searched([...blocks, sum], "Add").map((one) => one.type)).toEqual(["sum"]);
    expect(searched(blocks, "nothing of the kind")).toEqual([]);
    expect(searched(blocks, " ")).toHaveLength(3);
  });

  it("knows Simulink's names, however they are written", () => {
    const block = (type: string): { type: string; name: string; group: string; text: string } => ({
      type,
      name: type,
      group: "math",
      text: "",
    });
    const all = ["rate_limit", "lookup", "transfer_function", "zero_order_hold", "logic", "diagram"].map(block);
    for (const [asked, type] of [
      ["Rate Limiter", "rate_limit"],
      ["1-D Lookup Table", "lookup"],
      ["lookup tab", "lookup"],
      ["Transfer Fcn", "transfer_function"],
      ["Zero-Order Hold", "zero_order_hold"],
      ["Logical Operator", "logic"],
      ["Subsystem", "diagram"],
    ] as const)
      expect(searched(all, asked)[0]?.type, asked).toBe(type);
  });

  it("says what to do for a block of Simulink that there is not here", () => {
    expect(instead("Scope")).toContain("press S");
    expect(instead("Goto tag")).toContain("Goto");
    expect(instead("MATLAB Function")).toContain("Python");
    for (const word of ["", "s", "gain", "step"]) expect(instead(word)).toBe("");
  });
});

describe("inputs and outputs without a place", () => {
  const at = ([x, y]: Point): Num[] => [real(x), real(y)];
  /** The sheet of `given`, its parts placed in a row. */
  function placed(): { d: Diagram; shapes: Shapes } {
    const { d, shapes } = given();
    return { d: { ...d, parts: d.parts.map((part, i) => ({ ...part, position: at([150 * i, 100]) })) }, shapes };
  }
  const edit = (d: Diagram, shapes: Shapes, change: (d: Diagram) => Diagram): Diagram => staying(d, change(d), shapes);

  it("stay where they are drawn when a block is inserted or moved, and in the file", () => {
    const { d, shapes } = placed();
    const block = findPart(d, "a")!;
    const before = placesOn(d, shapes);
    const inserted = edit(d, shapes, (one) =>
      connect(addPart(one, { ...block, name: "far", position: at([900, 400]) }), "u", "far.u"),
    );
    const moved = edit(inserted, shapes, (one) => moveThings(one, new Map([["p:a", [-400, 600]]])));
    for (const after of [inserted, moved, diagramFrom(diagramTo(moved))]) {
      for (const id of ["i:u", "o:out"]) expect(placesOn(after, shapes).get(id), id).toEqual(before.get(id));
    }
  });
  it("stay on the sheet around a sub-diagram that gets another port", () => {
    const { d } = placed();
    editor.root = d;
    for (const key of editor.shapes.unknown(d).keys()) editor.shapes.learn(key, shape(["u"], { k: 2 }));
    const before = placesOn(d, editor.shapes).get("o:out");
    for (const name of ["v", "w", "z"]) editor.apply("add", (one) => addInput(one, { name }), "", ["sub"]);
    expect(placesOn(editor.root, editor.shapes).get("o:out")).toEqual(before);
  });
  it("take no place in the file for an edit that moves nothing", () => {
    const { d, shapes } = placed();
    const after = edit(d, shapes, (one) => declare(one, "params", "p", "value", real(7)));
    expect([after.inputPositions, after.outputPositions]).toEqual([{}, {}]);
  });
  it("cover no other one when they are added, and go back to the border by Arrange", () => {
    const { d, shapes } = placed();
    const two = edit(d, shapes, (one) => addInput(one, { name: "v" }));
    const three = edit(two, shapes, (one) => addInput(one, { name: "w" }));
    const rows = ["i:u", "i:v", "i:w"].map((id) => placesOn(three, shapes).get(id)![1]);
    expect(new Set(rows).size).toBe(3);
    const far = edit(three, shapes, (one) => moveThings(one, new Map([["i:u", [500, 500]]])));
    const back = edit(far, shapes, freeBorder);
    expect(placesOn(back, shapes).get("i:u")).toEqual(placesOn(d, shapes).get("i:u"));
  });
});

describe("ungrouping", () => {
  it("takes grouping back, whatever has been named and bound since", () => {
    const { d, shapes } = given();
    const { diagram, name } = grouped(d, new Set(["a", "b"]), shapes);
    const back = ungrouped(diagram, name, [
      [0, 0],
      [100, 0],
    ]);
    expect(back.names).toEqual(["a", "b"]);
    const wires = (one: Diagram): string[] => wiresOf(one).map(String).sort();
    expect(wires(back.diagram)).toEqual(wires(d));
    expect(findPart(back.diagram, "a")?.params).toEqual({ k: "p" });
    expect(structureOf({ ...back.diagram, parts: [], connections: [] }, shapes)).toBe(
      structureOf({ ...d, parts: [], connections: [] }, shapes),
    );
  });
  it("names blocks anew and lifts parameters that were not bound", () => {
    const { d, shapes } = given();
    const sub = findPart(d, "sub")!.item as Diagram;
    const inner = renamePart(addParam(sub, { name: "p", value: real(3) }), "g", "a");
    const bound = changePart(inner, "a", (part) => bind(part, "k", "p"));
    const { diagram, names } = ungrouped(
      changePart(d, "sub", (part) => ({ ...part, item: bound })),
      "sub",
      [[0, 0]],
    );
    expect(names).toEqual(["a_2"]);
    expect(findPart(diagram, "a_2")?.params).toEqual({ k: "p_2" });
    expect(parameterValues(diagram, shapes)).toMatchObject({ p: 5, p_2: 3 });
    expect(originOf(diagram, [], "a_2", shapes)?.path).toBe("a_2.y");
    expect(wiresOf(diagram)).toContainEqual(["a_2", "out"]);
  });
  it("is refused where a block would lose its rate", () => {
    const { d } = given();
    expect(() =>
      ungrouped(
        changePart(d, "sub", (part) => setRate(part, 2, 0)),
        "sub",
        [[0, 0]],
      ),
    ).toThrow("rate");
  });
});

describe("a commented block", () => {
  it("keeps its wires and comes back as it was", () => {
    const { d, shapes } = given();
    const names = new Set(["a", "b"]);
    for (const how of ["out", "through"] as const) {
      const made = commentToggled(d, names, how, shapes);
      expect(made.connections).toBe(d.connections);
      const part = findPart(made, "a")!;
      expect(commented(part)?.how).toBe(how);
      expect(commented({ ...part, item: { ...part.item, text: "reworded" } as Diagram })?.how).toBe(how);
      expect(commented({ ...part, rest: {} })?.how).toBe(how); // as files were written once
      expect(readDiagram(writeDiagram(made)).parts[0]?.rest).toEqual({ commented: how });
      expect(findPart(made, "a")?.params).toEqual({ p: "p" });
      const renamed = renameParam(made, "p", "gain");
      expect(findPart(commentToggled(renamed, names, how, shapes), "a")?.params).toEqual({ k: "gain" });
      expect(writeDiagram(commentToggled(made, names, how, shapes))).toBe(writeDiagram(d));
    }
  });
});

test("a commented block reads each field of a bus", () => {
  const { d } = given();
  const shapes = new Shapes();
  for (const key of shapes.unknown(d).keys()) shapes.learn(key, shape(["bus.a", "bus.b"]));
  const { item } = findPart(commentToggled(d, new Set(["b"]), "out", shapes), "b")!;
  expect((item as Diagram).connections).toEqual([
    ["bus.a", "block.bus.a"],
    ["bus.b", "block.bus.b"],
  ]);
});

describe("a new parameter", () => {
  it("has the block's value, unit and bounds, and the block follows it", () => {
    const { d, shapes } = given();
    const parameter = { ...port("k"), unit: "s/rad", value: 2, low: 0, high: null, text: "gain" };
    const made = withParameter(d, findPart(d, "b")!, parameter);
    expect(made.params.at(-1)).toEqual({
      name: "b_k",
      value: real(2),
      unit: "s/rad",
      low: real(0),
      text: "gain",
    });
    expect(findPart(made, "b")?.params).toEqual({ k: "b_k" });
    expect(parameterValues(made, shapes)).toMatchObject({ b_k: 2 });
    expect(canBeParameter({ ...parameter, value: [[1, 2]] })).toBe(false);
  });
});
