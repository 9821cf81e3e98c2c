// A network of fifty telescopes at five sites, as a server would tell it: the socket and the reads of the page are answered here, the same each time.
const SITES = ["La Silla", "Paranal", "San Pedro", "Teide", "Sutherland"].map((name) => name.toLowerCase().replace(" ", "-"));
const NAMES = "io europa ganymede callisto amalthea himalia elara pasiphae sinope lysithea carme ananke leda thebe adrastea metis kale taygete chaldene harpalyke".split(" ");
const UTC = "2026-11-27T02:28:00Z";

const idOf = (n) => `${SITES[n % 5]}/${NAMES[n % NAMES.length]}${n < NAMES.length ? "" : n}`;

/** One of them: most observe, some wait for wind, three need somebody. */
function telescope(n) {
  const id = idOf(n);
  const [site_id, telescope_id] = id.split("/");
  const isWindy = n % 7 === 3;
  const alert = (priority, cause) => [{ id: `${priority}-${n}`, priority, raised_utc: UTC, cause, consequence: "Something may happen.", action: "Look at it." }];
  const alerts = { 17: alert("critical", "dome is not verified closed 90 s after the close command."), 31: alert("high", "The mount is lost."), 44: alert("medium", "The focus run of camera found no curve.") }[n] ?? [];
  return {
    id, site_id, telescope_id, place: { latitude_deg: -29.2, longitude_deg: -70.7, elevation_m: 2400 }, shared: false, quality: "fresh",
    safety: isWindy ? { state: "unsafe", since_utc: UTC, reasons: [{ input: "weather/WindSpeed", why: "17.3 m/s is above 15 m/s", clears_in_s: null }], suspended: [], advisories: [] } : { state: "safe", since_utc: UTC, reasons: [], suspended: [], advisories: [] },
    posture: isWindy && n !== 17 ? "closed" : "open", mode: "robotic", simulated: false, speed: 1, ended: false,
    activity: isWindy ? [] : [{ row: 2, action: n % 11 ? "object" : "autofocus", camera: "camera", object: n % 11 ? ["WASP-18", "TRAPPIST-1", "a name of a field that is long, NGC 2516 east"][n % 3] : null, step: `exposing ${n} of 60, 60 s, V`, started_utc: UTC, expected_by_utc: ["2026-11-27T09:00:00Z", "2026-11-27T02:20:00Z", undefined][n % 3] }],
    frames: 100 + n, alerts, alert_counts: { critical: 0, high: 0, medium: 0, advisory: 0 }, now: "nothing under way", posture_by: "observatory", domes: [], concern: n === 17 ? "critical" : null, safety_concern: n === 17 ? "critical" : null,
    figures: { guide_rms_arcsec: 0.3 + n / 100, fwhm_arcsec: 1.2 + n / 50 }, schedule: { rows: 9, finished: n % 9 }, device_count: { known: 10, lost: n === 31 ? 1 : 0 }, node_count: { known: 4, lost: 0 },
    image: { frame: `frame-${n}`, camera: "camera", object: null, image_type: "light", filter: "V", exposure_s: 60, started_utc: UTC, size_px: [64, 64], problem: null },
    age_s: 0.1, image_age_s: 5, reported_utc: UTC,
  };
}

const WEATHER = { link: { is: "connected" }, busy: false, period_s: 5, fields: { wind_mps: 7.4, gust_mps: 9.1, humidity_percent: 31, sky_c: -30.2, air_c: 8.1, rain_mm_per_h: 0 }, readings: {} };

/**
 * Answers for a page, which are asked before those that it was given earlier: `told` are the summaries by id, `tell(...summaries)` changes some, those in `silent` grow old,
 * `images` are the telescopes whose image was asked for. A socket takes `limits.topics` topics; `topics()` are those that the page has, and `refusals` those that it was refused, in their order.
 */
