"use strict";
/* The page of a run. Text of a run, a rig file or a person enters the document through `el` alone, as text. */

const COLORS = Array.from({ length: 10 }, (_, k) => `--curve${k}`); /* variables of panel.css, light or dark */
const MOST_CURVES = 8; /* of one plot: fewer than there are colours */
const MOST_NAMED = 3; /* names in a title: the legend has them all */
const STALE_MS = 4000, RETRY_MS = 5000;
const SPANS = [["10 min", 600], ["1 h", 3600], ["All", Infinity]];
const VERBS = {
  hold: ["Hold", "The outputs stay as they are, the profile's clock stops.", ["running", "restoring"]],
  pause: ["Pause", "The outputs go to their safe values, the profile's clock stops.", ["running", "held", "suspended", "restoring"]],
  resume: ["Resume", "The run goes on with its profile.", ["held", "paused"]],
  ack: ["Acknowledge trip", "The trip is released if its cause has gone. Resume then goes on.", ["paused"]],
  abort: ["Abort", "The run ends, and the outputs go to their safe values.", null],
};

/* The one place where text becomes part of the document: as a text node, never as markup. */
function el(tag, attributes, ...content) {
  const made = document.createElement(tag);
  for (const [name, value] of Object.entries(attributes || {})) {
    if (name === "onclick") made.addEventListener("click", value);
    else if (name === "disabled" || name === "selected") made[name] = value;
    else made.setAttribute(name, value);
  }
  for (const part of content) made.append(part instanceof Node ? part : document.createTextNode(String(part)));
  return made;
}
const byId = (id) => document.getElementById(id);
function put(id, ...content) { byId(id).replaceChildren(...content); }

let run = null, shown = null, source = null, heardAt = 0, gone = false;
let courses = null, plots = [], span = Infinity, cursor = null;
let past = null, heardTimes = [];

async function getJson(path) {
  const answer = await fetch(path, { cache: "no-store" });
  const body = await answer.json();
  if (!answer.ok) throw new Error(body.text || `the panel answered ${answer.status}`);
  return body;
}

async function post(path, body) {
  const answer = await fetch(path, { method: "POST", headers: { "Content-Type": "application/json" }, body: JSON.stringify(body) });
  const said = await answer.json();
  if (!answer.ok) throw new Error(said.text || `the panel answered ${answer.status}`);
  return said.text;
}
const api = (rest) => `/api/runs/${encodeURIComponent(run)}/${rest}`;

/* ---- state ---- */

function format(value) {
  if (value === null || value === undefined) return "–";
  const size = Math.abs(value);
  const text = size >= 1000 ? value.toFixed(0) : size >= 100 ? value.toFixed(1) : value.toFixed(2);
  return Number(text) === 0 ? text.replace("-", "") : text;
}

function showHead(now) {
  const ended = !now.live;
  const name = now.status === "interrupted" ? "interrupted" : now.state;
  const badge = byId("state");
  badge.textContent = ended && now.status !== "running" ? now.status || now.state : name;
  badge.className = `badge ${name}`;
  if (now.live && now.tripped) { badge.textContent += ", tripped"; badge.className = "badge faulted"; }
  const safe = ended && now.safe === false ? " Not confirmed safe." : "";
  byId("reason").textContent = now.reason + safe;
  document.title = `${badge.textContent} · ${now.run}`;
  const share = now.duration_s ? Math.min(1, now.profile_s / now.duration_s) : 0;
  byId("bar").style.width = `${(100 * share).toFixed(2)}%`;
  byId("clock").textContent = `${clock(now.profile_s)} of ${clock(now.duration_s)} of ${now.profile} · ${clock(now.time_s)} since the start`;
  const buttons = Object.entries(VERBS)
    .filter(([verb]) => verb !== "ack" || (now.live && now.tripped))
    .map(([verb, [label, , states]]) =>
      el("button", {
        type: "button", class: verb === "abort" ? "stop" : "", disabled: !now.live || (states !== null && !states.includes(now.state)) || (verb === "resume" && now.tripped),
        onclick: () => askVerb(verb), "data-verb": verb,
      }, label));
  const key = JSON.stringify([now.live, now.state, now.tripped]);
  if (byId("verbs").dataset.key !== key) { byId("verbs").dataset.key = key; put("verbs", ...buttons); }
}

