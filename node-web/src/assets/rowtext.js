// The text of a schedule: its rows with their places, single values changed where they stand, so that layout and comments stay, and the difference of two texts.

/** A row with more characters is given up: a brace is missing. */
const LONGEST = 20_000;
/** After so many places that are no row the rest is not looked at. */
const MOST_BROKEN = 100;
/** Keys of a row beside the parameters, in their usual order. */
const COMMON = ["device_name", "action_type", "action_value", "start_time", "end_time", "programme"];

const isObject = (value) => value !== null && typeof value === "object" && !Array.isArray(value);
const blank = (text) => text.split("\n").map((line) => (/^\s*\/\//.test(line) ? " ".repeat(line.length) : line)).join("\n");

/** What is in braces from `begin` on, in a text without comments: `{ from, to, members }`, each member by its key as `{ key, from, to, inner }`; null where it has no end. */
function braces(text, begin) {
  const token = /"(?:[^"\\\n]|\\.)*"|[{}[\]:,]/g;
  token.lastIndex = begin;
  const open = [];
  for (let found = token.exec(text); found && found.index - begin < LONGEST; found = token.exec(text)) {
    const at = found.index;
    const word = found[0];
    const top = open[open.length - 1];
    if (word === "{" || word === "[") open.push({ from: at, to: 0, members: new Map(), key: null, value: 0, inner: null });
    else if (word === ":") top.value = at + 1;
    else if (word[0] === '"') {
      if (!top.value) top.key = { name: JSON.parse(word), at };
    } else {
      if (top.key && top.value) {
        const value = text.slice(top.value, at);
        top.members.set(top.key.name, { key: top.key.at, from: top.value + value.length - value.trimStart().length, to: at - value.length + value.trimEnd().length, inner: top.inner });
      }
      Object.assign(top, { key: null, value: 0, inner: null });
      if (word === ",") continue;
      open.pop();
      top.to = at + 1;
      if (!open.length) return top;
      open[open.length - 1].inner = top;
    }
  }
  return null;
}

/** The row that begins at `from` in a text without comments, and where it ends; null where it has no end. */
function rowAt(plain, from) {
  // Most rows are a line, which the browser reads much sooner.
  const line = plain.slice(from, from + LONGEST + 1).split("\n", 1)[0].trimEnd();
  if (line.endsWith("}") && line.length <= LONGEST) {
    try {
      return { to: from + line.length, row: JSON.parse(line) };
    } catch {
      // It is more than a row, or not the whole of one.
    }
  }
  const found = braces(plain, from);
  return found && { to: found.to, row: JSON.parse(plain.slice(from, found.to)) };
}

