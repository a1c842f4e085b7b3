import { describe, expect, it } from "vitest";
import { LatestOnly } from "../../src/pages/fly/latest_only";

describe("a slider's values", () => {
  const slow = () => {
    const ends: ((failure?: Error) => void)[] = [];
    const sent: number[] = [];
    const failures: unknown[] = [];
    const sender = new LatestOnly<number>(
      (value) => {
        sent.push(value);
        return new Promise<void>((done, fail) => ends.push((failure) => (failure ? fail(failure) : done())));
      },
      (failure) => failures.push(failure),
    );
    const end = async (failure?: Error) => {
      ends.shift()!(failure);
      await new Promise((done) => setTimeout(done));
    };
    return { sender, sent, failures, end };
  };
  it("go one at a time, the newest next, and the last one always arrives", async () => {
    const { sender, sent, end } = slow();
    for (const value of [1, 2, 3, 4]) sender.give(value);
    expect(sent).toEqual([1]);
    await end();
    expect(sent).toEqual([1, 4]);
    sender.give(5);
    await end();
    expect(sent).toEqual([1, 4, 5]);
  });
  it("that wait are let go with one that is refused, and the next is sent again", async () => {
    const { sender, sent, failures, end } = slow();
    sender.give(1);
    sender.give(2);
    await end(new Error("refused"));
    expect([sent, failures.length]).toEqual([[1], 1]);
    sender.give(3);
    expect(sent).toEqual([1, 3]);
  });
  it("that wait are let go when that is asked", async () => {
    const { sender, sent, end } = slow();
    sender.give(1);
    sender.give(2);
    sender.clear();
    await end();
    expect(sent).toEqual([1]);
  });
});