function showLink() {
  const quiet = Date.now() - heardAt;
  const lost = gone || quiet > STALE_MS;
  const link = byId("link");
  link.className = lost ? "link lost" : "link";
  const late = shown && shown.live && shown.age_s !== null && shown.age_s > Math.max(3, 3 * shown.period_s);
  link.textContent = gone ? "" : lost ? `connection lost for ${Math.round(quiet / 1000)} s` : late ? `last row ${Math.round(shown.age_s)} s ago` : shown && shown.live ? "live" : shown && shown.status === "interrupted" ? "interrupted" : "ended";
  if (late && !lost) link.className = "link lost";
  document.body.classList.toggle("stale", lost);
}

/* ---- alarms ---- */

function showAlarms(list) {
  if (!list.known) { put("alarms", el("p", { class: "note" }, list.text)); return; }
  if (!list.alarms.length) { put("alarms", el("p", { class: "none" }, "No alarm stands.")); return; }
  const rows = list.alarms.map((alarm) => {
    const isShelved = alarm.state.startsWith("shelved");
    const waits = ["unacknowledged", "returned unacknowledged", "latched"].includes(alarm.state);
    const detail = [alarm.state];
    if (alarm.since) detail.push(`since ${alarm.since.replace("T", " ").replace("Z", " UTC")}`);
    if (isShelved && alarm.shelved_until) detail.push(`until ${alarm.shelved_until.replace("T", " ").replace("Z", " UTC")}`);
    if (alarm.by && !waits) detail.push(alarm.reason ? `${alarm.by}: ${alarm.reason}` : `by ${alarm.by}`);
    const acts = el("div", { class: "acts" });
    if (waits) acts.append(el("button", { type: "button", class: "small", onclick: () => askAlarm("acknowledge", alarm) }, "Acknowledge"));
    if (["unacknowledged", "acknowledged"].includes(alarm.state)) acts.append(el("button", { type: "button", class: "small", onclick: () => askAlarm("shelve", alarm) }, "Shelve"));
    if (isShelved) acts.append(el("button", { type: "button", class: "small", onclick: () => askAlarm("unshelve", alarm) }, "End shelving"));
    return el("div", { class: `alarm ${alarm.priority}${waits ? "" : " quiet"}`, "data-alarm": alarm.id },
      el("span", { class: "rank" }, alarm.priority),
      el("div", { class: "what" }, el("b", {}, alarm.id), alarm.shown ? ` ${alarm.shown}` : "", ` · ${alarm.what}`, el("div", { class: "detail" }, detail.join(" · "))),
      acts);
  });
  put("alarms", ...rows);
}

/* ---- values ---- */

function showValues(values, twins) {
  const rows = [el("tr", {}, el("th", {}, "signal"), el("th", {}, "value"), el("th", {}), el("th", {}, "age / s"))];
  for (const [title, kind] of [["Set-points", "setpoint"], ["Measured", "measured"]]) {
    const group = values.filter((value) => value.kind === kind);
    if (!group.length) continue;
    rows.push(el("tr", { class: "group" }, el("td", { colspan: "4" }, title)));
    for (const value of group) {
      const good = value.quality === "good";
      rows.push(el("tr", value.doc ? { title: value.doc } : {},
        el("td", {}, value.name),
        el("td", good ? {} : { class: "bad" }, good ? format(value.value) : value.quality),
        el("td", { class: "unit" }, good ? value.unit : ""),
        el("td", {}, value.age_s === null ? "–" : value.age_s.toFixed(1))));
    }
  }
  put("values", el("table", {}, ...rows));
}

