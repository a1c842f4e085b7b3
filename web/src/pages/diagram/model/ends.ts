// What can be wired: all sources and all destinations of a sheet, for a list to choose from.
import { declaredName, type Diagram } from "./diagram";
import { portOf, sourceText, tops, type Port, type Shapes } from "./shapes";

export interface End {
  /** As it stands in a connection. */
  readonly text: string;
  /** The part, input or output that it belongs to. */
  readonly owner: string;
  /** Type and unit, to stand behind the text. */
  readonly about: string;
  /** What a destination is fed by; "" if it is free. */
  readonly from: string;
}

function about(port: Port | undefined): string {
  if (port === undefined) return "";
  const kind = port.kind === "real" ? "" : ` ${port.kind}`;
  return `${kind}${port.width === null ? "" : ` × ${port.width}`}${port.unit && ` [${port.unit}]`}`;
}

/** The destinations of the wires at a part (p:), an input (i:) or an output (o:): into it first, then out of it. */
export function wiresAt(d: Diagram, id: string): string[] {
  const name = id.slice(2);
  if (id.startsWith("o:")) return d.outputs.flatMap(([one, source]) => (one === name && source !== null ? [one] : []));
  const into = d.connections.filter(([, to]) => id.startsWith("p:") && to.split(".")[0] === name);
  const all = [...d.connections, ...d.outputs.map(([one, source]) => [source ?? "", one] as const)];
  const out = all.filter(([source]) => source.split(".")[0] === name);
  return [...new Set([...into, ...out].map(([, to]) => to))];
}

export function sourcesOf(d: Diagram, shapes: Shapes): End[] {
  const inputs = tops(d.inputs.map(portOf)).map((name) => ({
    text: name,
    owner: name,
    about: about(d.inputs.filter((one) => declaredName(one) === name).map(portOf)[0]),
    from: "",
  }));
  const parts = d.parts.flatMap((part) => {
    const { outputs } = shapes.of(part.item);
    return tops(outputs).map((port) => ({
      text: sourceText(part, port, shapes),
      owner: part.name,
      about: about(outputs.find((one) => one.name === port)),
      from: "",
    }));
  });
  return [...parts, ...inputs];
}

export function destinationsOf(d: Diagram, shapes: Shapes): End[] {
  const fed = new Map(d.connections.map(([source, to]) => [to, source]));
  const parts = d.parts.flatMap((part) => {
    const { inputs } = shapes.of(part.item);
    return tops(inputs).map((port) => {
      const text = `${part.name}.${port}`;
      return {
        text,
        owner: part.name,
        about: about(inputs.find((one) => one.name === port)),
        from: fed.get(text) ?? "",
      };
    });
  });
  const outputs = d.outputs.map(([name, source]) => ({
    text: name,
    owner: name,
    about: " output",
    from: source ?? "",
  }));
  return [...parts, ...outputs];
}
