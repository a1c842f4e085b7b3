// A large body, of which one sees how much has been sent: fetch does not tell that.
import { apiUrl, refusal, token, unreached } from "./client";

/**
 * Sends `content`; answers the JSON of the answer. `sent` is told the share that has been sent, from 0 to 1. It waits as
 * long as it takes: who waits sees it, and `end` ends it. Raises ApiError, and the signal's reason where that ended it.
 */
export function upload(path: string, content: Blob, sent: (share: number) => void, end: AbortSignal): Promise<unknown> {
  return new Promise((done, failed) => {
    end.throwIfAborted();
    const asked = new XMLHttpRequest();
    asked.open("POST", apiUrl(path));
    if (token()) asked.setRequestHeader("Authorization", `Bearer ${token()}`);
    asked.responseType = "json";
    asked.upload.onprogress = (event) => sent(event.total > 0 ? event.loaded / event.total : 1);
    asked.onload = () =>
      asked.status < 300 ? done(asked.response as unknown) : failed(refusal(asked.status, asked.response ?? {}));
    asked.onerror = () => failed(unreached(path));
    asked.onabort = () => failed(end.reason as Error);
    end.addEventListener("abort", () => asked.abort(), { once: true });
    asked.send(content);
  });
}
