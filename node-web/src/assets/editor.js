// The editor of a draft: its rows over the night, its text with findings while it is written, forms and templates of rows, the dry run, and activation.
import { html, useEffect, useMemo, useRef, useSignal } from "./lib.js";
import { ask, useGet } from "./api.js";
import { Changes } from "./changes.js";
import { note } from "./close.js";
import { base } from "./draft.js";
import { DraftLine, shifted } from "./draftline.js";
import { clock, duration, nightOf, number } from "./format.js";
import { Card, Dialog, Empty, Guard, Kept, Shape, Table } from "./parts.js";
import { RowForm } from "./row.js";
import { difference, fixed, lineOf, moved, nameOf, placeOf, rowsOf, withNew, withRow, without } from "./rowtext.js";
import { tonight } from "./site.js";
import { moment, net, useTopic } from "./store.js";
import { templateOf } from "./templates.js";

/** Findings come when nothing was written for so long, ms. */
const QUIET_MS = 500;
/** A browser that is busy does at last what waits for an idle moment, ms. */
const BUSY_MS = 200;

/** Does work in an idle moment. Safari tells nobody of one. */
const whenIdle = (work) => ("requestIdleCallback" in window ? requestIdleCallback(work, { timeout: BUSY_MS }) : setTimeout(work, BUSY_MS));

/** What makes the fix of a finding, if it has one; `onFix` is absent while the text is another one than that with the findings. */
const Fix = ({ finding: { fix, line }, onFix }) => {
  if (!fix) return null;
  const word = fix.text ? `Use ${fix.text}` : "Remove";
  return html`<button class="btn sm soft fix" data-testid="fix" title=${word} disabled=${!onFix} onClick=${() => onFix(fix)}><span class="cut">${word}</span><span class="vh"> in line ${line}</span></button>`;
};

/** Findings stand with their line; a touch goes there. */
const Findings = ({ findings, onGo, onFix }) => (findings.length ? html`<ul class="findings" data-testid="findings">${findings.map((finding, i) => html`<li key=${i} class=${`note ${finding.severity === "error" ? "p2" : "p3"}`}><button class="btn sm quiet" onClick=${() => onGo(finding)}>line ${finding.line ?? "—"}</button><span class="grow"><b>${finding.field ?? finding.check}</b> ${finding.what}${finding.right ? `; ${finding.right}` : ""}</span><${Fix} finding=${finding} onFix=${onFix} /></li>`)}</ul>` : html`<p class="m">No findings.</p>`);

/** Saves a text as a file of this computer. */
function save(text, name) {
  const link = Object.assign(document.createElement("a"), { href: URL.createObjectURL(new Blob([text], { type: "application/jsonl" })), download: name });
  link.click();
  setTimeout(() => URL.revokeObjectURL(link.href), 1000);
}

/** The text with the numbers of its lines; `marked` are lines with findings, `chosen` is the row that is chosen. */
function Text({ draft, area, caret, marked, chosen }) {
  const text = draft.text.value;
  const lines = text.split("\n");
  const moveCaret = (event) => { caret.value = event.target.selectionStart; };
  // What a bar has chosen is where a person goes on by the keyboard; a click says its own place after this.
  const enter = ({ target }) => { if (target.selectionStart === target.selectionEnd) target.setSelectionRange(caret.peek(), caret.peek()); };
  const write = (event) => { draft.edit(event.target.value, "typing", `typing in line ${event.target.value.slice(0, event.target.selectionStart).split("\n").length}`); moveCaret(event); };
  const numbered = (line, i) => {
    const cls = chosen && i + 1 >= chosen.line && i + 1 < chosen.line + chosen.lines ? "sel" : "";
    const mark = marked.get(i + 1) ?? "";
    return html`<${Kept} key=${i} parts=${[line, cls, mark]} draw=${() => html`<div class=${cls}><span class=${`n ${mark}`}>${i + 1}</span><span class="c">${line || " "}</span></div>`} />`;
  };
  // The lines stand a second time behind the text, unseen: their numbers and colours are as high as what is wrapped.
  return html`<div class="editor"><div class="code" aria-hidden="true">${lines.map(numbered)}</div><textarea ref=${area} aria-label="Schedule, rows of JSON" spellcheck="false" autocapitalize="off" value=${text} onInput=${write} onKeyUp=${moveCaret} onClick=${moveCaret} onFocus=${enter}></textarea></div>`;
}

