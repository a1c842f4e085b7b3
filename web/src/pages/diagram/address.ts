// What the page's address asks for: `#/diagram/NAME` a kept diagram, `?starter=NAME` one to begin with.
import { linkTo, type Route } from "../../app/read_route";

export type Asked = { readonly file: string } | { readonly starter: string };

/** What is to be opened where `file` is open ("": one that was not kept yet); undefined where that is it. */
export function askedBy(route: Route, file: string): Asked | undefined {
  const [name] = route.parts;
  const starter = route.query.get("starter");
  if (name !== undefined) return name === file ? undefined : { file: name };
  return starter === null ? undefined : { starter };
}

export function nameOf(asked: Asked): string {
  return "file" in asked ? asked.file : asked.starter;
}

/** The address of what is open; what it says beside that, such as the drone, stays. */
export function addressOf(file: string, { query }: Route): string {
  const others = [...query].filter(([key]) => key !== "starter");
  return linkTo("diagram", file === "" ? [] : [file], Object.fromEntries(others));
}
