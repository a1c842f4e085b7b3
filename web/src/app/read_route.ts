// Where one is: `#/fly?drone=2`. The part behind `#` never reaches the server, so a link works from a file too.

export interface Route {
  page: string;
  parts: string[];
  query: URLSearchParams;
}

/** Read `#/logs/LOG?at=12.5`; the default is the Fly page. */
export function readRoute(hash: string): Route {
  const [path = "", query = ""] = hash.replace(/^#\/?/, "").split("?", 2);
  const [page, ...parts] = path.split("/").filter(Boolean).map(decodeURIComponent);
  return { page: page ?? "fly", parts, query: new URLSearchParams(query) };
}

export function linkTo(page: string, parts: string[] = [], query: Record<string, string> = {}): string {
  const said = new URLSearchParams(query).toString();
  return `#/${[page, ...parts].map(encodeURIComponent).join("/")}${said && `?${said}`}`;
}
