import { get } from "./client";

/** Who this client is to the server, and the path with which others may only watch ("" where there is none). */
export interface LabSession {
  role: "command" | "watch";
  version: string;
  watch_link: string;
}

export const labSession = () => get<LabSession>("session");

/** The link that shows this view to somebody who may only watch. */
export function viewersLink(watchLink: string, here: URL): string {
  return new URL(watchLink, here).href + here.hash;
}

/** Whether a link leads to the very computer on which it is opened. */
export function isThisComputerOnly(link: URL): boolean {
  return /^(localhost|127(\.\d+){3}|\[::1\])$/.test(link.hostname);
}
