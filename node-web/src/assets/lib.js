// The page's libraries under one name: elements by templates, state by signals.
import { h } from "./vendor/preact.js";
import htm from "./vendor/htm.js";

export { Component, Fragment, h, render } from "./vendor/preact.js";
export { useEffect, useLayoutEffect, useMemo, useRef, useState } from "./vendor/hooks.js";
export { batch, computed, effect, signal, untracked, useComputed, useSignal } from "./vendor/signals.js";

/** `html\`<p>${text}</p>\``: text from outside becomes a text node, never markup. */
export const html = htm.bind(h);
