import { linkTo, readRoute, type Route } from "./read_route";

export { linkTo } from "./read_route";

class CurrentRoute {
  now = $state<Route>(readRoute(location.hash));

  constructor() {
    addEventListener("hashchange", () => (this.now = readRoute(location.hash)));
  }

  /** Return whether a page is open; it may have been left during a call. */
  on(page: string): boolean {
    return readRoute(location.hash).page === page;
  }

  /**
   * Go to a page; `replace` leaves no step for the Back button. It says where one is within a page, and does nothing
   * once that page was left.
   */
  go(link: string, replace = false): void {
    if (replace) {
      if (!this.on(readRoute(link).page)) return;
      history.replaceState(null, "", link);
      this.now = readRoute(location.hash);
    } else {
      location.hash = link;
    }
  }

  /** Change words of the query in the address, without a step for the Back button; "" removes one. */
  ask(words: Readonly<Record<string, string>>): void {
    const query = { ...Object.fromEntries(this.now.query), ...words };
    const kept = Object.fromEntries(Object.entries(query).filter(([, word]) => word !== ""));
    this.go(linkTo(this.now.page, this.now.parts, kept), true);
  }
}

export const route = new CurrentRoute();