function showDiagnosis(now) {
  const links = [["report.html", "Report", now.files.report], ["diagnosis.html", "Diagnosis", now.files.diagnosis], ["review.rrd", "Rerun file", now.files.review]]
    .filter(([, , there]) => there)
    .map(([file, label]) => el("a", { href: `/runs/${encodeURIComponent(run)}/${file}`, target: "_blank", rel: "noopener" }, label));
  const said = now.diagnosis || (now.live ? "No diagnosis yet: it is made while the run goes on with --diagnose, or afterwards by `hil diagnose`." : "No diagnosis: `hil diagnose` makes one.");
  const parts = now.tests.map((test) => el("div", { class: `verdict ${test.verdict}` },
    el("b", {}, { pass: "PASSED", fail: "FAILED" }[test.verdict] || "INCONCLUSIVE"), ` ${test.title}: ${test.text}`,
    ...test.limits.map((limit) => el("div", { class: "detail" }, limit))));
  parts.push(el("p", { class: now.diagnosis ? "" : "note" }, said));
  if (links.length) parts.push(el("div", { class: "files" }, ...links));
  if (now.files.review) parts.push(el("p", { class: "note" }, "The Rerun file opens with `hil review RUN`, or in Rerun's web viewer."));
  put("diagnosis", ...parts);
}

function showLog(now) {
  const notes = now.notes.map((note) => [note.time, el("li", {}, el("time", {}, note.time.replace("T", " ").slice(0, 19)), el("b", {}, note.by ? `${note.by}: ` : ""), note.text)]).reverse();
  const events = now.events.map((event) => el("li", { class: ["WARN", "ERROR"].includes(event.level) ? event.level : "" }, el("time", {}, clock(event.time_s)), event.text)).reverse();
  put("log", el("ul", {}, ...notes.map(([, item]) => item), ...events));
}

/* ---- trends ---- */

function titleOf(names) {
  return names.length <= MOST_NAMED ? names.join(", ") : `${names[0]} and ${names.length - 1} more`;
}

function makePlots(document_) {
  plots = [];
  const cards = [];
  const add = (title, unit, curves) => {
    const canvas = el("canvas", { "aria-label": `${title} over time` });
    const legend = el("div", { class: "legend" });
    cards.push(el("div", { class: "card" }, el("h3", {}, unit ? `${title} / ${unit}` : title), canvas, legend));
    plots.push({ canvas, legend, curves });
    canvas.addEventListener("pointermove", (event) => {
      if (!canvas.axis) return;
      const { left, right, t0, t1 } = canvas.axis;
      const at = (event.offsetX - left) / (right - left);
      cursor = at < 0 || at > 1 ? null : t0 + at * (t1 - t0);
      drawAll();
    });
    canvas.addEventListener("pointerleave", () => { cursor = null; drawAll(); });
  };
  for (const sensor of document_.sensors) {
    add(sensor.replace(/_C$/, ""), "°C", [
      { name: `${sensor} measured`, label: "measured", color: "--measured", band: "--band", width: 2 },
      ...document_.twins.map((twin, k) => ({ name: `${sensor} ${twin}`, label: twin, color: COLORS[k % COLORS.length], sparse: true, width: k ? 1.6 : 3.2 })),
    ]);
  }
  const isTemperature = (value) => value.unit === "°C";
  const others = shown.values.filter((value) => !(document_.sensors.length && isTemperature(value) && value.name !== "T_ambient"));
  const units = [...new Set(others.map((value) => value.unit))];
  for (const unit of units) {
    const all = others.filter((value) => value.unit === unit);
    for (let at = 0; at < all.length; at += MOST_CURVES) {
      const group = all.slice(at, at + MOST_CURVES);
      const meters = group.filter((value) => value.kind !== "setpoint");
      add(titleOf((meters.length ? meters : group).map((value) => value.name)), unit, group.map((value, k) => ({
        name: value.name, label: value.name, color: COLORS[(k + 1) % COLORS.length], dash: value.kind === "setpoint" ? [5, 3] : [],
      })));
    }
  }
  put("trends", ...cards);
}

function showPast(document_) {
  past = document_;
  heardTimes = [];
  courses = { all: new Course(document_.all, shown.period_s), recent: new Course(document_.recent, shown.period_s) };
  if (shown && shown.values.length) makePlots(document_);
}

