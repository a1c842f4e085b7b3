import { describe, expect, it } from "vitest";
import { copyText, paste } from "../../src/pages/diagram/model/clipboard";
import {
  diagramAt,
  diagramFrom,
  findPart,
  readDiagram,
  writeDiagram,
  type Diagram,
} from "../../src/pages/diagram/model/diagram";
import {
  addInput,
  addOutput,
  bind,
  changePart,
  configure,
  connect,
  declare,
  disconnect,
  edited,
  EditFault,
  flipParts,
  freeName,
  moveParts,
  moveThings,
  newPart,
  addPart,
  removeInput,
  removeParam,
  removeParts,
  renameInput,
  renameOutput,
  renamePart,
  settled,
} from "../../src/pages/diagram/model/edits";
import { History } from "../../src/pages/diagram/model/history.svelte";
import { readJson, real } from "../../src/pages/diagram/model/json_text";

const TEXT = `{"name": "d", "text": "",
 "inputs": [{"name": "u", "unit": "rad"}, {"name": "on", "kind": "bool"}],
 "params": [{"name": "k", "value": 2.0}],
 "parts": [
  {"name": "gain", "params": {"k": "k"}, "position": [1.0, 2.0], "block": {"type": "gain", "config": {"k": 1.0}}},
  {"name": "sum", "block": {"type": "sum", "config": {"signs": "+-"}}},
  {"name": "sub", "enable": "on", "reset": "sum.y", "diagram": {"name": "in", "text": "", "inputs": [{"name": "a"}],
   "params": [], "parts": [{"name": "g", "block": {"type": "gain", "config": {"k": 3.0}}}],
   "connections": [["a", "g.u"]], "outputs": [["b", "g"]]}}],
 "connections": [["u", "gain.u"], ["gain", "sum.a"], ["sub.b", "sum.b"], ["sum", "sub.a"]],
 "outputs": [["y", "sum"], ["z", "gain.y"]]}`;
const start = (): Diagram => diagramFrom(readJson(TEXT));

describe("an edit", () => {
  it("leaves what it was given as it was, and shares what stays", () => {
    const before = start();
    const text = writeDiagram(before);
    const after = changePart(before, "gain", (part) => configure(part, "k", real(4)));
    expect(writeDiagram(before)).toBe(text);
    expect(findPart(after, "sub")).toBe(findPart(before, "sub"));
    expect(writeDiagram(after)).toContain('"k": 4.0');
  });

  it("removes a part with its wires and conditions, and frees the outputs that it fed", () => {
    const after = removeParts(start(), new Set(["sum"]));
    expect(after.parts.map((part) => part.name)).toEqual(["gain", "sub"]);
    expect(after.connections).toEqual([["u", "gain.u"]]);
    expect(findPart(after, "sub")?.conditions).toEqual({ enable: "on" });
    expect(after.outputs).toEqual([
      ["y", null],
      ["z", "gain.y"],
    ]);
  });

  it("follows a new name in wires, outputs and conditions", () => {
    const after = renamePart(start(), "sum", "error");
    expect(after.connections).toContainEqual(["error", "sub.a"]);
    expect(after.connections).toContainEqual(["gain", "error.a"]);
    expect(findPart(after, "sub")?.conditions.reset).toBe("error.y");
    expect(after.outputs[0]).toEqual(["y", "error"]);
    expect(renameInput(after, "on", "go").parts[2]?.conditions.enable).toBe("go");
  });

  it.each(["1st", "a b", "", "u", "k", "sub", "ä", "x".repeat(64)])("refuses the name %s", (name) => {
    expect(() => renamePart(start(), "gain", name)).toThrow(EditFault);
  });

  it("gives an input one source: a new wire replaces the old one", () => {
    const after = connect(start(), "u", "sum.a");
    expect(after.connections.filter(([, to]) => to === "sum.a")).toEqual([["u", "sum.a"]]);
    expect(connect(after, "u", "y").outputs[0]).toEqual(["y", "u"]);
    expect(disconnect(after, new Set(["sum.a", "z"])).outputs[1]).toEqual(["z", null]);
  });

  it("reaches into a sub-diagram by its path", () => {
    const before = start();
    const after = edited(before, ["sub"], (d) => removeParts(d, new Set(["g"])));
    expect(diagramAt(after, ["sub"])?.parts).toEqual([]);
    expect(diagramAt(before, ["sub"])?.parts).toHaveLength(1);
    expect(after.parts[0]).toBe(before.parts[0]);
    expect(() => edited(before, ["gain"], (d) => d)).toThrow(EditFault);
  });

  it("moves within the bounds of a position", () => {
    const after = moveParts(start(), new Map([["gain", [1e9, -3.14159] as const]]));
    expect(writeDiagram(after)).toContain('"position": [1000000.0, -3.14]');
  });

  it("flips a part, which is written behind its place", () => {
    const after = flipParts(start(), new Set(["gain"]));
    expect(writeDiagram(after)).toMatch(/"position": \[1.0, 2.0\],\s+"flipped": true/);
    expect(readDiagram(writeDiagram(after)).parts[0]?.flipped).toBe(true);
    expect(writeDiagram(flipParts(after, new Set(["gain"])))).toBe(writeDiagram(start()));
  });

  it("removes an input or a parameter with what hangs on it", () => {
    expect(removeInput(start(), "on").parts[2]?.conditions).toEqual({ reset: "sum.y" });
    expect(removeInput(start(), "u").connections).toHaveLength(3);
    expect(removeParam(start(), "k").parts[0]?.params).toEqual({});
    expect(bind(start().parts[1]!, "k", "k").params).toEqual({ k: "k" });
  });

  it("writes what is declared in Python's order", () => {
    const after = declare(declare(start(), "params", "k", "text", "gain"), "params", "k", "low", real(0));
    expect(writeDiagram(after)).toContain('{"name": "k", "value": 2.0, "low": 0.0, "text": "gain"}');
  });

  it("finds names that are free", () => {
    expect(freeName(start(), "gain")).toBe("gain_2");
    expect(freeName(start(), "k")).toBe("k_2");
    expect(freeName(addPart(start(), newPart(start(), "gain", start().parts[1]!.item, [0, 0])), "gain")).toBe("gain_3");
    expect(() => addInput(start(), { name: "gain" })).toThrow(EditFault);
    expect(() => addOutput(start(), "y")).toThrow(EditFault);
  });
});

