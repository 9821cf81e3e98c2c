// The numbered checks of the pages (checks/*.md): each has an answer, once, and each test that is named there exists.
import { test } from "node:test";
import assert from "node:assert/strict";
import { existsSync, readFileSync, readdirSync } from "node:fs";
import { join } from "node:path";

const root = join(import.meta.dirname, "../..");
const folder = join(import.meta.dirname, "checks");

/** Rows of all tables: the file, the number and its other cells. */
const rows = readdirSync(folder).filter((name) => name.endsWith(".md")).flatMap((name) =>
  readFileSync(join(folder, name), "utf8").split("\n").map((line) => line.split(/(?<!\\)\|/).slice(1, -1).map((cell) => cell.trim().replaceAll("\\|", "|"))).filter(([id]) => /^\W*[A-Z]{1,3}-\d/.test(id ?? ""))
    .map(([id, ...cells]) => ({ name, id: id.replace(/\W*([A-Z]+-\d+\w*)\W*$/, "$1"), cells })));

/** What a cell lists, one below the other. */
const listed = (cell) => cell.split(/<br\s*\/?>/).map((one) => one.trim().replace(/^`+\s?|\s?`+$/g, "")).filter(Boolean);

/** Has a file a test of this name? A name that is made of parts, such as an address, is found by the part that is always the same. */
function has(file, name) {
  const text = readFileSync(join(root, file), "utf8");
  if (file.endsWith(".rs")) return new RegExp(`\\bfn ${name}\\b`).test(text);
  if (file.endsWith(".py")) return new RegExp(`\\b(def|class) ${name}\\b`).test(text);
  return [JSON.stringify(name).slice(1, -1), name].some((words) => text.includes(words));
}

/** What is wrong with a row; nothing where a test proves it, or where it says why none does. */
function wrong({ cells }) {
  if (cells.length !== 3 || cells.some((cell) => !cell)) return "it has not the four columns: number, check, file, test";
  const [, where, what] = cells;
  if (/^(not applicable|not true yet)/.test(where)) return what.length > 20 ? null : "it does not say why";
  if (/^(not applicable|not true yet)/.test(what)) return what.length > 35 ? null : "it does not say why";
  const [files, names] = [listed(where), listed(what)];
  const missing = files.find((file) => !existsSync(join(root, file)));
  if (missing) return `there is no file ${missing}`;
  const unknown = names.find((name) => !files.some((file) => has(file, name)));
  if (unknown) return `no test of ${files.join(", ")} is called: ${unknown}`;
  const idle = files.find((file) => !names.some((name) => has(file, name)));
  return idle ? `no test of ${idle} is named` : null;
}

test("each numbered check of the pages names a test that exists, or says why there is none", () => {
  assert.ok(rows.length > 40, `${rows.length} rows`);
  assert.deepEqual(rows.map((row) => [row, wrong(row)]).filter(([, why]) => why).map(([{ name, id }, why]) => `${name} ${id}: ${why}`), []);
});

test("no numbered check stands twice, and none of a group is left out", () => {
  const ids = rows.map(({ id }) => id);
  assert.deepEqual(ids.filter((id, i) => ids.indexOf(id) !== i), []);
  const groups = [...new Set(ids.map((id) => id.split("-")[0]))];
  const lacking = groups.flatMap((group) => {
    const numbers = new Set(ids.filter((id) => id.startsWith(`${group}-`)).map((id) => parseInt(id.split("-")[1], 10)));
    return Array.from({ length: Math.max(...numbers) }, (_, i) => i + 1).filter((n) => !numbers.has(n)).map((n) => `${group}-${n}`);
  });
  assert.deepEqual(lacking, []);
});

test("a row that names what is not there is found", () => {
  const row = (...cells) => wrong({ cells });
  const own = "tests/ui/checks.test.js";
  assert.equal(row("a check", own, "a row that names what is not there is found"), null);
  assert.match(row("a check", own, `a row ${"that nobody"} has written`), /no test/);
  assert.match(row("a check", `${own}<br>tests/ui/none.test.js`, "a row that names what is not there is found"), /no file/);
  assert.match(row("a check", `${own}<br>tests/ui/types.test.js`, "a row that names what is not there is found"), /is named/);
  assert.match(row("a check", "", ""), /four columns/);
  assert.match(row("a check", "not true yet", "soon"), /why/);
  assert.equal(row("a check", "not applicable", "decision 0155: the archive searches, and not the page"), null);
});