/** The rows of a text, as they stand in it: `{ number, from, to, line, lines, row, start, end }`, numbers and lines from 1, times in ms or NaN. What is no row is passed over. */
export function rowsOf(text) {
  const plain = blank(text);
  const out = [];
  let [line, counted, failed] = [1, 0, 0];
  for (let from = plain.indexOf("{"); from >= 0 && failed < MOST_BROKEN;) {
    let to = 0;
    try {
      const found = rowAt(plain, from);
      if (found) {
        const { row } = found;
        to = found.to;
        line += plain.slice(counted, from).split("\n").length - 1;
        counted = from;
        out.push({ number: out.length + 1, from, to, line, lines: plain.slice(from, to).split("\n").length, row, start: timeOf(row.start_time), end: timeOf(row.end_time) });
      }
    } catch {
      // The next line that begins with a brace may be a row again.
    }
    failed += to ? 0 : 1;
    const next = to ? plain.slice(to).search(/\{/) : plain.slice(from + 1).search(/\n\s*\{/);
    from = next < 0 ? -1 : to ? to + next : plain.indexOf("{", from + 1 + next);
  }
  return out;
}

const WRITTEN = /^(\s*)(?:(\d{4})([-/.]?)(\d\d)\3(\d\d)|(\d\d)\.(\d\d)\.(\d{4}))([T ]+)(\d\d):(\d\d)(?::(\d\d(?:\.\d+)?))?(\s*)(Z|z|UTC|utc|GMT|UT|[+-]\d\d(?::?\d\d)?)?\s*$/;

/** A time as people write it into schedules, in its parts. Day and month that can be either way round are none. */
function written(text) {
  const [found, , year, sign, month, day, first, second, last, joint, hour, minute, seconds, gap, zone] = WRITTEN.exec(String(text)) ?? [];
  if (found === undefined || (first && Number(first) < 13 && first !== second)) return null;
  const digits = /^[+-]/.test(zone ?? "") ? zone.replaceAll(/\D/g, "").padEnd(4, "0") : "0000";
  const east = (zone?.[0] === "-" ? -1 : 1) * (Number(digits.slice(0, 2)) * 60 + Number(digits.slice(2))) * 60e3;
  const ms = Date.UTC(Number(year ?? last), Number(month ?? second) - 1, Number(day ?? first), Number(hour), Number(minute)) + Number(seconds ?? 0) * 1000 - east;
  return { ms, east, sign: sign ?? "-", joint, hasSeconds: seconds !== undefined, zone: `${gap}${zone ?? ""}` };
}

/** A time of a row, ms; NaN where it is none. */
export const timeOf = (text) => written(text)?.ms ?? NaN;

/** A time in the way in which another one is written. */
export function timeLike(like, ms) {
  const { east, sign, joint, hasSeconds, zone } = written(like) ?? { east: 0, sign: "-", joint: " ", hasSeconds: true, zone: "" };
  const utc = new Date(ms + east).toISOString();
  const time = hasSeconds || ms % 60e3 ? utc.slice(11, 23).replace(/\.000$/, "") : utc.slice(11, 16);
  return `${utc.slice(0, 10).replaceAll("-", sign)}${joint}${time}${zone}`;
}

/** The text of one row with one member changed where it stands, added behind the others, or (`undefined`) taken out. */
function withMember(raw, path, value) {
  const row = braces(blank(raw), 0);
  const place = path.length > 1 ? row.members.get(path[0]).inner : row;
  const name = path[path.length - 1];
  const member = place.members.get(name);
  const all = [...place.members.values()].sort((a, b) => a.key - b.key);
  const put = (from, to, text) => raw.slice(0, from) + text + raw.slice(to);
  if (member && value !== undefined) return put(member.from, member.to, JSON.stringify(value));
  if (member) {
    const at = all.indexOf(member);
    return at ? put(all[at - 1].to, member.to, "") : put(member.key, all[1]?.key ?? member.to, "");
  }
  if (value === undefined) return raw;
  const last = all[all.length - 1];
  const space = [...row.members.values()].some((one) => raw[one.from - 1] === ":") ? "" : " ";
  const text = `${JSON.stringify(name)}:${space}${JSON.stringify(value)}`;
  return last ? put(last.to, last.to, `,${space}${text}`) : put(place.from + 1, place.from + 1, text);
}

const same = (a, b) => JSON.stringify(a) === JSON.stringify(b);
const keysOf = (a, b) => [...new Set([...Object.keys(a), ...Object.keys(b)])];

/** A text in which a row has the values of `next`: only what differs is written anew. */
export function withRow(text, { from, to, row }, next) {
  let raw = text.slice(from, to);
  for (const key of keysOf(row, next)) {
    if (isObject(row[key]) && isObject(next[key])) {
      for (const name of keysOf(row[key], next[key])) if (!same(row[key][name], next[key][name])) raw = withMember(raw, [key, name], next[key][name]);
    } else if (!same(row[key], next[key])) raw = withMember(raw, [key], next[key]);
  }
  return text.slice(0, from) + raw + text.slice(to);
}

/** A row with other times, ms; a time that stays is not touched. */
export const moved = ({ row, start, end }, from, to) => ({ ...row, start_time: from === start ? row.start_time : timeLike(row.start_time, from), end_time: to === end ? row.end_time : timeLike(row.end_time, to) });

/** A new line for a row, with its keys in the usual order. */
export const lineOf = (row) => JSON.stringify(Object.fromEntries([...COMMON, ...Object.keys(row).filter((key) => !COMMON.includes(key))].filter((key) => row[key] !== undefined && row[key] !== "").map((key) => [key, row[key]])));

/** A text with one more row, on lines of its own before the first row that begins later; gives the text and where the row begins. */
export function withNew(text, raw, start, rows = rowsOf(text)) {
  const later = rows.findIndex((one) => one.start > start);
  const before = later < 0 ? rows[rows.length - 1] : rows[later - 1];
  const lineEnd = (at) => { const end = text.indexOf("\n", at); return end < 0 ? text.length : end; };
  const at = before ? lineEnd(before.to) : later === 0 ? rows[0].from : text.trimEnd().length;
  const lead = at && text[at - 1] !== "\n" ? "\n" : "";
  return { text: `${text.slice(0, at)}${lead}${raw}${text[at] === "\n" ? "" : "\n"}${text.slice(at)}`, at: at + lead.length };
}

/** A text without a row, and without its lines where nothing else is on them. */
export function without(text, { from, to }) {
  const start = text.lastIndexOf("\n", from - 1) + 1;
  const end = text.indexOf("\n", to) < 0 ? text.length : text.indexOf("\n", to) + 1;
  const isAlone = !text.slice(start, from).trim() && !text.slice(to, end).trim();
  return isAlone ? text.slice(0, start) + text.slice(end) : text.slice(0, from) + text.slice(to);
}

/** Where the character `column` of a line stands in a text; both count from 1, and characters are those of Unicode, as in findings. */
export function placeOf(text, line, column) {
  const lines = text.split("\n");
  const before = lines.slice(0, line - 1).reduce((sum, one) => sum + one.length + 1, 0);
  return before + [...(lines[line - 1] ?? "")].slice(0, column - 1).join("").length;
}

/** A text with the fix of a finding made: another text in the place of what it names, or nothing. */
export function fixed(text, fix) {
  const [from, to] = [placeOf(text, fix.line, fix.column), placeOf(text, fix.end_line, fix.end_column)];
  return fix.text ? text.slice(0, from) + fix.text + text.slice(to) : without(text, { from, to });
}

/** What a row is about, in a few words. */
export const nameOf = (row) => [row.action_type, row.action_value?.object].filter((word) => typeof word === "string").join(" ");

const sorted = (value) => (Array.isArray(value) ? value.map(sorted) : isObject(value) ? Object.fromEntries(Object.keys(value).sort().map((key) => [key, sorted(value[key])])) : value);

/** What tells rows apart, as the observatory node does: order and blanks are nothing, and `120.0` is another number than `120`. */
const contentOf = (raw) => JSON.stringify(sorted(JSON.parse(raw.replaceAll(/"(?:[^"\\\n]|\\.)*"|-?\d[\d.eE+-]*/g, (word) => (word[0] !== '"' && /[.eE]/.test(word) ? JSON.stringify(`~${Number(word)}`) : word)))));

function grouped(list, key) {
  const out = new Map();
  for (const one of list) out.set(one[key], [...(out.get(one[key]) ?? []), one]);
  return out;
}

/**
 * What changes where one text takes the place of another: `{ change, before, after, fields }` of rows that were added, removed or changed, in the order of the
 * new text. Rows of one camera, action and object are taken for one that was changed.
 */
export function difference(before, after) {
  const listed = (text) => { const plain = blank(text); return rowsOf(text).map((one) => ({ ...one, content: contentOf(plain.slice(one.from, one.to)), kind: JSON.stringify([one.row.device_name, one.row.action_type, one.row.action_value?.object]) })); };
  const [old, now] = [listed(before), listed(after)];
  const left = new Set(old);
  const twins = grouped(old, "content");
  const pairs = now.map((one) => { const twin = twins.get(one.content)?.shift(); left.delete(twin); return [one, twin]; });
  const kinds = grouped(left, "kind");
  const out = [];
  for (const [one, twin] of pairs) {
    const was = twin ? null : kinds.get(one.kind)?.shift();
    left.delete(was);
    if (was) out.push({ change: "changed", before: was, after: one, fields: fieldsOf(was.row, one.row) });
    else if (!twin) out.push({ change: "added", before: null, after: one, fields: [] });
  }
  for (const one of left) out.push({ change: "removed", before: one, after: null, fields: [] });
  const place = (one) => (one.after ?? now.find((other) => other.start > one.before.start))?.from ?? Infinity;
  return out.map((one) => ({ one, at: place(one) })).sort((a, b) => a.at - b.at).map(({ one }) => one);
}

function fieldsOf(before, after) {
  return keysOf(before, after).flatMap((key) => {
    if (isObject(before[key]) && isObject(after[key])) return fieldsOf(before[key], after[key]);
    return same(before[key], after[key]) ? [] : [{ field: key, before: before[key], after: after[key] }];
  });
}