function drawAll() {
  if (!courses) return;
  for (const plot of plots) {
    const course = span <= 600 ? courses.recent : courses.all;
    const last = course.time.length ? course.time[course.time.length - 1] : 0;
    drawCourse(plot.canvas, course, plot.curves, Number.isFinite(span) ? last - span : -Infinity, cursor);
    let at = course.time.length - 1;
    if (cursor !== null) at = course.time.reduce((best, t, k) => (Math.abs(t - cursor) < Math.abs(course.time[best] - cursor) ? k : best), 0);
    const value = (curve) => {
      const cells = course.series.get(curve.name);
      if (!cells) return null;
      let k = at;
      while (curve.sparse && k > 0 && cells.mean[k] === null) k--;
      return k < 0 ? null : cells.mean[k];
    };
    const items = plot.curves.map((curve) => {
      const swatch = el("i", {});
      swatch.style.background = `var(${curve.color})`;
      return el("span", {}, swatch, `${curve.label} ${format(value(curve))}`);
    });
    plot.legend.replaceChildren(...items);
    if (cursor !== null) plot.legend.append(el("span", {}, `at ${clock(cursor)}`));
  }
}

function addPoint(now) {
  if (!courses) return;
  if (!plots.length && now.values.length && past) makePlots(past);
  const point = {};
  for (const value of now.values) point[value.name] = value.value;
  for (const twin of now.twins) point[`${twin.sensor} measured`] = twin.measured;
  courses.all.add(now.time_s, point);
  courses.recent.add(now.time_s, point);
  heardTimes.push([Date.now(), now.time_s]);
  if (heardTimes.length > PACE_STATES) heardTimes.shift();
  courses.all.stateS = courses.recent.stateS = stateStep(heardTimes);
  for (const { twin, time_s, values } of now.predicted) {
    const predicted = {};
    for (const [sensor, value] of Object.entries(values)) predicted[`${sensor} ${twin}`] = value;
    addTwin(time_s, predicted);
  }
}

/* A prediction comes later than the readings of its tick: it joins the point of its time. */
function addTwin(timeS, values) {
  for (const course of Object.values(courses)) {
    let at = course.time.length - 1;
    while (at > 0 && course.time[at] > timeS + course.binS / 2) at--;
    if (at < 0) continue;
    for (const [name, value] of Object.entries(values)) {
      const cells = course.series.get(name);
      if (cells && value !== null && cells.mean[at] === null) cells.mean[at] = cells.low[at] = cells.high[at] = value;
    }
  }
}

/* ---- dialogs ---- */

let pending = null;
function openDialog(title, text, fields, label, isStop, work) {
  byId("ask-title").textContent = title;
  byId("ask-text").textContent = text;
  byId("ask-error").textContent = "";
  put("ask-fields", ...fields);
  const confirm = byId("confirm");
  confirm.textContent = label;
  confirm.className = isStop ? "stop" : "main";
  confirm.disabled = false;
  pending = work;
  byId("ask").showModal();
}

function field(label, name, tag, value, rest) {
  const input = el(tag || "input", { name, ...(rest || {}) });
  if (value !== undefined) input.value = value;
  return el("label", {}, label, input);
}
const operator = () => { try { return localStorage.getItem("operator") || ""; } catch (_) { return ""; } };
function given() {
  const found = {};
  for (const input of byId("ask-fields").querySelectorAll("[name]")) found[input.name] = input.value.trim();
  if ("by" in found) { try { localStorage.setItem("operator", found.by); } catch (_) { /* private window */ } }
  return found;
}
const who = () => field("Your name", "by", "input", operator(), { maxlength: "60", autocomplete: "name" });

function askVerb(verb) {
  const [label, text] = VERBS[verb];
  const seen = shown.state;
  openDialog(`${label}: ${shown.run}`, text, [field("Reason, for the journal", "reason", "input", "", { maxlength: "150" }), who()], label, verb === "abort", () =>
    post(api("verb"), { verb, confirmed: true, seen, ...given() }));
}

function askAlarm(act, alarm) {
  if (act === "shelve") {
    const durations = [["15 min", 900], ["1 h", 3600], ["8 h", 28800], ["24 h", 86400]].map(([text, value]) => el("option", { value: String(value) }, text));
    const choice = el("select", { name: "for_s" }, ...durations);
    openDialog(`Shelve ${alarm.id}`, `${alarm.what}. It leaves the list until the end of the shelving. Trips and interlocks stay as they are.`,
      [el("label", {}, "For", choice), field("Reason", "reason", "input", "", { maxlength: "500", required: "" }), who()], "Shelve", false, () => {
        const all = given();
        return post(api("alarm"), { act, id: alarm.id, count: alarm.count, by: all.by, reason: all.reason, for_s: Number(all.for_s) });
      });
    return;
  }
  const label = act === "acknowledge" ? "Acknowledge" : "End shelving";
  const text = act === "acknowledge" ? `${alarm.what}. This states that you have seen it. It releases no trip.` : alarm.what;
  openDialog(`${label}: ${alarm.id}`, text, [field("Remark", "reason", "input", "", { maxlength: "500" }), who()], label, false, () => post(api("alarm"), { act, id: alarm.id, count: alarm.count, ...given() }));
}

