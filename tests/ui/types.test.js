// The modules of the page, checked by TypeScript's compiler: names, arguments and members that do not exist are found without a browser.
import { test } from "node:test";
import assert from "node:assert/strict";
import { execFile } from "node:child_process";
import { join } from "node:path";

test("TypeScript finds nothing wrong in the modules of the page", { timeout: 600_000 }, async () => {
  const compiler = join(import.meta.dirname, "node_modules/typescript/bin/tsc");
  const said = await new Promise((resolve) => {
    execFile(process.execPath, [compiler, "--project", join(import.meta.dirname, "tsconfig.json")], { maxBuffer: 1e8 }, (error, stdout, stderr) => resolve(error ? `${stdout}${stderr}` : ""));
  });
  // What others wrote is not ours to mend; lines that begin with a space continue one.
  let own = true;
  const ours = said.split("\n").filter((line) => (own = line.startsWith(" ") ? own : line !== "" && !line.includes("/assets/vendor/")));
  assert.deepEqual(ours, []);
});