/** The row that is chosen, and what can be done with it. */
function Chosen({ row, onChange, onDuplicate, onRemove, onAdd }) {
  const value = row?.row.action_value;
  return html`<${Card} name=${row ? nameOf(row.row) || "Row" : "No row chosen"} label="The row that is chosen" testid="chosen" end=${row && html`line ${row.line} <button class="btn quiet sm" data-testid="duplicate-row" onClick=${onDuplicate}>Duplicate</button><button class="btn quiet sm" data-testid="remove-row" onClick=${onRemove}>Remove</button>`}>
    ${row ? html`<dl class="kv"><dt>Camera</dt><dd>${String(row.row.device_name ?? "—")}</dd><dt>Window</dt><dd>${row.row.start_time ? `${row.row.start_time} to ${row.row.end_time}` : "—"}</dd>${value && typeof value === "object" && Object.entries(value).map(([name, one]) => html`<dt key=${name}>${name}</dt><dd>${typeof one === "string" ? one : JSON.stringify(one)}</dd>`)}</dl>` : html`<p class="m">Touch a bar, or put the cursor into a row of the text.</p>`}
    <div class="row wrap acts-row"><button class="btn soft" data-testid="add-row" onClick=${onAdd}>Add a row …</button>${row && html`<button class="btn soft" data-testid="change-row" onClick=${onChange}>Change …</button>`}</div><//>`;
}

