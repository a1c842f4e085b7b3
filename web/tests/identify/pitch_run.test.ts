import { beforeEach, describe, expect, it, vi } from "vitest";
import type { FlownExperiment } from "../../src/api/identification";

/** How the flights end, the first one first: "" to its end. */
let ends: string[] = [];
const flown: string[] = [];
const shown: string[] = [];
let fitted = 0;

vi.mock("../../src/api/identification", () => ({
  identificationChoices: () =>
    Promise.resolve({ experiments: [{ name: "impulse" }, { name: "doublet" }], flights: [], kinds: [] }),
  flyExperiment: ({ name }: { name: string }) => {
    flown.push(name);
    return Promise.resolve({ log: `${name}.mcap`, experiment: name, reason: ends.shift() ?? "" } as FlownExperiment);
  },
  fitLog: () => Promise.resolve({ view: { fit: (fitted += 1) } }),
  stopFlight: vi.fn(),
}));
vi.mock("../../src/api/jobs", () => ({ jobResult: (result: unknown) => Promise.resolve(result), cancelJob: vi.fn() }));

const { Identification } = await import("../../src/pages/identify/identification.svelte");

/** A run that notes what the page says is being done. */
async function pitchRun(virtual: boolean): Promise<InstanceType<typeof Identification>> {
  const work = new Identification();
  await work.load();
  const fly = work.fly.bind(work);
  work.fly = (drone, since) => {
    const begun = fly(drone, since);
    shown.push(work.running?.doing ?? "");
    return begun;
  };
  await work.runPitch(1, virtual);
  return work;
}

describe("the whole pitch run", () => {
  beforeEach(() => {
    flown.length = shown.length = fitted = 0;
  });
  it("says why it flies a virtual drone again", async () => {
    ends = ["", "the failsafe acts"];
    const work = await pitchRun(true);
    expect(flown).toEqual(["impulse", "doublet", "doublet"]);
    expect(shown).toEqual(["Flying impulse", "Flying doublet", "Flying doublet again: the failsafe acts"]);
    expect([fitted, work.failure]).toEqual([1, ""]);
  });
  it("says so where no flight came to its end, and fits nothing", async () => {
    ends = ["", "a", "b", "the failsafe acts"];
    const work = await pitchRun(true);
    expect(flown).toHaveLength(4);
    expect(fitted).toBe(0);
    expect(work.failure).toContain("doublet was flown 3 times");
    expect(work.failure).toContain("the failsafe acts");
  });
  it("flies a real drone once", async () => {
    ends = ["the failsafe acts"];
    const work = await pitchRun(false);
    expect(flown).toEqual(["impulse"]);
    expect(work.failure).toContain("the failsafe acts");
  });
});
