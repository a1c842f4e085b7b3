// From a wire to the signal that flows in it: through the borders of sub-diagrams to the block that gives it.
import { diagramAt, findPart, type Diagram } from "./diagram";
import { sourceEnd, type Shapes } from "./shapes";

/** Output of a block by its path, "sub.gain.y", or an input of the diagram. */
export interface Origin {
  readonly of: "block" | "input";
  readonly path: string;
  /** Sheet and source there: "gain.y", or an input. */
  readonly sheet: readonly string[];
  readonly source: string;
}

const MOST = 200; // borders that a wire may cross

/** Trace a source on the sheet at `path` to its origin. */
export function originOf(root: Diagram, path: readonly string[], source: string, shapes: Shapes): Origin | undefined {
  let at = [...path];
  let text = source;
  for (let n = 0; n < MOST; n++) {
    const here = diagramAt(root, at);
    const end = here === undefined ? undefined : sourceEnd(here, shapes, text);
    if (here === undefined || end === undefined) return undefined;
    const [name, port] = end;
    if (name === null) {
      const outer = at.at(-1);
      if (outer === undefined) return { of: "input", path: port, sheet: [], source: port };
      at = at.slice(0, -1);
      const fed = diagramAt(root, at)?.connections.find(([, to]) => to === `${outer}.${port}`)?.[0];
      if (fed === undefined) return undefined;
      text = fed;
      continue;
    }
    const item = findPart(here, name)?.item;
    if (item?.is === "block") {
      return { of: "block", path: [...at, name, port].join("."), sheet: at, source: `${name}.${port}` };
    }
    const inner = item?.outputs.find(([output]) => output === port)?.[1];
    if (inner === undefined || inner === null) return undefined;
    at = [...at, name];
    text = inner;
  }
  return undefined;
}

/** Return the declared unit of a signal; "" if there is none. */
export function unitOf(root: Diagram, origin: Origin, shapes: Shapes): string {
  const sheet = diagramAt(root, origin.sheet);
  return sheet === undefined ? "" : shapes.carried(sheet, origin.source).unit;
}
