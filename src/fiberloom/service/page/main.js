// The page: what is known, what was asked, what is drawn.
import { get, getBytes, send, stream } from "/page/api.js";
import { SHAPES, shape } from "/page/look.js";
import { element, showAlarms, showLog, showPositioner } from "/page/panel.js";
import { drawNight, showNight } from "/page/night.js";
import { anglesAt, Plane, readPicture, readPlan } from "/page/plane.js";
import { drawStages } from "/page/stages.js";
import { View } from "/page/view.js";

const $ = (id) => document.getElementById(id);
const ROLES = ["viewer", "operator", "engineer"];

class Model {
  plane = null;
  states = new Uint8Array();
  seen = {};
  plan = null;
  planAbout = {};
  stages = [];
  alarms = [];
  array = {};
  night = null;  // none is served
  running = null;
  sequence = 0;
  chosen = -1;
  showErrors = true;
  slider = null;  // s in the plan that are shown in place of what is now
  time_s = NaN;
  who = { name: "", role: "viewer" };
  linked = false;
  from = null;  // the picture before, to go smoothly to the last one
  at = 0;

  // which rows move now (1) or not; null: none
  moves() {
    if (this.slider !== null && this.plan) return this.plan.moves;
    return Number.isFinite(this.time_s) && this.plan ? this.plan.moves : null;
  }

  shownAngles() {
    if (this.slider !== null && this.plan) return anglesAt(this.plan, this.slider);
    const part = (performance.now() - this.at) / 110;
    if (!this.from || part >= 1 || !this.moves()) return this.plane.angles;
    const out = new Float32Array(this.from.length), to = this.plane.angles;
    for (let k = 0; k < out.length; k++) out[k] = this.from[k] + part * (to[k] - this.from[k]);
    return out;
  }

  // why nothing else may begin now; empty: it may
  busy() {
    if (this.running) return `${this.running.command} of ${this.running.author} runs`;
    return this.array.owner ? `in use by ${this.array.owner}` : "";
  }

  may(role) { return ROLES.indexOf(this.who.role) >= ROLES.indexOf(role); }
}

const model = new Model();
const view = new View($("still"), $("moving"), model);

// --- what comes from the service

async function before() {
  model.who = await get("/api/v1/whoami");
  if (model.who.role === "none") {
    await logIn();
    model.who = await get("/api/v1/whoami");
  }
}

async function begin() {
  const about = await get("/api/v1/plane");
  if (!model.plane || model.plane.hash !== about.hash) {
    model.plane = new Plane(about);
    model.chosen = -1;
    view.fit();
  }
  await snapshot();
  await lists();
  model.linked = true;
  words();
  $("link").textContent = "live";
  $("link").classList.remove("off");
  say("");
}

async function snapshot() {
  const state = await get("/api/v1/state");
  Object.assign(model, { sequence: state.seq, seen: state.seen, stages: state.stages, alarms: state.alarms,
    array: state.array, running: state.running, planAbout: state.plan, exclusions: state.exclusions,
    night: state.night && { ...state.night, got: performance.now() } });
  model.states = Uint8Array.from(state.states);
  model.plan = state.plan.label ? readPlan(await getBytes("/api/v1/plan")) : null;
  await log();
  words();
}

const EVENTS = {
  stage: ({ name, command, begun }) => {
    const last = model.stages[model.stages.length - 1];
    if (last && !last.ended) last.ended = begun;
    model.stages.push({ name, command, begun, ended: null });
  },
  progress: ({ done, total }) => Object.assign(model.stages[model.stages.length - 1] ?? {}, { done, total }),
  plan: async (event) => {
    model.planAbout = event;
    model.seen = { ...model.seen, targets: event.targets, errors_um: event.number === 1 ? null : model.seen.errors_um };
    model.plan = readPlan(await getBytes("/api/v1/plan"));
    model.from = null;
    words();
  },
  move: (event) => { model.seen = event; refreshChosen(); },
  states: ({ states }) => { model.states = Uint8Array.from(states); },
  alarms: ({ alarms }) => { model.alarms = alarms; },
  exclusions: ({ exclusions }) => { model.exclusions = exclusions; refreshChosen(); },
  array: (event) => { model.array = event; },
  night: (event) => { model.night = { ...event, got: performance.now() }; },
  stopped: ({ text }) => say(text),
  command: async (event) => {
    if (event.result === "running") model.running = event;
    else if (model.running && event.id === model.running.id) {
      model.running = null;
      const last = model.stages[model.stages.length - 1];
      if (last && !last.ended) last.ended = Date.now() / 1000;
      say(`${event.command}: ${event.result}${event.text ? `, ${event.text}` : ""}`);
      refreshChosen();
    }
    await log();
  },
};

