// The ports of a block whose arguments the server has not answered yet, or has refused.
import { expect, test } from "vitest";
import type { Block } from "../../src/pages/diagram/model/diagram";
import { writeJson, type JsonObject } from "../../src/pages/diagram/model/json_text";
import { Shapes, type Shape } from "../../src/pages/diagram/model/shapes";

const block = (type: string, config: JsonObject): Block => ({ is: "block", type, json: { type, config } });
const port = (name: string) => ({ name, kind: "real", width: null, unit: "" });
const shape = (inputs: string[], structure: string): Shape => ({
  inputs: inputs.map(port),
  outputs: [port("y")],
  params: [],
  structure,
});
const inputs = (found: Shape): string[] => found.inputs.map((one) => one.name);

function seen(): Shapes {
  const shapes = new Shapes();
  const learn = (type: string, config: JsonObject, found: Shape): void =>
    shapes.learn(writeJson({ type, config }), found);
  learn("sum", { signs: "++", unit: "" }, shape(["a", "b"], "two"));
  learn("sum", { signs: "+++", unit: "" }, shape(["a", "b", "c"], "three"));
  learn("gain", { k: "1" }, shape(["u"], "gain"));
  return shapes;
}

test("a block that is not known yet keeps the ports of the one with the most arguments in common", () => {
  const shapes = seen();
  expect(inputs(shapes.of(block("sum", { signs: "+++", unit: "rad" })))).toEqual(["a", "b", "c"]);
  expect(inputs(shapes.of(block("sum", { signs: "++", unit: "rad" })))).toEqual(["a", "b"]);
  expect(inputs(shapes.of(block("pid", { Kp: "1" })))).toEqual([]);
});

test("a block that is refused keeps its ports, and one that is answered has its own", () => {
  const shapes = seen();
  const changed = block("sum", { signs: "+?+", unit: "" });
  const refusal = { what: "signs='+?+'", where: "Sum", remedy: "use + and -" };
  shapes.learn(shapes.key(changed), refusal);
  expect(shapes.refusal(changed)).toEqual(refusal);
  expect(inputs(shapes.of(changed)).length).toBeGreaterThan(1);
  const wider = block("sum", { signs: "++++", unit: "" });
  expect(inputs(shapes.of(wider))).toHaveLength(3);
  shapes.learn(shapes.key(wider), shape(["a", "b", "c", "d"], "four"));
  expect(inputs(shapes.of(wider))).toEqual(["a", "b", "c", "d"]);
});
