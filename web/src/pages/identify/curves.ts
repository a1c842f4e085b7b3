// A fit's curves as the plots take them.
import type { FitView, OutputCurves, ResidualTest } from "../../api/identification";
import type { Series } from "../../chart/kinds";
import { screenUnit } from "../../design/units";

const numbers = (values: readonly (number | null)[], factor: number) =>
  Float64Array.from(values, (value) => (value === null ? NaN : value * factor));

/** Describe the fit of an output; in closed loop one sample ahead. */
export function fitWords(output: Pick<OutputCurves, "fit_percent" | "fit_percent_ahead">): string {
  const alone = `${output.fit_percent.toFixed(1)} %`;
  return output.fit_percent_ahead === null
    ? `FIT ${alone}`
    : `FIT ${output.fit_percent_ahead.toFixed(1)} % one sample ahead; drawn is the model without the gusts, ${alone}`;
}

export function fitSeries(output: OutputCurves): Series[] {
  const { factor } = screenUnit(output.unit);
  const x = Float64Array.from(output.time);
  const found: Series[] = [{ label: "measured", x, y: numbers(output.measured, factor), kind: "measured" }];
  if (output.simple)
    found.push({ label: "simple", x, y: numbers(output.simple, factor), kind: "simple", dash: [6, 3] });
  if (output.greybox) found.push({ label: "grey-box", x, y: numbers(output.greybox, factor), kind: "grey-box" });
  return found;
}

export function residualSeries(output: OutputCurves): Series[] {
  const { factor } = screenUnit(output.unit);
  return [
    {
      label: output.greybox ? "measured − grey-box" : "measured − simple",
      x: Float64Array.from(output.time),
      y: numbers(output.residual, factor),
      kind: output.greybox ? "grey-box" : "simple",
    },
  ];
}

export function inputSeries(input: FitView["inputs"][number]): Series[] {
  const { factor } = screenUnit(input.unit);
  return [{ label: input.name, x: Float64Array.from(input.time), y: numbers(input.value, factor), kind: "input" }];
}

/** Return a correlation over its lags, with its bound. */
export function testSeries(test: ResidualTest): Series[] {
  const x = Float64Array.from(test.lags);
  const high = Float64Array.from(test.bound);
  const low = high.map((value) => -value);
  return [
    { label: "99 % bound", x, y: x.map(() => 0), kind: "set-point", band: { low, high } },
    { label: "correlation", x, y: Float64Array.from(test.value), kind: "grey-box" },
  ];
}

export function testWords(test: ResidualTest): string {
  const what = test.against === "itself" ? "white" : `independent of ${test.against}`;
  return test.passed
    ? `${test.output}: the residual is ${what}`
    : `${test.output}: the residual is not ${what} (${test.outside} of ${test.lags.length} lags outside, ${test.allowed} by chance)`;
}

/** Return the magnitude of a correlation, 0 to 1. */
export function strength(value: number | null): number {
  return value === null || !Number.isFinite(value) ? 0 : Math.min(1, Math.abs(value));
}
