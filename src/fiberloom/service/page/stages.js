// The last commands as bars of stages: when each began, how long it took. What a night adds comes the same way.

const LEAST_S = 60, MOST_S = 900;  // of time that is shown

export function drawStages(canvas, stages, paper) {
  const ratio = window.devicePixelRatio || 1, box = canvas.getBoundingClientRect();
  canvas.width = Math.max(1, box.width * ratio);
  canvas.height = Math.max(1, box.height * ratio);
  const c = canvas.getContext("2d"), { width, height } = canvas, now = Date.now() / 1000;
  c.font = `${11 * ratio}px system-ui, sans-serif`;
  c.textBaseline = "middle";
  if (!stages.length) {
    c.fillStyle = paper.text;
    c.fillText("no command yet", 4, height / 2);
    return;
  }
  const last = stages[stages.length - 1];
  const end = last.ended ?? now;
  const begin = Math.max(Math.min(stages[0].begun, end - LEAST_S), end - MOST_S);
  const x = (t) => ((t - begin) / (end - begin)) * width;
  let command = null, shade = 0;
  for (const stage of stages) {
    if ((stage.ended ?? now) < begin) continue;
    const x0 = Math.max(x(stage.begun), 0), x1 = Math.max(x(stage.ended ?? now), x0 + ratio);
    shade = (shade + 1) % 2;
    c.fillStyle = paper.bar[shade];
    c.fillRect(x0, 18 * ratio, x1 - x0, height - 20 * ratio);
    c.fillStyle = paper.text;
    if (stage.command !== command) {
      command = stage.command;
      c.fillText(command, x0 + 2, 9 * ratio);
    }
    const seconds = (stage.ended ?? now) - stage.begun, text = `${stage.name} ${seconds.toFixed(0)} s`;
    if (c.measureText(text).width < x1 - x0 - 6) c.fillText(text, x0 + 4, (height + 16 * ratio) / 2);
  }
}