stream({
  before,
  begin,
  event: (event) => {
    if (event.seq <= model.sequence) return;  // it is in the snapshot
    if (event.seq > model.sequence + 1) { snapshot().catch(failed); return; }
    model.sequence = event.seq;
    Promise.resolve(EVENTS[event.kind]?.(event)).catch(failed);
    view.stale = true;
    words();
  },
  picture: (buffer) => {
    const found = model.plane && readPicture(buffer, model.plane.n);
    if (!found) return;
    const moved = Number.isFinite(found.time_s), was = Number.isFinite(model.time_s);
    model.from = moved && was ? model.shownAngles() : null;
    model.at = performance.now();
    model.plane.angles = found.angles;
    model.states = found.states;
    if (!moved || !was) view.stale = true;
    model.time_s = found.time_s;
    if (moved !== was) words();
  },
  cut: () => {
    $("link").textContent = "no connection";
    $("link").classList.add("off");
    model.time_s = NaN;
    model.linked = false;
    words();
  },
});

async function log() {
  showLog($("log"), await get("/api/v1/commands"));
}

async function lists() {
  const found = await get("/api/v1/targets"), chosen = $("targets").value;
  $("targets").replaceChildren(...found.map((f) => new Option(f.name, f.name)));
  if (found.some((f) => f.name === chosen)) $("targets").value = chosen;
}

// --- words

function words() {
  const { array, running, plane, planAbout, stages } = model;
  if (!plane) return;
  $("title").textContent = `fiberloom · ${plane.instrument} · ${plane.n}`;
  const now = Number.isFinite(model.time_s) ? "moving" : "at work";
  const state = !model.linked ? "not known" : running ? now : array.state;
  $("array-state").textContent = state;
  $("array-state").title = array.text || array.address;
  $("array-state").className = `badge is-${state.replace(" ", "-")}`;
  const last = stages[stages.length - 1], count = last?.total ? ` ${last.done}/${last.total}` : "";
  $("running").textContent = running ? `${running.command} by ${running.author}: ${last?.command === running.command ? last.name + count : ""}`
    : array.owner ? `in use by ${array.owner}` : "";
  $("who").textContent = `${model.who.name}, ${model.who.role}`;
  showAlarms($("alarms"), allAlarms(), { acknowledge, choose: (id) => choose(plane.row.get(id) ?? -1, true), propose: exclude, may: (r) => model.may(r) });
  for (const button of document.querySelectorAll("[data-role]")) {
    const why = refused(button);
    button.dataset.hint ??= button.title;
    button.disabled = why !== "";
    button.title = why || button.dataset.hint;
    button.classList.toggle("disabled", button.disabled);
  }
  $("night").hidden = $("night-bars").hidden = !model.night;
  if (model.night) showNight($("night"), model.night, NIGHT);
  $("slider").disabled = !model.plan;
  if (model.plan) {
    $("slider").max = model.plan.duration_s;
    $("slider-name").textContent = `plan: ${planAbout.label}`;
  }
  legend();
}

// why a button cannot be used now; empty: it can
function refused(button) {
  if (!model.may(button.dataset.role)) return `needs the role ${button.dataset.role}`;
  if (button === $("park") && model.night?.goes_on) return "";  // at once, as the night's own button
  if (button.dataset.moves === undefined) return "";
  if (button === $("observe") && !$("targets").value) return "add a target list first";
  return model.busy();
}

function legend() {
  const { plane, states } = model, counts = new Map();
  for (const code of states) counts.set(plane.states[code], (counts.get(plane.states[code]) ?? 0) + 1);
  $("legend").replaceChildren(...Object.keys(SHAPES).filter((name) => counts.get(name)).map((name) => {
    const canvas = element("canvas");
    canvas.width = canvas.height = 16;
    const c = canvas.getContext("2d");
    c.fillStyle = c.strokeStyle = view.look.colours[name];
    c.lineWidth = 2;
    c.beginPath();
    if (shape(c, name, 8, 8, 5)) c.fill();
    c.stroke();
    return element("div", "", "", canvas, `${name.replace("_", " ")} ${counts.get(name)}`);
  }));
}

function say(text) { $("answer").textContent = text; }
function failed(error) { say(error.message); }

