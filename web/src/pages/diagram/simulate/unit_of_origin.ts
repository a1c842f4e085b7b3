import { diagramAt, findPart, type Diagram } from "../model/diagram";
import { portOf, type Shapes } from "../model/shapes";
import type { Origin } from "../model/signals";

/** The unit that is declared where a signal comes from; "" where none is. */
export function unitOfOrigin(root: Diagram, origin: Origin, shapes: Shapes): string {
  if (origin.of === "input") return root.inputs.map(portOf).find((one) => one.name === origin.path)?.unit ?? "";
  // The block's path has as many names as there are sheets: what is behind it is the port, perhaps a field.
  const names = origin.path.split(".");
  for (let n = 0; n < names.length - 1; n++) {
    const part = diagramAt(root, names.slice(0, n)) && findPart(diagramAt(root, names.slice(0, n))!, names[n]!);
    if (part === undefined) return "";
    if (part.item.is === "block") {
      const port = names.slice(n + 1).join(".");
      return shapes.of(part.item).outputs.find((one) => one.name === port)?.unit ?? "";
    }
  }
  return "";
}