describe("places of inputs and outputs", () => {
  const written = (d: Diagram): unknown => {
    const { inputPositions, outputPositions } = d;
    return JSON.parse(JSON.stringify({ i: inputPositions, o: outputPositions }).replace(/{"text":"([^"]*)"}/g, "$1"));
  };
  it("are written where something was moved, and only then", () => {
    expect(writeDiagram(start())).not.toContain("positions");
    const moved = moveThings(start(), new Map([["i:u", [-60, 0.5] as const]]));
    expect(writeDiagram(moved)).toContain('"input_positions": {"u": [-60.0, 0.5]}');
    expect(readDiagram(writeDiagram(moved)).inputPositions).toEqual(moved.inputPositions);
  });
  it("follow a new name, and go with what they are of", () => {
    const places = new Map([
      ["i:u", [1, 2] as const],
      ["o:y", [3, 4] as const],
    ]);
    const named = renameOutput(renameInput(moveThings(start(), places), "u", "v"), "y", "w");
    expect(written(named)).toEqual({ i: { v: [1, 2] }, o: { w: [3, 4] } });
    expect(written(removeInput(named, "v"))).toEqual({ i: {}, o: { w: [3, 4] } });
  });
  it("let the parts keep the places that were presumed", () => {
    const bare = changePart(start(), "gain", (part) => ({ ...part, position: null }));
    const shown = { ...bare, parts: bare.parts.map((part, i) => ({ ...part, presumed: [10 * i, 0] as const })) };
    expect(settled(shown)).toBe(shown);
    const after = settled(moveThings(shown, new Map([["p:sum", [7, 7] as const]])));
    expect(after.parts.map((part) => part.position?.map((one) => one.value))).toEqual([
      [0, 0],
      [7, 7],
      [20, 0],
    ]);
  });
});

describe("copy and paste", () => {
  it("copies parts with the wires among them, under free names", () => {
    const text = copyText(start(), new Set(["gain", "sum", "sub"]));
    const { diagram, names } = paste(start(), text);
    expect(names).toEqual(["gain_2", "sum_2", "sub_2"]);
    expect(diagram.connections).toContainEqual(["gain_2", "sum_2.a"]);
    expect(diagram.connections).toContainEqual(["sub_2.b", "sum_2.b"]);
    expect(diagram.connections.filter(([, to]) => to === "gain_2.u")).toEqual([]);
    const sub = findPart(diagram, "sub_2");
    expect(sub?.conditions).toEqual({ reset: "sum_2.y" }); // `on` is an input of the sheet it came from
    expect(findPart(diagram, "gain_2")?.params).toEqual({ k: "k" });
  });

  it.each(["", "hello", '{"schema": "other"}', "[".repeat(1000)])("refuses the text %s", (text) => {
    expect(() => paste(start(), text)).toThrow();
  });
});

describe("undo", () => {
  it("goes back and forth over the very same diagrams", () => {
    const history = new History();
    const a = start();
    const b = removeParts(a, new Set(["gain"]));
    const c = removeParts(b, new Set(["sum"]));
    history.record(a, b, "delete gain");
    history.record(b, c, "delete sum");
    expect(history.undo()?.before).toBe(b);
    expect(history.undo()?.before).toBe(a);
    expect(history.canUndo).toBe(false);
    expect(history.redo()?.after).toBe(b);
    history.record(b, a, "else");
    expect(history.canRedo).toBe(false);
  });

  it("takes edits with one tag as one step", () => {
    const history = new History();
    const [a, b, c] = [start(), start(), start()];
    history.record(a, b, "k", "k of gain");
    history.record(b, c, "k", "k of gain");
    expect(history.undo()?.before).toBe(a);
  });
});
