// Shows a tree of wanted elements by changing only what differs, so that focus, selection and scroll stay.

/** What `h` made; no other object becomes an element, whatever fields a payload has. */
class Wanted {
  constructor(tag, attrs, children) {
    Object.assign(this, { tag, attrs, children });
  }
}

/** A wanted element. `key` keeps its identity among its siblings; `on*` are listeners; `null` attributes are left out. */
export function h(tag, attrs, ...children) {
  return new Wanted(tag, attrs ?? {}, children);
}

/** What a part of the page shows, or, where it cannot be drawn, a red box that says so; other parts are not concerned. */
export function guarded(name, draw) {
  try {
    return draw();
  } catch (error) {
    console.warn(`${name} cannot be drawn`, error);
    return h("section", { key: `broken-${name}`, class: "panel broken", role: "alert", "data-broken": name },
      h("p", {}, h("strong", {}, `▲ ${name}: this part cannot be shown. `), "What it showed before is not relied on here. ", String(error?.message ?? error).slice(0, 200)));
  }
}

/** Makes the children of `parent` be `wanted` (elements, texts, nothing, or lists of these). */
export function show(parent, ...wanted) {
  const kept = new Map();
  for (const node of parent.childNodes) if (node.ownKey !== undefined) kept.set(node.ownKey, node);
  let at = parent.firstChild;
  for (const want of wanted.flat(Infinity)) {
    if (want === null || want === undefined || want === false || want === "") continue;
    const node = want instanceof Wanted ? element(want, at, kept) : text(typeof want === "object" ? JSON.stringify(want) : String(want), at);
    if (node === at) at = at.nextSibling;
    else parent.insertBefore(node, at);
  }
  while (at) {
    const next = at.nextSibling;
    at.remove();
    at = next;
  }
}

function text(words, at) {
  const node = at?.nodeType === Node.TEXT_NODE ? at : document.createTextNode("");
  if (node.data !== words) node.data = words;
  return node;
}

function element({ tag, attrs, children }, at, kept) {
  const key = attrs.key;
  const old = key === undefined ? at : kept.get(key);
  const same = old?.nodeType === Node.ELEMENT_NODE && old.localName === tag && old.ownKey === key;
  const node = same ? old : document.createElement(tag);
  if (!same) {
    node.ownKey = key;
    node.ownAttrs = {};
  }
  dress(node, attrs);
  show(node, ...children);
  return node;
}

function dress(node, attrs) {
  const before = node.ownAttrs ?? {};
  for (const name in before) if (attrs[name] === undefined || attrs[name] === null) set(node, name, null);
  for (const name in attrs) if (name !== "key" && attrs[name] !== before[name]) set(node, name, attrs[name]);
  node.ownAttrs = attrs;
}

function set(node, name, value) {
  if (name.startsWith("on")) node[name] = value;
  else if (value === null || value === undefined || value === false) node.removeAttribute(name);
  else if (node.getAttribute(name) !== String(value)) node.setAttribute(name, value === true ? "" : value);
}