export async function serveFifty(page, count = 50) {
  const told = new Map(Array.from({ length: count }, (_, n) => telescope(n)).map((one) => [one.id, one]));
  /** Each with its topics. */
  const sockets = new Map();
  const silent = new Set();
  const images = [];
  const limits = { topics: 256 };
  const refusals = [];
  const message = (op, more) => JSON.stringify({ op, at_utc: new Date(Date.parse(UTC) + performance.now()).toISOString(), data: { speed: 1 }, ...more });
  const send = (text) => { for (const socket of sockets.keys()) socket.send(text); };
  const beat = () => send(message("delta", { topic: "net", data: { ages: Object.fromEntries([...told.values()].map((one) => [one.id, { age_s: silent.has(one.id) ? 600 : 0.1, image_age_s: 5, reported_utc: UTC }])) } }));
  const states = (topic) => {
    const [, site, name, ...below] = topic.split("/");
    const path = below.join("/");
    const body = path === "device/observingconditions" ? WEATHER : path === "observatory/schedule" ? { rows: [{ row: 0, action: "object", object: "WASP-18", status: "running", start_utc: "2026-11-27T00:30:00Z", end_utc: "2026-11-27T05:00:00Z" }] } : null;
    const key = path === "observatory/schedule" ? `${site}/${name}/${path}/state` : `${site}/${name}/${path}/weather/state`;
    return body ? { [key]: { body, at_utc: UTC, age_s: 0.2, period_s: 5 } } : {};
  };
  await page.routeWebSocket(/\/api\/v1\/ws/, (socket) => {
    const subscribed = new Set();
    sockets.set(socket, subscribed);
    socket.onClose(() => sockets.delete(socket));
    socket.onMessage((text) => {
      const { op, topics = [] } = JSON.parse(String(text));
      if (op === "ping") return socket.send(message("pong", {}));
      if (op === "unsub") for (const topic of topics) subscribed.delete(topic);
      if (op !== "sub") return undefined;
      for (const topic of topics) {
        if (subscribed.size >= limits.topics && !subscribed.has(topic)) {
          refusals.push(topic);
          socket.send(message("err", { topic, data: { title: "Invalid", detail: `One socket may have ${limits.topics} topics; end some with unsub, or open another socket.` } }));
          continue;
        }
        subscribed.add(topic);
        if (topic === "net") socket.send(message("snap", { topic, data: { items: Object.fromEntries(told) } }));
        else if (topic.startsWith("tel/")) socket.send(message("snap", { topic, data: { states: states(topic) } }));
        else socket.send(message("snap", { topic, data: topic === "alerts" ? { items: {} } : [] }));
      }
      return undefined;
    });
    socket.send(message("welcome", { data: { version: "test", speed: 1, most_topics: limits.topics } }));
  });
  await page.route(/\/api\/v1\/telescopes\//, (route) => {
    const { pathname } = new URL(route.request().url());
    if (pathname.endsWith("/report")) return route.fulfill({ json: { timeline: [{ from_utc: "2026-11-27T00:40:00Z", to_utc: "2026-11-27T02:20:00Z", group: "open_shutter", kind: "exposing" }] } });
    if (pathname.endsWith("/image.jpg")) {
      images.push(decodeURIComponent(pathname.split("/").slice(4, 6).join("/")));
      return route.fulfill({ contentType: "image/svg+xml", body: '<svg xmlns="http://www.w3.org/2000/svg" width="64" height="64"><rect width="64" height="64" fill="#222"/></svg>' });
    }
    return route.fulfill({ json: { rows: [] } });
  });
  const beats = setInterval(beat, 1000);
  return {
    told, silent, images, limits, refusals, topics: () => [...sockets.values()].flatMap((subscribed) => [...subscribed]),
    tell: (...summaries) => { for (const one of summaries) told.set(one.id, one); send(message("delta", { topic: "net", data: { items: Object.fromEntries(summaries.map((one) => [one.id, one])) } })); },
    end: () => clearInterval(beats),
  };
}