async function chosenKnown() {
  const { plane, chosen } = model;
  if (chosen < 0) return;
  const id = plane.positioner_id[chosen], known = await get(`/api/v1/positioners/${id}`);
  if (model.chosen !== chosen) return;
  const live = { seen: model.seen?.utc ?? 0, hole: plane.hole[chosen], state: plane.states[model.states[chosen]].replace("_", " "),
    alpha: finite(plane.angles[chosen]), beta: finite(plane.angles[plane.n + chosen]) };
  showPositioner($("positioner"), known, live, (excluded) => {
    const button = element("button", excluded ? "include" : "exclude …", "exclude");
    button.disabled = !model.may("engineer");
    button.onclick = () => (excluded ? command("/api/v1/include", { positioners: [id] }) : exclude(id, ""));
    const home = element("button", "home this one");
    home.disabled = !model.may("engineer") || model.busy() !== "";
    home.title = model.busy();
    home.onclick = () => asked(`Search the datum of positioner ${id}?`, "/api/v1/home", { positioners: [id] });
    return [button, home];
  });
}

const finite = (value) => (Number.isFinite(value) ? value : null);
function refreshChosen() { chosenKnown().catch(failed); }

function choose(row, show = false) {
  model.chosen = row;
  view.stale = true;
  if (row >= 0 && show) view.show(row, true);
  if (row < 0) $("positioner").replaceChildren(element("p", "Click a positioner.", "quiet"));
  chosenKnown().then(() => { if (row >= 0) $("positioner").scrollIntoView({ block: "start" }); }).catch(failed);
}

// --- commands

async function command(path, body) {
  try {
    const found = await send(path, body);
    say(found.text ?? "");
    return found;
  } catch (error) { failed(error); return null; }
}

function ask(text, { input = null, secret = false, yes = "yes" } = {}) {
  $("dialog-text").textContent = text;
  $("dialog-input").hidden = input === null;
  $("dialog-input").type = secret ? "password" : "text";
  $("dialog-input").value = input ?? "";
  $("dialog-yes").textContent = yes;
  $("dialog").returnValue = "";
  $("dialog").showModal();
  return new Promise((done) => $("dialog").addEventListener("close",
    () => done($("dialog").returnValue === "yes" ? $("dialog-input").value || "yes" : null), { once: true }));
}
$("dialog-input").addEventListener("keydown", (event) => {
  if (event.key !== "Enter") return;
  event.preventDefault();
  $("dialog").close("yes");
});

async function asked(text, path, body) { if (await ask(text)) await command(path, body); }

async function exclude(id, why) {
  const reason = await ask(`Exclude positioner ${id}. Why?`, { input: why, yes: "exclude" });
  if (reason) await command("/api/v1/exclude", { positioners: [id], why: reason });
}

async function acknowledge(alarm) { await command(`/api/v1/${alarm.night ? "night/" : ""}alarms/${alarm.id}/acknowledge`); }

// of the array and of its night
function allAlarms() {
  const night = (model.night?.alarms ?? []).map((alarm) => ({ ...alarm, night: true }));
  const rank = ({ severity }) => ["critical", "major", "minor", "advice"].indexOf(severity);
  return [...model.alarms, ...night].sort((a, b) => rank(a) - rank(b));
}

const NIGHT = {
  may: (role) => model.may(role),
  begin: (resume) => command("/api/v1/night/begin", { resume }),
  pause: () => command("/api/v1/night/pause"),
  goOn: () => command("/api/v1/night/go_on"),
  park: () => asked("Fold all at once, and end the night? An exposure is not cut short.", "/api/v1/night/park"),
  skip: (field) => asked(`Leave ${field} out?`, "/api/v1/night/skip", { field }),
  first: (field) => command("/api/v1/night/priority", { field, priority: 1 + Math.max(...model.night.fields.map((f) => f.priority)) }),
  add: async () => {
    const targets = $("targets").value;
    if (!targets) { say("add a target list first"); return; }
    const id = await ask(`New field with ${targets}. Its name?`, { input: targets.replace(/\..*$/, ""), yes: "next" });
    const seconds = id && await ask(`Exposure of ${id}, s?`, { input: "900", yes: "add" });
    if (seconds) await command("/api/v1/night/fields", { id, targets, exposure_s: Number(seconds) });
  },
};

async function logIn() {
  for (;;) {
    const token = await ask("Token of a viewer, operator or engineer:", { input: "", secret: true, yes: "log in" });
    if (!token) continue;
    try { await send("/api/v1/login", undefined, { Authorization: `Bearer ${token}` }); return; } catch (error) { failed(error); }
  }
}

function stop() { command("/api/stop"); }

