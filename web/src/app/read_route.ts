// Where one is: `#/fly?drone=2`. The part behind `#` never reaches the server, so a link works from a file too.

/** A page's name and what its link says beside it. */
export interface Route {
  page: string;
  parts: string[];
  query: URLSearchParams;
}

/** Reads `#/logs/LOG?at=12.5`; an empty one is the page to fly from. */
export function readRoute(hash: string): Route {
  const [path = "", query = ""] = hash.replace(/^#\/?/, "").split("?", 2);
  const [page, ...parts] = path.split("/").filter(Boolean).map(decodeURIComponent);
  return { page: page ?? "fly", parts, query: new URLSearchParams(query) };
}

/** The link to a page, with its parts and query. */
export function linkTo(page: string, parts: string[] = [], query: Record<string, string> = {}): string {
  const said = new URLSearchParams(query).toString();
  return `#/${[page, ...parts].map(encodeURIComponent).join("/")}${said && `?${said}`}`;
}
