// A fit's curves as the plots take them.
import type { FitView, OutputCurves, ResidualTest } from "../../api/identification";
import { curve, type Series } from "../../chart/kinds";

/** Describe the fit of an output; in closed loop one sample ahead. */
export function fitWords(output: Pick<OutputCurves, "fit_percent" | "fit_percent_ahead">): string {
  const alone = `${output.fit_percent.toFixed(1)} %`;
  return output.fit_percent_ahead === null
    ? `FIT ${alone}, ${(100 - output.fit_percent).toFixed(0)} % of the motion unexplained`
    : `FIT ${output.fit_percent_ahead.toFixed(1)} % one sample ahead; drawn is the model without the gusts, ${alone}`;
}

export function fitSeries(output: OutputCurves): Series[] {
  const { time, unit, measured, simple, greybox } = output;
  const found = [curve("measured", "measured", time, measured, unit)];
  if (simple) found.push(curve("simple", "simple", time, simple, unit, { dash: [6, 3] }));
  if (greybox) found.push(curve("grey-box", "grey-box", time, greybox, unit));
  return found;
}

export function residualSeries(output: OutputCurves): Series[] {
  const model = output.greybox ? "grey-box" : "simple";
  return [curve(`measured − ${model}`, model, output.time, output.residual, output.unit)];
}

export function inputSeries(input: FitView["inputs"][number]): Series[] {
  return [curve(input.name, "input", input.time, input.value, input.unit)];
}

export function testSeries(test: ResidualTest): Series[] {
  const band = { low: test.bound.map((value) => -value), high: test.bound };
  const zero = test.lags.map(() => 0);
  return [
    curve("99 % bound", "set-point", test.lags, zero, "", { band }),
    curve("correlation", "grey-box", test.lags, test.value),
  ];
}

export function testWords(test: ResidualTest): string {
  const what = test.against === "itself" ? "white" : `independent of ${test.against}`;
  if (test.passed) return `${test.output}: the residual is ${what}`;
  const why =
    test.outside > test.allowed
      ? `${test.outside} of ${test.lags.length} lags outside, ${test.allowed} by chance`
      : "a lag lies further outside than by chance";
  return `${test.output}: the residual is not ${what} (${why})`;
}

/** Return the magnitude of a correlation, 0 to 1. */
export const strength = (value: number | null): number =>
  value === null || !Number.isFinite(value) ? 0 : Math.min(1, Math.abs(value));
