// What the page's address asks for: `#/diagram/NAME` a kept diagram, `?starter=NAME` one to begin with.
import { linkTo, type Route } from "../../app/read_route";

export type Asked = { readonly file: string } | { readonly starter: string } | { readonly text: string; name: string };

/** Open diagram: its saved name or its starter; "" for the other. */
export interface Opened {
  readonly file: string;
  readonly starter: string;
}

/** Return what to open; undefined if it is open. */
export function askedBy(route: Route, { file, starter }: Opened): Asked | undefined {
  const [name] = route.parts;
  const begun = route.query.get("starter");
  if (name !== undefined) return name === file ? undefined : { file: name };
  return begun === null || begun === starter ? undefined : { starter: begun };
}

export function nameOf(asked: Asked): string {
  return "file" in asked ? asked.file : "starter" in asked ? asked.starter : asked.name;
}

/** Return the address of the open diagram; the rest of the query stays. */
export function addressOf({ file, starter }: Opened, { query }: Route): string {
  const others = [...query].filter(([key]) => key !== "starter");
  const said = starter === "" ? others : [...others, ["starter", starter]];
  return linkTo("diagram", file === "" ? [] : [file], Object.fromEntries(said));
}
