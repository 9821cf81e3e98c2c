// Pictures of webcams and all-sky cameras, which this browser fetches from their own servers while somebody looks at them.
import { html, useEffect, useLayoutEffect, useRef, useSignal } from "./lib.js";
import { useShared } from "./api.js";
import { elapsed } from "./elapsed.js";
import { Age, Card, Dialog } from "./parts.js";
import { link, quality, tick } from "./store.js";

const LIST_EVERY_S = 300;
const LOOK_MS = 500;
/** What was not got is tried again after this at the latest, s. */
const AGAIN_S = 30;

/** The address with something new in it, so that no cache answers; what it asks for already stays as it is, letter by letter. */
export function newest(url, stamp) {
  const [address] = url.split("#");
  return `${address}${address.includes("?") ? "&" : "?"}starmesh=${stamp}`;
}

function isPicture(url) {
  try {
    return ["http:", "https:"].includes(new URL(url).protocol);
  } catch {
    return false;
  }
}

/** Ends an image: a server that sends picture after picture would never end by itself. */
const drop = (image) => image?.removeAttribute("src");

/**
 * The newest picture that has come while `place` is in view: `{ picture: { element, at } | null, failed }`. The element that was loaded is the one that is
 * shown: half a picture, or none, never takes the place of a good one. `watched()` says whether it is looked at elsewhere.
 */
function usePicture(webcam, place, watched) {
  const picture = useSignal(null);
  const failed = useSignal("");
  useEffect(() => {
    const period = webcam.period_s * 1000;
    const patience = Math.max(2 * period, AGAIN_S * 1000);
    let coming = null;
    let begun = -Infinity;
    let isInView = false;
    const end = (why) => {
      if (coming) coming.onload = coming.onerror = null;
      if (why) drop(coming);
      coming = null;
      failed.value = why;
    };
    const look = () => {
      const passed = elapsed() - begun;
      if (coming && passed > patience) end("its server does not answer");
      const wait = failed.peek() ? Math.min(period, AGAIN_S * 1000) : period;
      if (coming || passed < wait - LOOK_MS / 2 || document.visibilityState !== "visible" || !(isInView || watched())) return;
      begun = elapsed();
      const image = new Image();
      coming = image;
      image.alt = webcam.name;
      image.onload = () => {
        if (!image.naturalWidth) return end("what its server gives is no picture");
        picture.value = { element: image, at: elapsed() };
        end("");
      };
      image.onerror = () => end("its server gives no picture, or cannot be reached from here");
      image.src = newest(webcam.url, Date.now());
    };
    const observer = new IntersectionObserver((entries) => { isInView = entries[entries.length - 1].isIntersecting; look(); }, { rootMargin: "100px" });
    observer.observe(place.current);
    const timer = setInterval(look, LOOK_MS);
    document.addEventListener("visibilitychange", look);
    return () => {
      observer.disconnect();
      clearInterval(timer);
      document.removeEventListener("visibilitychange", look);
      end("");
    };
  }, [webcam.url, webcam.period_s]);
  // The one before ends once it is no longer shown, and not earlier, so that there is no moment without a picture.
  const element = picture.value?.element;
  useLayoutEffect(() => () => drop(element), [element]);
  return { picture: picture.value, failed: failed.value };
}

/** An element that was made elsewhere; it stands in one place at a time. */
function Held({ element }) {
  const place = useRef(null);
  useLayoutEffect(() => { place.current.replaceChildren(element); }, [element]);
  return html`<span ref=${place}></span>`;
}

function Webcam({ webcam }) {
  tick.value; // eslint-disable-line no-unused-expressions
  const place = useRef(null);
  const large = useSignal(false);
  const { picture, failed } = usePicture(webcam, place, () => large.peek());
  const age = picture && (elapsed() - picture.at) / 1000;
  const judged = quality(age, webcam.period_s);
  const worth = judged === "fresh" && failed ? "stale" : judged;
  const name = webcam.name;
  const shown = picture && html`<${Held} element=${picture.element} />${worth !== "fresh" && html`<span class="old">${worth === "lost" ? "old" : "stale"}</span>`}`;
  const why = failed ? `${picture ? "The last try failed" : "No picture"}: ${failed}.` : picture ? "" : "Fetching …";
  const about = html`<p class="tagline">${webcam.telescope_id ?? webcam.site_id}, asked for each ${webcam.period_s} s</p>${failed && picture && html`<p class="ink-stale">${why}</p>`}`;
  return html`<section class="card webcam" aria-label=${`Webcam ${name}`} data-testid="webcam" data-webcam=${name} data-quality=${worth} data-state=${failed ? "failed" : picture ? "shown" : "none"}>
    <header><h2>${name}</h2><span class="end"><${Age} s=${age} worth=${worth} never="no picture" after=" ago" /></span></header>
    <div ref=${place}>${picture ? html`<button type="button" class="img" aria-label=${`${name}, open large`} onClick=${() => { large.value = true; }}>${!large.value && shown}</button>` : html`<div class=${`img none ${failed ? "hatch" : ""}`}>${why}</div>`}</div>${about}
    ${large.value && html`<${Dialog} label=${name} close=${() => { large.value = false; }} cls="webcam"><h2>${name}</h2><div class="img" data-quality=${worth}>${shown}</div>${about}<div class="row between"><${Age} s=${age} worth=${worth} after=" ago" /><button type="button" class="btn soft" data-first onClick=${() => { large.value = false; }}>Back</button></div><//>`}</section>`;
}

/** The webcams of some places, each `{ site, telescope }`: of a telescope those of its site too; where it is left out, of all of the site. */
export function Webcams({ of: places }) {
  const list = useShared("/api/v1/network", LIST_EVERY_S);
  const all = Array.isArray(list.data?.webcams) ? list.data.webcams : [];
  const isOf = (one) => places.some(({ site, telescope }) => one.site_id === site && (!telescope || !one.telescope_id || one.telescope_id === telescope));
  const shown = all.filter((one) => typeof one?.name === "string" && isPicture(one.url) && isOf(one)).map((one) => ({ ...one, period_s: Math.max(1, Number(one.period_s) || 60) }));
  if (list.error && !list.data && link.value === "live") return html`<p class="note p3" data-testid="webcams-unknown"><span class="grow"><b>Which webcams there are cannot be read.</b> ${list.error.message}</span><button class="btn sm soft" onClick=${list.again}>Try again</button></p>`;
  return shown.length > 0 && html`<div class="webcams" data-testid="webcams">${shown.map((webcam) => html`<${Webcam} key=${`${webcam.site_id} ${webcam.telescope_id} ${webcam.name} ${webcam.url}`} webcam=${webcam} />`)}</div>`;
}
