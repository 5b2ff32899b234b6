// Words beside the picture: alarms, one positioner, commands. All text is set as text, never as markup.

export function element(name, text = "", classes = "", ...children) {
  const made = document.createElement(name);
  if (text) made.textContent = text;
  if (classes) made.className = classes;
  made.append(...children);
  return made;
}

const time = (iso) => (iso ? new Date(iso).toISOString().slice(11, 19) : "");

export function showAlarms(place, alarms, { acknowledge, choose, propose, may }) {
  place.replaceChildren(...alarms.map((alarm) => {
    const on = alarm.gone === null;
    const row = element("div", "", `alarm ${alarm.severity}`);
    row.dataset.id = `${alarm.night ? "night-" : ""}${alarm.id}`;
    // of an array the number alone; of a night with the word before it
    const numbered = /^(?:positioner )?(\d+)$/.exec(alarm.subject);
    const subject = element("button", numbered ? `positioner ${numbered[1]}` : alarm.subject);
    subject.onclick = () => choose(Number(numbered[1]));
    subject.disabled = !numbered;
    const count = alarm.count > 1 ? ` (${alarm.count} times)` : "";
    const what = element("span", "", "what", element("b", `${alarm.severity}: ${alarm.code}`), ` ${alarm.text}${count} `,
      element("span", alarm.advice, "advice"), `, since ${time(alarm.since)} UTC${on ? "" : `, gone since ${time(alarm.gone)}`}`);
    row.append(subject, what);
    if (alarm.code === "health" && on) {
      const exclude = element("button", "exclude …");
      exclude.onclick = () => propose(Number(alarm.subject), alarm.text);
      exclude.disabled = !may("engineer");
      row.append(exclude);
    }
    if (alarm.acknowledged) row.append(element("span", `seen by ${alarm.acknowledged_by}`, "quiet"));
    else {
      const button = element("button", "acknowledge", "acknowledge");
      button.onclick = () => acknowledge(alarm);
      button.disabled = !may("operator");
      row.append(button);
    }
    return row;
  }));
}

const number = (value, digits) => (value === null || value === undefined ? "–" : value.toFixed(digits));

function table(heads, rows) {
  const made = element("table");
  made.append(element("tr", "", "", ...heads.map((head) => element("th", head))));
  for (const row of rows) made.append(element("tr", "", "", ...row.map((cell) => element("td", String(cell)))));
  return made;
}

export function showPositioner(place, known, live, buttons) {
  const { health, exclusions, measurements, events, alarms, nights } = known;
  const in_force = exclusions.filter((e) => e.cleared === null);
  const parts = [element("h2", `positioner ${known.positioner_id}, hole ${live.hole}`)];
  parts.push(element("p", `${live.state}; alpha ${number(live.alpha, 2)}°, beta ${number(live.beta, 2)}°; place ${known.place.how}, `
    + `datum ${known.place.datum ? "known" : "not known"}`));
  const said = health.state ? `${health.state}${health.ailment ? `: ${health.ailment} ${health.axis}, ${health.evidence}. ${health.advice}` : ""}` : "no run yet";
  parts.push(element("p", `health: ${said}`, "health"));
  for (const e of in_force) parts.push(element("p", `excluded by ${e.who} since ${time(e.since)} UTC: ${e.why}`));
  parts.push(element("div", "", "row", ...buttons(in_force.length > 0)));
  if (known.image) {
    const image = element("img", "", "cutout");
    image.alt = `the last image around the fibre of positioner ${known.positioner_id}`;
    image.src = `/api/v1/positioners/${known.positioner_id}/image?${live.seen}`;
    parts.push(element("figure", "", "", element("div", "", "lens", image), element("figcaption", `last image, ${known.image.slice(0, 19).replace("T", " ")} UTC: cross, centroid as measured; ring, its goal`, "quiet")));
  }
  if (nights.some((n) => n.night !== null)) {
    parts.push(element("h2", "nights"));
    parts.push(table(["night", "targets", "median um", "worst um"], nights.map((n) => [n.night ?? "none", n.targets, number(n.median_um, 2), number(n.worst_um, 2)])));
  }
  parts.push(element("h2", "last measurements"));
  parts.push(table(["run", "move", "target", "error um", "state"], measurements.slice(0, 14).map((m) => [
    m.field ? `${m.run} ${m.field}` : m.run, `${m.move} ${m.kind}`, m.target_id ?? "–", number(m.error_um, 2), m.status ?? (m.seen ? "seen" : "not seen"),
  ])));
  if (events.length) {
    parts.push(element("h2", "events"));
    parts.push(element("ol", "", "", ...events.slice(0, 8).map((e) => element("li", `${time(e.utc)} ${e.kind}: ${e.text}`))));
  }
  if (alarms.length) {
    parts.push(element("h2", "alarms"));
    parts.push(element("ol", "", "", ...alarms.slice(0, 8).map((a) => element("li", `${time(a.since)} ${a.severity}, ${a.code}: ${a.text}${a.gone ? ", gone" : ""}`))));
  }
  const past = exclusions.filter((e) => e.cleared !== null);
  if (past.length) parts.push(element("p", `${past.length} past exclusions, the last one by ${past[past.length - 1].who}: ${past[past.length - 1].why}`, "quiet"));
  place.replaceChildren(...parts);
}

export function showLog(place, commands) {
  place.replaceChildren(...commands.slice(0, 12).map((c) => {
    const how = c.result === "running" ? "runs" : c.result;
    return element("li", `${time(c.utc)} ${c.author}: ${c.command}, ${how}${c.text ? `: ${c.text}` : ""}`);
  }));
}
