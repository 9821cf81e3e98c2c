// The past of published properties, from the archive, with a choice of how far back.
import { html, useMemo, useSignal } from "./lib.js";
import { useGet } from "./api.js";
import { Chart, pointsOf } from "./chart.js";
import { Card, Empty, Loaded, Segment } from "./parts.js";
import { skyNow } from "./store.js";

export const SPANS = [[1, "1 h"], [6, "6 h"], [24, "24 h"], [72, "3 d"]];

/** The newest hours of some properties: `{ data, t0, t1, series(property) }`. */
export function useHistory(id, properties, hours, points = 400, everyS = 30) {
  const now = useSignal(null);
  const t1 = now.value ?? skyNow();
  if (now.peek() === null && t1) now.value = t1;
  const t0 = t1 && t1 - hours * 3600e3;
  const stamp = (ms) => new Date(Math.floor(ms / 1000) * 1000).toISOString();
  // The end of the range is left to the archive, so that each repetition has what is new.
  const found = useGet(t1 && `/api/v1/telescopes/${id}/series?properties=${properties.map(encodeURIComponent).join(",")}&from_utc=${stamp(t0)}&points=${points}`, everyS);
  const series = (property) => {
    const [kind, device, name] = property.split("/");
    return (found.data?.rows ?? []).map((row) => row.series).find((one) => one && one.kind === kind && one.device === device && one.property === name);
  };
  // The axis ends when the newest answer came: a chart is made anew with new values, and not each second.
  const end = useMemo(() => skyNow() ?? 0, [found.at]);
  return { ...found, t0, t1: Math.max(t1 ?? 0, end), series };
}

export function History({ id, properties, title, unit, limits }) {
  const hours = useSignal(6);
  const past = useHistory(id, properties, hours.value);
  return html`<${Card} name=${`${title}, the past`} end=${html`<${Segment} label="How far back" options=${SPANS} value=${hours.value} onChange=${(value) => { hours.value = value; }} />`}>
    <${Loaded} of=${past} what="The past">${() => {
      const series = properties.map((property) => past.series(property)).filter(Boolean);
      if (!series.length) return html`<${Empty} icon="curve" title="The archive has no values of this time" />`;
      return html`<${Chart} t0=${past.t0} t1=${past.t1} now=${past.t1} panels=${series.map((one) => ({ name: one.property, unit, limits, height: 160, digits: 2, series: [
        { name: "mean", points: pointsOf(one), colour: "--s4" }, { name: "least", points: pointsOf(one, "min"), colour: "--s1", width: 0.8 }, { name: "most", points: pointsOf(one, "max"), colour: "--s2", width: 0.8 }] }))} />`;
    }}<//><//>`;
}
