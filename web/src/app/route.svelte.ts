import { readRoute, type Route } from "./read_route";

export { linkTo } from "./read_route";

class CurrentRoute {
  now = $state<Route>(readRoute(location.hash));

  constructor() {
    addEventListener("hashchange", () => (this.now = readRoute(location.hash)));
  }

  /** Go to a page; `replace` leaves no step for the Back button. */
  go(link: string, replace = false): void {
    if (replace) {
      history.replaceState(null, "", link);
      this.now = readRoute(location.hash);
    } else {
      location.hash = link;
    }
  }
}

export const route = new CurrentRoute();
