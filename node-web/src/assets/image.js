// The newest image of a telescope: the old one stays until the new one can be shown.
import { html, signal } from "./lib.js";
import { link, net } from "./store.js";

const pictures = new Map();

/** The newest image that has arrived here, with `src` and `since`; null before the first. */
export function arrived(summary) {
  const wanted = summary.image;
  const have = pictures.get(summary.id) ?? { shown: signal(null), asked: null };
  pictures.set(summary.id, have);
  // Without a link it is asked once: the browser may have kept it.
  const asked = wanted && `${wanted.frame}${link.peek() === "live" ? "" : ", kept"}`;
  if (wanted && have.asked !== asked && (link.peek() === "live" || (link.peek() === "lost" && !have.shown.peek()))) {
    have.asked = asked;
    const src = `/api/v1/telescopes/${summary.id}/image.jpg?frame=${encodeURIComponent(wanted.frame)}`;
    const since = summary.received - summary.image_age_s * 1000;
    const image = new Image();
    image.onload = () => {
      // An older one may arrive after a newer one.
      if (have.asked === asked) have.shown.value = { ...wanted, src, since };
    };
    image.onerror = () => { if (have.asked === asked && link.peek() === "live") have.asked = null; };
    image.src = src;
  }
  // Pictures of telescopes that are gone are not kept.
  if (pictures.size > 2 * net.peek().size + 10) for (const id of pictures.keys()) if (!net.peek().has(id)) pictures.delete(id);
  return have.shown.value && { ...have.shown.value, problem: wanted?.problem };
}

/** What is on it, for those who do not see it. */
export const caption = (image) => [image.image_type, image.object, image.filter ?? "no filter", `${image.exposure_s} s`].filter(Boolean).join(", ");

/** The image itself. */
export const Picture = ({ image }) => html`<img data-frame=${image.frame} alt=${caption(image)} width=${image.size_px?.[0]} height=${image.size_px?.[1]} src=${image.src} />`;
