// Of one recorded telescope a network: one that observes, one whose focus failed, one that wind keeps closed, and one that is open and in danger.
const other = (states, id, change) => {
  const [from, to] = ["demo/alpha", id].map((name) => name.split("/")[1]);
  const keys = Object.entries(states).filter(([key]) => !key.includes("/node/web/"));
  const renamed = keys.map(([key, body]) => [key.replace("demo/alpha", id), JSON.parse(JSON.stringify(body).replaceAll(`demo/${from}`, id).replaceAll(`observatory/${from}`, `observatory/${to}`))]);
  const all = Object.fromEntries(renamed);
  for (const [key, what] of Object.entries(change)) all[`${id}/${key}`] = { ...all[`${id}/${key}`], ...what };
  return all;
};

const WIND = { input: "weather/WindSpeed", why: "17.3 m/s is above 15 m/s", clears_in_s: 1260 };
const alerts = (...list) => ({ alerts: list.map((alert) => ({ raised_utc: "2026-11-27T02:21:10.000000Z", ...alert })) });

/** Puts the four telescopes on the recorded bus. */
export async function network(bus) {
  const states = await bus.states();
  const dome = (shutter) => ({ "device/dome/dome/state": { fields: { ...states["demo/alpha/device/dome/dome/state"].fields, shutter } } });
  const windy = { fields: { ...states["demo/alpha/device/observingconditions/weather/state"].fields, wind_mps: 17.3, gust_mps: 21.8 } };
  const inputs = states["demo/alpha/observatory/safety/state"].inputs.map((one) => (one.input === WIND.input ? { ...one, value: "17.3", good: false } : one));
  const rows = states["demo/alpha/observatory/schedule/state"].rows.map((row) => (row.status === "running" ? { ...row, status: "interrupted", detail: WIND.why } : row));
  const stormy = { verdict: "unsafe", since_utc: "2026-11-27T02:18:00.000000Z", reasons: [WIND], time_to_safe_s: 1260, inputs };
  await bus.put({
    ...other(states, "demo/beta", {
      "observatory/night/state": { actions: [{ row: 4, action: "object", camera: "camera", object: "HATS-6", step: "exposing 31 of 60, 60 s, V", started_utc: "2026-11-27T02:01:00.000000Z" }], frames: 71 },
      "observatory/alerts/state": alerts({ id: "focus-failed/camera", priority: "medium", cause: "The focus run of camera found no curve: 2 of 9 points could be measured.", consequence: "Stars may be larger than they need to be.", action: "Look at the points of the run, and order a new one." }),
    }),
    ...other(states, "ridge/gamma", {
      "observatory/night/state": { actions: [], posture: "closed", frames: 44 }, "observatory/safety/state": stormy, "observatory/schedule/state": { rows }, ...dome("closed"), "device/observingconditions/weather/state": windy,
    }),
    ...other(states, "ridge/delta", {
      "observatory/night/state": { actions: [], posture: "open", frames: 12 }, "observatory/safety/state": stormy, "observatory/schedule/state": { rows }, "device/observingconditions/weather/state": windy,
      "observatory/alerts/state": alerts({ id: "dome-not-closed/dome", priority: "critical", cause: "dome is not verified closed 90 s after the close command.", consequence: "The telescope is exposed to the weather.", action: "Close the dome by hand or call the site." },
        { id: "no-lease", priority: "high", cause: "dome/dome grants no lease.", consequence: "Nothing can be opened or moved.", action: "Look at the device node of the dome.", acknowledged_by: "web/ana", acknowledged_utc: "2026-11-27T02:24:00.000000Z" }),
    }),
  });
}