function askNote() {
  openDialog("Add a note", "Notes are kept with time and author, and none is changed later.", [field("Note", "text", "textarea", "", { maxlength: "2000", required: "" }), who()], "Add", false, () => post(api("note"), given()));
}

byId("form").addEventListener("submit", async (event) => {
  event.preventDefault();
  if (pending === null || byId("confirm").disabled) return;
  byId("confirm").disabled = true;
  byId("ask-error").textContent = "";
  try {
    await pending();
    byId("ask").close();
  } catch (error) {
    byId("ask-error").textContent = error.message;
    byId("confirm").disabled = false;
  }
});
byId("cancel").addEventListener("click", () => byId("ask").close());
byId("note").addEventListener("click", askNote);

/* ---- following ---- */

function show(now) {
  shown = now;
  heardAt = Date.now();
  showHead(now); showAlarms(now.alarms); showValues(now.values, now.twins); showDiagnosis(now); showLog(now);
  addPoint(now); drawAll(); showLink();
}

function banner(text) { byId("banner").textContent = text; byId("banner").hidden = !text; }

/* A run that is just being made, or a panel that was started again, may be there in a moment. */
function later(mine, name) { setTimeout(() => { if (mine === source) follow(name, true); }, RETRY_MS); }

async function follow(name, again) {
  if (source) source.close();
  run = name; shown = null; gone = false; courses = null; past = null; plots = []; heardAt = Date.now();
  put("trends");
  if (!again) banner("");
  history.replaceState(null, "", `#${encodeURIComponent(name)}`);
  source = new EventSource(api("stream"));
  const mine = source;
  source.onmessage = async (event) => {
    if (mine !== source) return;
    const first = shown === null;
    show(JSON.parse(event.data));
    banner("");
    if (first) {
      try {
        const document_ = await getJson(api("history"));
        if (mine === source) { showPast(document_); drawAll(); }
      } catch (error) { banner(error.message); }
    }
  };
  source.addEventListener("gone", (event) => {
    if (mine !== source) return;
    gone = true; mine.close(); banner(JSON.parse(event.data).text); showLink(); listRuns(false); later(mine, name);
  });
  source.onerror = async () => {
    if (mine !== source || mine.readyState !== EventSource.CLOSED || gone) return;
    try { await getJson(api("history")); } catch (error) { banner(error.message); }
    later(mine, name);
  };
}

async function listRuns(pick) {
  try {
    const { runs } = await getJson("/api/runs");
    const options = runs.map((item) => el("option", { value: item.name, selected: item.name === run }, `${item.name} (${item.status === "running" ? "live" : item.status})`));
    put("runs", ...options);
    if (!pick) return;
    const wanted = decodeURIComponent(location.hash.slice(1));
    const chosen = runs.find((item) => item.name === wanted) || runs.find((item) => item.status === "running") || runs[0];
    if (chosen) { byId("runs").value = chosen.name; follow(chosen.name); } else banner("there is no run in this folder");
  } catch (error) { banner(error.message); }
}

byId("runs").addEventListener("change", (event) => follow(event.target.value));
put("span", ...SPANS.map(([label, seconds]) => el("button", {
  type: "button", "aria-pressed": String(seconds === span), onclick: (event) => {
    span = seconds;
    for (const button of byId("span").children) button.setAttribute("aria-pressed", String(button === event.currentTarget));
    drawAll();
  },
}, label)));
window.addEventListener("resize", drawAll);
window.matchMedia("(prefers-color-scheme: dark)").addEventListener("change", drawAll);
setInterval(showLink, 500);
setInterval(() => listRuns(run === null), 30000);
listRuns(true);
