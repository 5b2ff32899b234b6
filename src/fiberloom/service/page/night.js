// The night: stages as bars by its own clock, what comes next, its fields and what may be asked of it.
import { element } from "/page/panel.js";

const clock = (s) => new Date(1000 * s).toISOString().slice(11, 19);
const KIND = { position: "move", expose: "open", park: "move", recover: "move", pause: "rest", wait: "rest" };
const kind = (bar) => KIND[bar.name.split(" ")[0]] ?? "rest";

// its clock now: what was told last, and what has passed since (no more than ten seconds of ours)
export function nightNow(night) {
  if (!night.goes_on) return night.now;
  return night.now + night.rate * Math.min((performance.now() - night.got) / 1000, 10);
}

export function drawNight(canvas, night, paper) {
  const ratio = window.devicePixelRatio || 1, box = canvas.getBoundingClientRect();
  canvas.width = Math.max(1, box.width * ratio);
  canvas.height = Math.max(1, box.height * ratio);
  const c = canvas.getContext("2d"), { width, height } = canvas;
  c.font = `${11 * ratio}px system-ui, sans-serif`;
  c.textBaseline = "middle";
  if (!night.bars) return;
  const now = nightNow(night), bars = night.bars, next = night.next.filter((n) => n.end > now);
  const last = next.length ? next[next.length - 1].end : Math.max(now, ...bars.map((b) => b.end ?? now));
  const begin = bars.length ? bars[0].begin : night.begin, end = Math.max(last, begin + 60);
  const x = (t) => ((t - begin) / (end - begin)) * width, top = 18 * ratio, low = height - 2 * ratio;
  const label = (text, x0, x1) => {
    if (c.measureText(text).width > x1 - x0 - 6) return;
    c.fillStyle = paper.text;
    c.fillText(text, x0 + 4, (top + low) / 2);
  };
  c.lineWidth = ratio;
  for (const bar of bars) {
    const x0 = x(bar.begin), x1 = Math.max(x(bar.end ?? now), x0 + ratio), what = kind(bar);
    c.fillStyle = what === "open" ? paper.bar[0] : what === "move" ? paper.error : paper.base;
    const inset = what === "open" ? 0 : what === "move" ? 6 * ratio : 12 * ratio;
    c.fillRect(x0, top + inset, x1 - x0, low - top - 2 * inset);
    if (what === "open") label(bar.field, x0, x1);
  }
  c.setLineDash([4 * ratio, 3 * ratio]);
  for (const step of next) {
    const x0 = Math.max(x(step.begin), x(now)), x1 = Math.max(x(step.end), x0 + ratio);
    c.strokeStyle = paper.text;
    if (kind(step) === "open") c.strokeRect(x0 + ratio, top + ratio, x1 - x0 - 2 * ratio, low - top - 2 * ratio);
    if (kind(step) === "open") label(step.field, x0, x1);
  }
  c.setLineDash([]);
  c.fillStyle = paper.text;
  c.fillRect(x(now) - ratio, 0, 2 * ratio, height);
  c.fillText(clock(begin), 2, 8 * ratio);
  const text = clock(end), at = Math.min(x(now) + 6 * ratio, width - 2 * c.measureText(text).width - 12 * ratio);
  if (x(now) > c.measureText(text).width + 12 * ratio) c.fillText(clock(now), Math.max(at, 0), 8 * ratio);
  c.fillText(text, width - c.measureText(text).width - 2, 8 * ratio);
}

export function nightWords(night) {
  if (night.begins) return "the night begins";
  if (!night.bars) return `${night.queue}: not begun`;
  const how = night.goes_on ? (night.parked_by ? `parks, asked by ${night.parked_by}` : night.paused_by ? `paused by ${night.paused_by}` : "goes on")
    : `${night.status}${night.note ? `, ${night.note}` : ""}`;
  const next = night.goes_on ? night.next.find((step) => step.begin > night.now && step.field) : null;
  const comes = next ? `; next ${next.name} ${next.field} at ${clock(next.begin)}` : "";
  const pace = night.goes_on && night.rate !== 1 ? `, clock x${night.rate}` : "";
  return `night ${night.id}, ${night.name}: ${how}${pace}${comes}`;
}

function button(text, role, may, act, title = "") {
  const made = element("button", text);
  made.disabled = !may(role);
  made.onclick = act;
  made.title = title;
  return made;
}

// `ask` of the page: what each button does; `may` the role that it needs. While a night begins there is none yet
// that could take orders.
export function showNight(place, night, { may, begin, pause, goOn, park, skip, first, add }) {
  const buttons = night.begins ? [] : night.goes_on
    ? [night.paused_by ? button("go on", "operator", may, goOn) : button("pause", "operator", may, pause, "after what is under way"),
      button("park at once", "operator", may, park, "ends the night; an exposure is not cut short"),
      button("add field …", "operator", may, add, "with the target list that is chosen above")]
    : [...(night.resume ? [button("resume night", "operator", may, () => begin(true))] : []), button("begin night", "operator", may, () => begin(false))];
  const parts = [element("h2", nightWords(night)), element("div", "", "row", ...buttons)];
  if (night.fields) {
    const table = element("table", "", "fields", element("tr", "", "", ...["field", "state", "on target", "um", ""].map((t) => element("th", t, t === "state" ? "left" : ""))));
    for (const f of night.fields) {
      const over = ["done", "failed", "skipped"].includes(f.state) || !night.goes_on;
      const acts = over ? [] : [button("first", "operator", may, () => first(f.name), "higher than all others"), button("skip", "operator", may, () => skip(f.name))];
      const on = f.on_target === null ? "" : `${f.on_target}/${f.assigned}`;
      const row = element("tr", "", `is-${f.state}`, element("td", f.name), element("td", f.state, "left"), element("td", on),
        element("td", f.rms_um === null ? "" : f.rms_um.toFixed(2)), element("td", "", "", ...acts));
      row.title = [f.exposures, `priority ${f.priority}`, f.reason, f.plan_from ? `plan: ${f.plan_from}` : ""].filter(Boolean).join("; ");
      table.append(row);
    }
    parts.push(table);
  }
  place.replaceChildren(...parts);
}