/** The form of a row, or of a new one, with the cameras and filters of this telescope. */
function Form({ id, rows, row, site, onDone, close }) {
  const states = useTopic(`tel/${id}/device`);
  const devices = [...(states ?? [])].filter(([key]) => key.endsWith("/capabilities"));
  const cameras = [...new Set([...devices.map(([key]) => /\/device\/camera\/([^/]+)\//.exec(key)?.[1]), ...rows.map((one) => one.row.device_name)])].filter((name) => typeof name === "string");
  const filters = [...new Set(devices.filter(([key]) => key.includes("/device/filterwheel/")).flatMap(([, entry]) => entry.body?.can?.names ?? []))].filter((name) => typeof name === "string");
  const template = (action, list) => templateOf(action, { list, rows, cameras, filters, site, now: moment.value ?? Date.now() });
  return html`<${RowForm} id=${id} row=${row} template=${template} cameras=${cameras} filters=${filters} onDone=${onDone} close=${close} />`;
}

/** The size of a forecast's files in words: not known while the archive has no frame of one of the cameras. */
function sizeOf({ rows, night, cameras = [] }) {
  const unknown = new Set(cameras.filter((one) => !one.measured).map((one) => one.camera));
  return rows.some((row) => row.frames > 0 && unknown.has(row.camera)) ? "size not known yet" : `${number(night.gigabytes, 1)} GB`;
}

/** `draft` as `draftOf` makes it; `version` (where it is known) and `sha256` are of the schedule in force, `running` the starts of its rows that run; `close` leaves the editor. */
export function Editor({ id, draft, version, sha256, running, site, close }) {
  const { text, inForce, stored, theirs, past, future } = draft;
  const checked = useSignal(null);
  const dry = useSignal(null);
  const problem = useSignal(null);
  /** While the draft is about to be activated: the ETag of the schedule that it was shown to replace. */
  const activating = useSignal(null);
  /** The form that is open: of a row, or of a new one. */
  const form = useSignal(null);
  const caret = useSignal(0);
  /** How the draft differs from what is in force; null before it was compared here. */
  const compared = useSignal(null);
  const isAwaited = useRef(false);
  const area = useRef(null);
  const file = useRef(null);
  const orders = useGet(`/api/v1/telescopes/${id}/commands/catalog`, 60).data;
  const press = (work) => async (...given) => {
    problem.value = null;
    try {
      await work(...given);
    } catch (error) {
      problem.value = error;
    }
  };
  useEffect(() => { press(draft.begin)(); }, [draft]);
  // The browser's own steps would know nothing of what a bar or a form has changed.
  useEffect(() => {
    const back = (event) => {
      const step = event.type === "beforeinput" ? { historyUndo: draft.undo, historyRedo: draft.redo }[event.inputType] : (event.ctrlKey || event.metaKey) && { z: event.shiftKey ? draft.redo : draft.undo, y: draft.redo }[event.key?.toLowerCase()];
      if (!step || event.target.closest("input, select, dialog")) return;
      event.preventDefault();
      step();
    };
    for (const name of ["keydown", "beforeinput"]) document.addEventListener(name, back);
    return () => { for (const name of ["keydown", "beforeinput"]) document.removeEventListener(name, back); };
  }, [draft]);
  // Another one in force changes what this one would do.
  useEffect(() => { if (inForce.peek() && sha256 && sha256 !== inForce.peek().etag) press(draft.readInForce)(); }, [sha256]);
  // Findings come while it is written, and never hold up the writing.
  useEffect(() => {
    if (text.value === null) return undefined;
    const timer = setTimeout(async () => {
      const asked = text.peek();
      const found = await ask(`${base(id)}/validate`, { method: "POST", headers: { "Content-Type": "application/jsonl" }, body: asked }).catch((error) => ({ error }));
      if (asked === text.peek()) checked.value = { ...found, text: asked };
    }, QUIET_MS);
    return () => clearTimeout(timer);
  }, [text.value]);
  // To compare takes longer than to draw a letter, and waits until that is done.
  useEffect(() => {
    if (text.value === null || isAwaited.current) return;
    isAwaited.current = true;
    whenIdle(() => { isAwaited.current = false; compared.value = draft.changes.peek(); });
  }, [text.value, inForce.value]);
  const inForceRows = useMemo(() => rowsOf(inForce.value?.text ?? ""), [inForce.value]);
  if (text.value === null) return problem.value ? html`<${Empty} icon="warn" title="The schedule cannot be read" hatch>${problem.value.message} <button class="btn sm soft" onClick=${press(draft.read)}>Try again</button><//>` : html`<p class="m">Reading the schedule …</p>`;

  const rows = draft.rows.value;
  const line = text.value.slice(0, caret.value).split("\n").length;
  const chosen = rows.find((one) => line >= one.line && line < one.line + one.lines) ?? null;
  const choose = (at, focus = false) => {
    caret.value = at;
    const shown = area.current.parentElement;
    shown.scrollTop = shown.firstElementChild.children[text.peek().slice(0, at).split("\n").length - 1]?.offsetTop - shown.clientHeight / 3;
    if (!focus) return;
    area.current.focus({ preventScroll: true });
    area.current.setSelectionRange(at, at + 1);
    shown.scrollIntoView({ block: "nearest" });
  };
  const change = (row, next, what, kind = null) => draft.edit(withRow(text.peek(), row, next), what, kind);
  // Presses of a key at one place are one step.
  const move = (row, [from, to], part, isKey) => change(row, moved(row, from, to), part === "both" ? `moving ${nameOf(row.row)}` : `${part} of ${nameOf(row.row)}`, isKey ? `${part} of row ${row.number}` : null);
  const put = (raw, start, what) => {
    const made = withNew(text.peek(), raw, start);
    draft.edit(made.text, what);
    choose(made.at);
  };
  const take = (next) => {
    const { row } = form.peek();
    if (row) change(row, next, `changing ${nameOf(row.row)}`);
    else put(lineOf(next), rowsOf(lineOf(next))[0]?.start, `adding ${nameOf(next)}`);
    form.value = null;
  };
  const duplicate = () => {
    const [from, to] = shifted(chosen, "both", chosen.end - chosen.start);
    const isPlaced = Number.isFinite(from + to);
    const raw = text.peek().slice(chosen.from, chosen.to);
    put(isPlaced ? withRow(raw, rowsOf(raw)[0], moved(chosen, from, to)) : raw, isPlaced ? from : Infinity, `duplicating ${nameOf(chosen.row)}`);
  };
  const simulate = async () => { const asked = text.peek(); dry.value = { text: asked, ...await ask(`${base(id)}/simulate`, { method: "POST", headers: { "Content-Type": "application/jsonl" }, body: asked }) }; };
  const goTo = ({ line = 1, column = 1 }) => choose(placeOf(text.peek(), line, column), true);
  const mend = (fix) => {
    draft.edit(fixed(text.peek(), fix), `fixing line ${fix.line}`);
    choose(placeOf(text.peek(), fix.line, fix.column));
  };
  const activate = async (event) => {
    event.preventDefault();
    const why = String(new FormData(event.target).get("reason"));
    const instead = activating.peek();
    activating.value = null;
    const say = note(`${id}: the schedule is being activated …`, true);
    // An order whose answer was lost may have been followed.
    const told = (error) => ([0, 504].includes(error.status) ? `not known whether it was activated (look at the schedules that were in force): ${error.message}` : `not activated: ${error.message}`);
    const command = await draft.activate(why, instead).catch((error) => { say(`${id}: ${told(error)}`); throw error; });
    say(`${id}: the schedule is ${command.state}${command.detail ? `: ${command.detail}` : ""}`);
    if (command.state !== "failed") close();
  };
  const { findings = [], errors = 0, warnings = 0 } = checked.value ?? {};
  const isNewest = checked.value?.text === text.value;
  // Of each line its worst finding.
  const marked = new Map([...findings].sort((a, b) => (a.severity > b.severity ? -1 : 1)).map((finding) => [finding.line, finding.severity]));
  const changes = compared.value ?? draft.changes.peek();
  const ends = changes.filter(({ before }) => before && running.split(" ").some((utc) => Math.abs(Date.parse(utc) - before.start) < 1));
  const order = Array.isArray(orders) ? orders.find((one) => one?.command === "put-schedule") : null;
  const waits = errors > 0 ? `Activate and the dry run wait for ${errors === 1 ? "the error" : `${errors} errors`} below.` : theirs.value ? "Activate waits until it is decided whose draft it is." : order?.may === false ? `You may not activate: it needs the right ${order.right}.` : null;
  const isOld = inForce.value.etag !== draft.basedOn.value;
  const step = (list, word, go) => { const told = list.length ? `${word}: ${list[list.length - 1].what}` : word; return html`<button class="btn quiet" data-testid=${word.toLowerCase()} disabled=${!list.length} title=${told} aria-label=${told} onClick=${go}>${word}</button>`; };
  const plan = dry.value?.text === text.value ? dry.value : null;
  return html`<${Card} label="Draft" cls="draft">
      <div class="row wrap"><div class="row wrap facts grow"><span>In force <b data-testid="in-force">${version == null ? "one that is not in the list yet" : `version ${version}`}</b></span><span>Draft <b data-testid="stored">${draft.isStored.value ? (stored.value ? `stored by ${stored.value.author}, ${clock(stored.value.changed_utc)}` : "as in force") : "not stored yet"}</b>, ${changes.length} ${changes.length === 1 ? "row differs" : "rows differ"}</span>
        <span data-testid="check">${checked.value?.error ? "not checked" : html`<span class=${errors ? "ink-p2" : ""}>${errors > 0 && html`<${Shape} n=${2} /> `}<b>${errors}</b> ${errors === 1 ? "error" : "errors"}</span>, <span class=${warnings ? "ink-p3" : ""}>${warnings > 0 && html`<${Shape} n=${3} /> `}<b>${warnings}</b> ${warnings === 1 ? "warning" : "warnings"}</span>, ${checked.value?.rows ?? "?"} rows`}</span></div>
        <div class="row wrap">${step(past.value, "Undo", draft.undo)}${step(future.value, "Redo", draft.redo)}<button class="btn soft" disabled=${draft.isStored.value || theirs.value !== null} onClick=${press(draft.store)}>Store</button><button class="btn soft" disabled=${errors > 0} onClick=${press(simulate)}>Dry run</button><button class="btn main" disabled=${waits !== null} onClick=${() => { activating.value = inForce.peek().etag; }}>Activate …</button></div></div>
      ${waits && html`<p class="why">${waits}</p>`}
      ${theirs.value && html`<div class="note p2" role="alert" data-testid="conflict"><span class="grow"><b>${theirs.value.author} stored another draft at ${clock(theirs.value.changed_utc)}.</b> Nothing is lost: below is how theirs differs from yours, and Undo leads to the one that you do not take.</span><span class="row"><button class="btn soft" onClick=${() => draft.takeTheirs()}>Take theirs</button><button class="btn soft" onClick=${press(draft.keepMine)}>Keep mine</button></span></div><${Changes} label="Their draft compared with yours" changes=${difference(text.value, theirs.value.text)} />`}
      ${isOld && html`<div class="note p3" data-testid="other-in-force"><span class="grow"><b>Another schedule was put in force since this draft began.</b> The difference below is to that one.</span><button class="btn soft" onClick=${draft.seen}>I have seen it</button></div>`}
      ${problem.value && html`<div class="note p2" role="alert"><span class="grow">${problem.value.message}</span></div>`}<//>
    <${Card} name="The draft over the night" end=${html`<span class="key">draft</span><span class="key dash">in force</span>`} cls="tl"><${DraftLine} rows=${rows} marked=${marked} inForce=${inForceRows} plan=${plan?.rows} site=${site} now=${moment.value ?? Date.now()} chosen=${chosen} onChoose=${(row) => choose(row.from)} onOpen=${(row) => { form.value = { row }; }} onMove=${move} /><//>
    <div class="grid draft-parts"><${Card} name="Text" end=${html`<input ref=${file} type="file" class="vh" tabindex="-1" aria-label="A file with a schedule" accept=".jsonl,.json,.txt" onChange=${press(async (event) => { const [one] = event.target.files; event.target.value = ""; if (one) await draft.upload(one); })} /><button class="btn quiet sm" onClick=${() => file.current.click()}>Upload …</button><button class="btn quiet sm" onClick=${() => save(text.peek(), `${id.replaceAll("/", "-")}-${tonight(net.peek().get(id)) ?? nightOf(Date.now())}.jsonl`)}>Download</button><button class="btn quiet sm" onClick=${press(draft.startOver)}>Start over</button>`}><${Text} draft=${draft} area=${area} caret=${caret} chosen=${chosen} marked=${marked} /><//>
      <div class="grid"><${Chosen} row=${chosen} onAdd=${() => { form.value = { row: null }; }} onChange=${() => { form.value = { row: chosen }; }} onDuplicate=${duplicate} onRemove=${() => draft.edit(without(text.peek(), chosen), `removing ${nameOf(chosen.row)}`)} />
        <${Card} name="Findings">${checked.value?.error ? html`<div class="note p2" role="alert"><span class="grow">${checked.value.error.message}</span></div>` : html`<${Kept} parts=${[checked.value, isNewest]} draw=${() => html`<${Findings} findings=${findings} onGo=${goTo} onFix=${isNewest ? mend : null} />`} />`}<//>
        <${Card} name="Compared with what is in force" flush end=${`${changes.length} ${changes.length === 1 ? "row" : "rows"}`}><${Kept} parts=${[changes]} draw=${() => html`<${Changes} label="The draft compared with the schedule in force" changes=${changes} />`} /><//></div></div>
    ${dry.value && html`<${Card} name="Dry run" flush testid="dry-run" end=${plan ? plan.night && `${plan.night.frames} frames, ${sizeOf(plan)}, ${duration(plan.night.dark_exposed_s)} of ${duration(plan.night.dark_s)} dark time exposed` : "before the last change"}>
      <${Table} label="Dry run" cls="cards" columns=${[{ key: "r", name: "Row" }, { key: "b", name: "Runs" }, { key: "f", name: "Frames", num: true }, { key: "n", name: "Outcome" }]} rows=${dry.value.rows} keyOf=${(row) => row.row} cells=${(row) => html`<td class="k">${row.row + 1} ${[row.action, row.object].filter(Boolean).join(" ")}</td><td>${row.start_utc ? `${clock(row.start_utc)} to ${row.end_utc ? clock(row.end_utc) : "—"}` : "will not run"}</td><td class="num">${row.frames_wanted ? `${row.frames} of ${row.frames_wanted}` : row.frames || ""}</td><td class="m">${row.note ?? (row.whole === false ? "not whole" : "")}</td>`} /><//>`}
    <${Guard} name="The form">${form.value && html`<${Form} id=${id} rows=${rows} row=${form.value.row?.row ?? null} site=${site} onDone=${take} close=${() => { form.value = null; }} />`}<//>
    ${activating.value !== null && html`<${Dialog} label="Activate the draft" close=${() => { activating.value = null; }}><h2>Put this schedule in force?</h2><p class="m">${rows.length} rows take the place of those in force; ${changes.length} differ. ${ends.length ? html`<b>${ends.map(({ before }) => nameOf(before.row)).join(", ")} runs and is not in it unchanged:</b> its frame is finished, then it ends.` : "A row that runs goes on."}</p><form class="stack" onSubmit=${press(activate)}><div class="field"><label for="why">Why</label><div class="in"><input id="why" name="reason" data-first maxlength="500" required defaultValue=${draft.reason()} /></div></div><div class="acts"><button type="button" class="btn soft" onClick=${() => { activating.value = null; }}>Cancel</button><button class="btn main">Activate</button></div></form><//>`}`;
}
