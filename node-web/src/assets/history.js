// The past of published properties, from the archive, with a choice of how far back.
import { html, useMemo } from "./lib.js";
import { useGet } from "./api.js";
import { Chart, pointsOf } from "./chart.js";
import { Card, Empty, Loaded, Segment } from "./parts.js";
import { go, route, withQuery } from "./route.js";
import { moment, skyNow, skySpeed } from "./store.js";

export const SPANS = [[1, "1 h"], [6, "6 h"], [24, "24 h"], [72, "3 d"]];

/** How far back a page looks, h, of `spans`, and what chooses it: it stands in the address. What was shown of the hours before is shown no more. */
export function hoursBack(spans, usual) {
  const asked = Number(route.value.query.get("hours"));
  const choose = (hours) => go(withQuery({ hours: hours === usual ? null : String(hours), from: null, to: null }), { replace: true });
  return /** @type {const} */ ([spans.some(([one]) => one === asked) ? asked : usual, choose]);
}

/** The words for so many hours. */
export const spanWords = (hours) => SPANS.find(([one]) => one === hours)[1];

/**
 * The answer for the newest hours: `{ found, t0, t1 }`. The window moves in steps of a sixtieth of it, and of a minute at least; meanwhile what is known stays. `pathOf(from)` is the
 * address; its end is left to the archive, so that each repetition has what is new.
 */
export function useWindow(hours, pathOf, everyS) {
  const step = Math.max(60e3 * skySpeed(), hours * 60e3);
  const now = moment.value === null ? null : Math.floor(moment.value / step) * step;
  const got = useGet(now && pathOf(new Date(now - hours * 3600e3).toISOString()), everyS, { keep: true });
  // What came for a longer or a shorter one is not shown as this one.
  const of = useMemo(() => hours, [got.data]);
  const found = of === hours ? got : { ...got, data: null, error: got.loading ? null : got.error };
  // The axis ends when the newest answer came or the window moved: a chart is made anew with new values, and not each second.
  const t1 = useMemo(() => skyNow() ?? 0, [got.data, now]);
  return { found, t0: t1 - hours * 3600e3, t1 };
}

/** The newest hours of some properties: `{ data, t0, t1, series(property) }`. */
export function useHistory(id, properties, hours, points = 400, everyS = 30) {
  const { found, t0, t1 } = useWindow(hours, (from) => `/api/v1/telescopes/${id}/series?properties=${properties.map(encodeURIComponent).join(",")}&from_utc=${from}&points=${points}`, everyS);
  const series = (property) => {
    const [kind, device, name] = property.split("/");
    const all = (found.data?.rows ?? []).map((row) => row.series).find((one) => one && one.kind === kind && one.device === device && one.property === name);
    return all && { ...all, points: (all.points ?? []).filter((point) => Date.parse(point.at_utc) >= t0) };
  };
  return { ...found, t0, t1, series };
}

export function History({ id, properties, title, unit, limits }) {
  const [hours, choose] = hoursBack(SPANS, 6);
  const past = useHistory(id, properties, hours);
  return html`<${Card} name=${`${title}, the past`} end=${html`<${Segment} label="How far back" options=${SPANS} value=${hours} onChange=${choose} />`}>
    <${Loaded} of=${past} what="The past">${() => {
      const series = properties.map((property) => past.series(property)).filter(Boolean);
      if (!series.length) return html`<${Empty} icon="curve" title="The archive has no values of this time" />`;
      return html`<${Chart} t0=${past.t0} t1=${past.t1} now=${past.t1} panels=${series.map((one) => ({ name: one.property, unit, limits, height: 160, digits: 2, series: [
        { name: "mean", points: pointsOf(one), colour: "--s4" }, { name: "least", points: pointsOf(one, "min"), colour: "--s1", width: 0.8 }, { name: "most", points: pointsOf(one, "max"), colour: "--s2", width: 0.8 }] }))} />`;
    }}<//><//>`;
}
