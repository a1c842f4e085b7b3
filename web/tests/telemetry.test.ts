import { afterEach, beforeEach, describe, expect, it, vi } from "vitest";
import { Telemetry, type LabEvent, type Socket } from "../src/api/telemetry";

class FakeSocket implements Socket {
  binaryType: BinaryType = "blob";
  readyState = 0;
  onopen: Socket["onopen"] = null;
  onclose: Socket["onclose"] = null;
  onmessage: Socket["onmessage"] = null;
  said: unknown[] = [];
  closed = false;
  send(data: string): void {
    this.said.push(JSON.parse(data));
  }
  close(): void {
    this.closed = true;
  }
  open(): void {
    this.readyState = 1;
    this.onopen?.({} as Event);
  }
  fail(): void {
    this.onclose?.({} as CloseEvent);
  }
  tell(data: unknown): void {
    this.onmessage?.({ data } as MessageEvent);
  }
}

function rows(id: number): ArrayBuffer {
  const data = new ArrayBuffer(24 + 12);
  const view = new DataView(data);
  view.setUint8(0, 1);
  view.setUint16(2, id, true);
  view.setUint32(4, 1, true);
  return data;
}

describe("the socket", () => {
  let sockets: FakeSocket[];
  let telemetry: Telemetry;
  const last = () => sockets[sockets.length - 1]!;
  beforeEach(() => {
    vi.useFakeTimers();
    sockets = [];
    telemetry = new Telemetry(() => {
      sockets.push(new FakeSocket());
      return last();
    });
  });
  afterEach(() => {
    telemetry.stop();
    vi.useRealTimers();
  });

  it("asks for what is subscribed, before and after it is open, and gives each the rows that are its own", () => {
    const [one, two] = [vi.fn(), vi.fn()];
    telemetry.subscribe(1, ["estimate.theta"], 250, one);
    telemetry.start();
    last().open();
    const stop = telemetry.subscribe(2, ["command.M"], 30, two);
    expect(last().said).toEqual([
      { do: "subscribe", id: 1, drone: 1, columns: ["estimate.theta"], rate: 250 },
      { do: "subscribe", id: 2, drone: 2, columns: ["command.M"], rate: 30 },
    ]);
    last().tell(rows(2));
    expect([one.mock.calls.length, two.mock.calls.length]).toEqual([0, 1]);
    stop();
    expect(last().said.at(-1)).toEqual({ do: "unsubscribe", id: 2 });
    last().tell(rows(2));
    expect(two.mock.calls.length).toBe(1);
  });

  it("ends a subscription also where the server is silent for a while", () => {
    telemetry.start();
    last().open();
    const stop = telemetry.subscribe(1, ["estimate.q"], 250, () => {});
    vi.advanceTimersByTime(3000);
    stop();
    last().tell(JSON.stringify({ event: "alive" }));
    expect(last().said).toContainEqual({ do: "unsubscribe", id: 1 });
  });

  it("answers that it is there, since the browser would say so for a page that is frozen", () => {
    const heard = vi.fn();
    telemetry.onEvent(heard);
    telemetry.start();
    last().open();
    last().tell(JSON.stringify({ event: "alive" }));
    expect(last().said).toEqual([{ do: "here" }]);
    expect(heard).not.toHaveBeenCalled();
  });

  it("comes back after a loss, later each time, and asks again", () => {
    telemetry.subscribe(1, ["estimate.q"], 250, () => {});
    telemetry.start();
    last().open();
    last().fail();
    expect(sockets.length).toBe(1);
    vi.advanceTimersByTime(250);
    expect(sockets.length).toBe(2);
    last().fail();
    vi.advanceTimersByTime(499);
    expect(sockets.length).toBe(2);
    vi.advanceTimersByTime(1);
    last().open();
    expect(last().said).toEqual([{ do: "subscribe", id: 1, drone: 1, columns: ["estimate.q"], rate: 250 }]);
  });

  it("never waits longer than 4 s, and not at all once the network is back", () => {
    telemetry.start();
    for (let loss = 0; loss < 10; loss++) {
      last().fail();
      vi.advanceTimersByTime(4000);
      expect(sockets.length).toBe(loss + 2);
    }
    last().fail();
    const before = sockets.length;
    telemetry.hurry();
    expect(sockets.length).toBe(before + 1);
  });

  it("opens a new socket at once when it is asked to, also while one still connects", () => {
    const seen: boolean[] = [];
    telemetry.onConnection((connected) => seen.push(connected));
    telemetry.start();
    telemetry.again();
    expect(sockets.length).toBe(2);
    last().open();
    expect(seen).toEqual([false, true]);
    telemetry.again();
    expect(sockets[1]!.closed).toBe(true);
    expect(sockets.length).toBe(3);
    expect(seen).toEqual([false, true, false]);
  });

  it("is lost when nothing comes over it any more, open or not", () => {
    const seen: boolean[] = [];
    telemetry.onConnection((connected) => seen.push(connected));
    telemetry.start();
    last().open();
    vi.advanceTimersByTime(2500);
    last().tell(rows(9));
    vi.advanceTimersByTime(2500);
    expect(seen).toEqual([true]);
    vi.advanceTimersByTime(500);
    expect(seen).toEqual([true, false]);
    vi.advanceTimersByTime(2500);
    expect(sockets[0]!.closed).toBe(false);
    last().tell(rows(9)); // a server that was only slow: closing would have disarmed the drone
    expect(seen).toEqual([true, false, true]);
    vi.advanceTimersByTime(6000);
    expect(seen).toEqual([true, false, true, false, false]);
    expect(sockets[0]!.closed).toBe(true);
    vi.advanceTimersByTime(250 + 6000);
    expect(sockets[1]!.closed).toBe(false);
    sockets[1]!.open();
    expect(sockets[1]!.closed).toBe(true);
    expect(seen).toEqual([true, false, true, false, false, false]);
  });

  it("is not lost by a page that stood still for longer, with what came meanwhile unread", () => {
    const seen: boolean[] = [];
    telemetry.onConnection((connected) => seen.push(connected));
    telemetry.start();
    last().open();
    vi.advanceTimersToNextTimer(); // what was due is served first, however long ago
    last().tell(rows(9));
    vi.advanceTimersByTime(2999);
    expect(seen).toEqual([true]);
  });

  it("asks again for rows of a drone that its new server did not know yet, once", () => {
    telemetry.subscribe(3, ["estimate.q"], 250, () => {});
    telemetry.subscribe(4, ["estimate.q"], 250, () => {});
    telemetry.start();
    last().open();
    const asked = (id: number, drone: number) => ({ do: "subscribe", id, drone, columns: ["estimate.q"], rate: 250 });
    expect(last().said).toEqual([asked(1, 3), asked(2, 4)]);
    last().tell('{"event":"refused","id":1,"what":"there is no such drone","where":"","remedy":""}');
    last().tell('{"event":"drone","drone":4,"state":{}}');
    expect(last().said.length).toBe(2);
    last().tell('{"event":"drone","drone":3,"state":{}}');
    expect(last().said.slice(2)).toEqual([asked(1, 3)]);
    last().tell('{"event":"refused","id":1,"what":"no such column","where":"","remedy":""}');
    last().tell('{"event":"drone","drone":3,"state":{}}');
    expect(last().said.length).toBe(3);
  });

  it("tells events until one listens no more", () => {
    const seen: LabEvent[] = [];
    const stop = telemetry.onEvent((event) => seen.push(event));
    telemetry.start();
    last().open();
    last().tell('{"event":"log","name":"a.mcap"}');
    stop();
    last().tell('{"event":"log","name":"b.mcap"}');
    expect(seen).toEqual([{ event: "log", name: "a.mcap" }]);
  });
});
