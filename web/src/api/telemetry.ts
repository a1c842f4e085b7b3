// One web socket for everything that the server tells by itself: rows of telemetry, and events. It comes back by
// itself after a loss, and asks again for what was subscribed.
import { apiUrl, token } from "./client";
import type { DroneState, DroneText } from "./drones";
import { readRows, type Rows } from "./rows";

export type LabEvent =
  | { event: "drone"; drone: number; state: DroneState }
  | ({ event: "text" } & DroneText)
  | { event: "parameters"; drone: number; names: string[] }
  | { event: "job"; id: string; [field: string]: unknown }
  | { event: "log"; name: string }
  | { event: "refused"; id: number; what: string; where: string; remedy: string };

/** Part of WebSocket that is used. */
export interface Socket {
  binaryType: BinaryType;
  /** 0 while it connects. */
  readonly readyState: number;
  onopen: ((event: Event) => unknown) | null;
  onclose: ((event: CloseEvent) => unknown) | null;
  onmessage: ((event: MessageEvent) => unknown) | null;
  send(data: string): void;
  close(): void;
}

interface Subscription {
  drone: number;
  columns: readonly string[];
  rate: number;
  onRows: (rows: Rows) => void;
}

const FIRST_WAIT_MS = 250;
const LONGEST_WAIT_MS = 4000;
/** A socket that is silent for so long is told as lost, and later given up; the server says each second "alive". */
const SILENCE_MS = 3000;
const LOST_MS = 6000;
/** Last part of it, so that a page that stood still reads its queue first. */
const AWAKE_MS = 500;
const [CONNECTING, OPEN] = [0, 1];

export class Telemetry {
  private readonly subscriptions = new Map<number, Subscription>();
  private readonly listeners = new Set<(event: LabEvent) => void>();
  private readonly watchers = new Set<(connected: boolean) => void>();
  /** Drones that this socket reported, and subscriptions refused before their drone was known. */
  private readonly told = new Set<number>();
  private readonly refused = new Set<number>();
  private socket: Socket | undefined;
  private connected = false;
  private attempts = 0;
  private lastId = 0;
  private retry: ReturnType<typeof setTimeout> | undefined;
  private silence: ReturnType<typeof setTimeout> | undefined;

  constructor(private readonly connect: () => Socket) {}

  start(): void {
    if (this.socket === undefined) this.open();
  }

  stop(): void {
    clearTimeout(this.retry);
    this.drop();
    this.say(false);
  }

  /** Reconnect at once, when the network or the tab is back. */
  hurry(): void {
    if (this.socket !== undefined) return;
    this.attempts = 0;
    this.start();
  }

  /** Give the socket up, also one that still connects, and open a new one at once. */
  again(): void {
    this.stop();
    this.hurry();
  }

  /**
   * Has `onRows` called with the rows of these columns of signals.TOPICS, at most `rate` [Hz] a second, until the
   * answered function is called. Below the full rate each bucket keeps its minimum and its maximum.
   */
  subscribe(drone: number, columns: readonly string[], rate: number, onRows: (rows: Rows) => void): () => void {
    do this.lastId = (this.lastId % 0xffff) + 1;
    while (this.subscriptions.has(this.lastId));
    const id = this.lastId;
    this.subscriptions.set(id, { drone, columns, rate, onRows });
    if (this.connected) this.ask(id);
    return () => {
      this.refused.delete(id);
      if (this.subscriptions.delete(id) && this.socket?.readyState === OPEN)
        this.socket.send(JSON.stringify({ do: "unsubscribe", id })); // a server that is silent reads it later
    };
  }

  /** Call `listener` with each event. Returns a function that ends it. */
  onEvent(listener: (event: LabEvent) => void): () => void {
    this.listeners.add(listener);
    return () => this.listeners.delete(listener);
  }

  onConnection(watcher: (connected: boolean) => void): () => void {
    this.watchers.add(watcher);
    return () => this.watchers.delete(watcher);
  }

  private open(): void {
    clearTimeout(this.retry);
    const socket = (this.socket = this.connect());
    socket.binaryType = "arraybuffer";
    socket.onopen = () => this.heard();
    socket.onmessage = (message: MessageEvent) => {
      this.heard();
      if (message.data instanceof ArrayBuffer) this.rows(message.data);
      else this.event(String(message.data));
    };
    socket.onclose = () => this.lost();
    // A server that accepts and then says nothing, before the socket is open, is lost as well.
    this.heard();
  }

  private ask(id: number): void {
    const one = this.subscriptions.get(id);
    if (one === undefined) return;
    const { drone, columns, rate } = one;
    this.socket?.send(JSON.stringify({ do: "subscribe", id, drone, columns, rate }));
  }

  private rows(data: ArrayBuffer): void {
    const rows = readRows(data);
    if (rows !== undefined) this.subscriptions.get(rows.id)?.onRows(rows);
  }

  private event(text: string): void {
    const event = JSON.parse(text) as LabEvent | { event: "alive" };
    if (event.event === "alive") {
      // Said by the page itself, not by a timer: a hidden tab is there, a frozen one is not.
      this.socket?.send(JSON.stringify({ do: "here" }));
      return;
    }
    if (event.event === "refused") this.refused.add(event.id);
    else if (event.event === "drone" && !this.told.has(event.drone)) this.comes(event.drone);
    for (const listener of this.listeners) listener(event);
  }

  /** Repeat subscriptions that a restarted server refused because it did not know the drone yet. */
  private comes(drone: number): void {
    this.told.add(drone);
    for (const id of this.refused)
      if (this.subscriptions.get(id)?.drone === drone) {
        this.refused.delete(id);
        this.ask(id);
      }
  }

  private heard(): void {
    clearTimeout(this.silence);
    if (!this.connected && this.socket?.readyState === OPEN) {
      this.connected = true;
      this.attempts = 0;
      for (const id of this.subscriptions.keys()) this.ask(id);
      this.say(true);
    }
    const then = (wait: number, act: () => void) => (this.silence = setTimeout(act, wait));
    const hush = () => {
      if (this.connected) this.say((this.connected = false));
      then(LOST_MS - SILENCE_MS, () => this.lost());
    };
    then(SILENCE_MS - AWAKE_MS, () => then(AWAKE_MS, hush));
  }

  private drop(): void {
    clearTimeout(this.silence);
    const { socket } = this;
    this.socket = undefined;
    this.connected = false;
    this.told.clear();
    this.refused.clear();
    if (socket === undefined) return;
    socket.onopen = socket.onclose = socket.onmessage = null;
    // A browser takes the closing of one that still connects for an error.
    if (socket.readyState === CONNECTING) socket.onopen = () => socket.close();
    else socket.close();
  }

  private lost(): void {
    this.drop();
    const wait = Math.min(LONGEST_WAIT_MS, FIRST_WAIT_MS * 2 ** this.attempts++);
    clearTimeout(this.retry);
    this.retry = setTimeout(() => this.open(), wait);
    this.say(false);
  }

  private say(connected: boolean): void {
    for (const watcher of this.watchers) watcher(connected);
  }
}

function openSocket(): Socket {
  const url = apiUrl("telemetry");
  url.protocol = url.protocol.replace("http", "ws");
  if (token()) url.searchParams.set("token", token());
  return new WebSocket(url);
}

export const telemetry = new Telemetry(openSocket);