$("stop").onclick = stop;
$("park").onclick = () => model.night?.goes_on ? NIGHT.park() : asked(`Fold all ${model.plane.n} positioners?`, "/api/v1/park");
$("home").onclick = () => asked(`Search the datum of all ${model.plane.n} positioners?`, "/api/v1/home", {});
$("look").onclick = () => command("/api/v1/recover", { look: true });
$("recover").onclick = () => asked("Take arms apart that touch, and unlock?", "/api/v1/recover", { look: false });
$("observe").onclick = () => command("/api/v1/observe", { targets: $("targets").value });
$("upload").onchange = async () => {
  const file = $("upload").files[0];
  try {
    const { name, targets } = await send(`/api/v1/targets/${encodeURIComponent(file.name)}`, file, {}, "PUT");
    await lists();
    $("targets").value = name;
    words();
    say(`${name}: ${targets} targets`);
  } catch (error) { failed(error); }
  $("upload").value = "";
};

// --- hands

$("slider").oninput = () => { model.slider = Number($("slider").value); view.stale = true; };
$("live").onclick = live;
function live() { model.slider = null; view.stale = true; }
$("errors").onchange = () => { model.showErrors = $("errors").checked; view.stale = true; };
$("fit").onclick = () => view.fit();
$("search").onchange = () => {
  const row = model.plane.row.get(Number($("search").value));
  if (row === undefined) say(`positioner ${$("search").value}: there is none`);
  else choose(row, true);
};
$("theme").onchange = () => theme($("theme").value);

function theme(name) {
  document.documentElement.dataset.theme = name;
  $("theme").value = name;
  localStorage.setItem("theme", name);
  view.theme(name);
  bars = -Infinity; // drawn anew with the next picture
  words();
}

const field = $("field");
let pressed = null;
field.addEventListener("pointerdown", (event) => {
  if (event.target.tagName !== "CANVAS") return;
  pressed = { x: event.clientX, y: event.clientY, far: 0 };
  field.setPointerCapture(event.pointerId);
});
field.addEventListener("pointermove", (event) => {
  if (!pressed) return;
  const dx = event.clientX - pressed.x, dy = event.clientY - pressed.y;
  pressed.far += Math.hypot(dx, dy);
  if (pressed.far > 4) view.pan(dx, dy);
  [pressed.x, pressed.y] = [event.clientX, event.clientY];
});
field.addEventListener("pointerup", (event) => {
  if (pressed && pressed.far <= 4) choose(model.plane.nearest(...view.at(event.clientX, event.clientY)));
  pressed = null;
});
field.addEventListener("wheel", (event) => {
  event.preventDefault();
  view.zoom(Math.exp(-event.deltaY / 500), view.at(event.clientX, event.clientY));
}, { passive: false });

const KEYS = {
  S: stop, "/": () => $("search").focus(), 0: () => view.fit(), l: live,
  "+": () => view.zoom(1.25), "-": () => view.zoom(0.8),
  ArrowLeft: () => view.pan(60, 0), ArrowRight: () => view.pan(-60, 0), ArrowUp: () => view.pan(0, 60), ArrowDown: () => view.pan(0, -60),
  n: () => choose((model.chosen + 1) % model.plane.n), p: () => choose((model.chosen - 1 + model.plane.n) % model.plane.n),
  a: () => { const first = allAlarms().find((alarm) => !alarm.acknowledged); if (first) acknowledge(first); },
  t: () => { const all = ["dark", "red", "light"]; theme(all[(all.indexOf($("theme").value) + 1) % 3]); },
  Escape: () => choose(-1),
};
document.addEventListener("keydown", (event) => {
  if (event.ctrlKey || event.metaKey || event.altKey || $("dialog").open) return;
  if (["INPUT", "SELECT"].includes(event.target.tagName) && event.key !== "Escape") return;
  const act = KEYS[event.key];
  if (!act || !model.plane) return;
  event.preventDefault();
  act();
});

// --- drawing

let bars = -Infinity;
function frame(now) {
  const moving = Number.isFinite(model.time_s);
  if (moving || view.stale) view.draw();
  const still = model.slider !== null;
  $("mark").hidden = !(still || moving);
  $("mark").textContent = still ? "by the plan, not now" : "in motion: angles by the plan";
  const time_s = still ? model.slider : model.time_s;
  if (moving && !still) $("slider").value = time_s;
  if (model.plan) $("slider-time").textContent = `${Number.isFinite(time_s) ? `${time_s.toFixed(1)} of ` : ""}${model.plan.duration_s.toFixed(1)} s`;
  if (now - bars > 500) {
    bars = now;
    drawStages($("stages"), model.stages, view.look.paper);
    if (model.night) drawNight($("night-bars"), model.night, view.look.paper);
  }
  requestAnimationFrame(frame);
}

new ResizeObserver(() => view.resize()).observe(field);
theme(localStorage.getItem("theme") ?? "dark");
requestAnimationFrame(frame);
window.fiberloom = { model, view, words };
