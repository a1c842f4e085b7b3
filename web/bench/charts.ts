// A page for measuring: 15 channels at 250 Hz on five strip charts, made up here, and the curves of a static plot.
// `?seconds=60` are there at once; `?live=1` goes on in real time, `?live=15` fifteen times as fast.
import { mount } from "svelte";
import "../src/design/tokens.css";
import "../src/design/base.css";
import { History } from "../src/chart/history";
import { DEGREES, type Panel, type Series } from "../src/chart/kinds";
import LinePlot from "../src/chart/LinePlot.svelte";
import { latency } from "../src/chart/latency";
import StripCharts from "../src/chart/StripCharts.svelte";
import { TimeView } from "../src/chart/views.svelte";

const RATE = 250;
const asked = new URLSearchParams(location.search);
const seconds = Number(asked.get("seconds") ?? 60);
const live = Number(asked.get("live") ?? 0);

const PANELS: readonly Panel[] = [
  {
    label: "Pitch",
    least: 1,
    channels: [
      { column: "truth.theta", label: "truth", kind: "truth", unit: "deg", factor: DEGREES },
      { column: "estimate.theta", label: "estimate", kind: "estimate", unit: "deg", factor: DEGREES },
      { column: "setpoint.theta", label: "set-point", kind: "set-point", unit: "deg", factor: DEGREES },
    ],
  },
  {
    label: "Pitch rate",
    least: 1,
    channels: [
      { column: "imu.gyro_y", label: "gyro", kind: "measured", unit: "deg/s", factor: DEGREES },
      { column: "estimate.q", label: "estimate", kind: "estimate", unit: "deg/s", factor: DEGREES },
      { column: "setpoint.q", label: "set-point", kind: "set-point", unit: "deg/s", factor: DEGREES },
    ],
  },
  {
    label: "Position",
    least: 1,
    channels: [
      { column: "tof.distance", label: "range", kind: "measured", unit: "m" },
      { column: "estimate.x", label: "estimate", kind: "estimate", unit: "m" },
      { column: "setpoint.x", label: "set-point", kind: "set-point", unit: "m" },
    ],
  },
  {
    label: "Velocity",
    least: 1,
    channels: [
      { column: "truth.v", label: "truth", kind: "truth", unit: "m/s" },
      { column: "estimate.v", label: "estimate", kind: "estimate", unit: "m/s" },
      { column: "setpoint.v", label: "set-point", kind: "set-point", unit: "m/s" },
    ],
  },
  {
    label: "Commands",
    least: 1,
    channels: [
      { column: "command.M", label: "M", kind: "input", unit: "" },
      { column: "command.T", label: "T", kind: "simple", unit: "" },
      { column: "imu.acc_x", label: "acc x", kind: "measured", unit: "m/s²" },
    ],
  },
];

const names = PANELS.flatMap((panel) => panel.channels.map((one) => one.column));
const history = new History([...names, "state.mode"]);
let seed = 1;
const noise = (): number => {
  seed = (Math.imul(seed, 1664525) + 1013904223) >>> 0;
  return seed / 2 ** 31 - 1;
};

/** Row k: a pitch that answers steps each four seconds as a second-order system would, and the rest about it. */
function row(k: number): number[] {
  const t = k / RATE;
  const wanted = Math.floor(t / 4) % 2 ? 0.17 : 0;
  const since = t % 4;
  const ring = Math.exp(-5 * since) * Math.cos(8 * since);
  const theta = t < 4 ? 0 : wanted + (wanted ? -0.17 : 0.17) * ring;
  const q = 0.2 * Math.exp(-5 * since) * Math.sin(8 * since);
  const x = 0.1 * Math.sin(0.5 * t);
  const v = 0.05 * Math.cos(0.5 * t);
  const n = 0.003 * noise();
  return [theta, theta + n, wanted, q + 10 * n, q + n, 0, 0.5 + x + n, x + 0.3 * n, 0, v, v + n, 0, q, 0.4, 30 * n, 3];
}

let made = 0;
function add(rows: number): void {
  const time = new Float64Array(rows);
  const columns = [...names, "state.mode"].map(() => new Float32Array(rows));
  for (let k = 0; k < rows; k += 1, made += 1) {
    time[k] = made / RATE;
    row(made).forEach((value, c) => (columns[c]![k] = value));
  }
  history.append({ time, columns, sent: (performance.timeOrigin + performance.now()) / 1000 });
}
add(Math.round(seconds * RATE));
if (live) {
  const began = performance.now();
  setInterval(
    () => add(Math.max(0, Math.round((seconds + ((performance.now() - began) / 1000) * live) * RATE) - made)),
    20,
  );
}

const view = new TimeView(history);
if (seconds) view.zoom(Math.min(60, seconds) / view.span, history.newest);
const target = document.getElementById("app")!;
mount(StripCharts, { target, props: { history, panels: PANELS, view, height: 110 } });
if (asked.has("plot")) {
  const x = Float64Array.from({ length: 2000 }, (_, k) => k / 200);
  const y = x.map((t) => 1 - Math.exp(-t) * Math.cos(4 * t));
  const series: Series[] = [
    { label: "measured", kind: "measured", x, y: y.map((value) => value + 0.02 * noise()) },
    { label: "simple", kind: "simple", x, y: x.map((t) => 1 - Math.exp(-t)) },
    { label: "grey-box", kind: "grey-box", x, y, band: { low: y.map((v) => v - 0.06), high: y.map((v) => v + 0.06) } },
  ];
  mount(LinePlot, {
    target,
    props: { label: "Step response", series, xLabel: "time [s]", yLabel: "θ [deg]", file: "step" },
  });
}
Object.assign(window, { bench: { history, view, latency } });
