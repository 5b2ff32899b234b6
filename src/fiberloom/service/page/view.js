// Drawing: what is still on one canvas, drawn when it changes; what moves on another one, drawn for each picture.
import { lookOf, shape } from "/page/look.js";

const ERROR_TIMES = 1000;  // error vectors are drawn so many times as long
const LONGEST_MM = 20;  // as drawn; a longer one ends with a ring
const FAR_PX = 30;  // of a reach: with fewer the field is seen from afar, and marks would hide the arms
const THIN_PX = 2.5;  // narrower lines have plain ends: round ones look the same, and cost most of the drawing

export class View {
  constructor(still, moving, model) {
    this.still = still.getContext("2d");
    this.moving = moving.getContext("2d");
    this.model = model;
    this.centre = [0, 0];
    this.scale = 1;
    this.fitted = true;
    this.theme("dark");
    this.drawn = 0;
    this.stillDrawn = 0;
    this.stale = true;
  }

  theme(name) { this.look = lookOf(name); this.stale = true; }

  resize() {
    const box = this.still.canvas.getBoundingClientRect(), ratio = window.devicePixelRatio || 1;
    for (const { canvas } of [this.still, this.moving]) {
      canvas.width = Math.max(1, Math.round(box.width * ratio));
      canvas.height = Math.max(1, Math.round(box.height * ratio));
    }
    this.ratio = ratio;
    if (this.fitted) this.fit();
    this.stale = true;
  }

  fit() {
    const plane = this.model.plane;
    if (!plane) return;
    const [x0, y0, x1, y1] = plane.bounds, { width, height } = this.still.canvas;
    this.centre = [(x0 + x1) / 2, (y0 + y1) / 2];
    this.scale = 0.96 * Math.min(width / (x1 - x0), height / (y1 - y0));
    this.fitted = true;
    this.stale = true;
  }

  show(row, zoom) {
    this.centre = [...this.model.plane.centres_mm[row]];
    if (zoom) this.scale = Math.max(this.scale, this.still.canvas.width / 160);
    this.fitted = false;
    this.stale = true;
  }

  // the field is seen from afar
  get far() { return this.scale * this.model.plane.reach_mm[0] < FAR_PX * this.ratio; }

  // of a mark, canvas pixels
  get markRadius() { return Math.min(Math.max(1.1 * this.scale, 2.2 * this.ratio), 9 * this.ratio); }

  // ends of lines that are so many canvas pixels wide
  cap(width) { return width < THIN_PX * this.ratio ? "butt" : "round"; }

  // canvas pixels of a place in mm: x to the right, y up
  px(x) { return this.still.canvas.width / 2 + this.scale * (x - this.centre[0]); }
  py(y) { return this.still.canvas.height / 2 - this.scale * (y - this.centre[1]); }

  // mm of a place on the page
  at(clientX, clientY) {
    const box = this.still.canvas.getBoundingClientRect(), { width, height } = this.still.canvas;
    return [
      this.centre[0] + ((clientX - box.left) * this.ratio - width / 2) / this.scale,
      this.centre[1] - ((clientY - box.top) * this.ratio - height / 2) / this.scale,
    ];
  }

  zoom(times, [x, y] = this.centre) {
    const before = this.scale;
    this.scale = Math.min(Math.max(before * times, 0.05), 400);
    this.centre = [x + (this.centre[0] - x) * before / this.scale, y + (this.centre[1] - y) * before / this.scale];
    this.fitted = false;
    this.stale = true;
  }

  pan(dx, dy) {
    this.centre = [this.centre[0] - dx * this.ratio / this.scale, this.centre[1] + dy * this.ratio / this.scale];
    this.fitted = false;
    this.stale = true;
  }

  draw() {
    const { model } = this;
    if (!model.plane) return;
    const moves = model.moves();
    if (this.stale || moves !== this.movesDrawn) {
      this.drawStill(moves);
      this.stale = false;
      this.movesDrawn = moves;
    }
    const c = this.moving, { width, height } = c.canvas;
    c.clearRect(0, 0, width, height);
    if (moves) this.arms(c, model.shownAngles(), (row) => moves[row]);
    this.marks(c, moves ? (row) => moves[row] : () => false);
    if (model.chosen >= 0) this.chosen(c);
    this.drawn++;
  }

  drawStill(moves) {
    const c = this.still, { width, height } = c.canvas, { plane } = this.model, { paper } = this.look;
    c.fillStyle = paper.back;
    c.fillRect(0, 0, width, height);
    c.fillStyle = paper.base;
    c.beginPath();
    for (const [x, y] of plane.centres_mm) this.disc(c, x, y, Math.min(3, plane.l_alpha_mm[0] / 2));
    c.fill();
    c.fillStyle = paper.fixed;
    c.beginPath();
    for (const [x, y, r] of plane.fiducials) this.disc(c, x, y, Math.max(r, 1));
    c.fill();
    this.capsules(c, plane.guide_cameras, paper.fixed);
    const still = moves ? (row) => !moves[row] : () => true;
    this.arms(c, this.model.shownAngles(), still);
    if (moves) this.marks(c, still, false);
    if (moves && this.far) this.targets(c, paper, this.markRadius);
    this.stillDrawn++;
  }

  disc(c, x, y, r) {
    const px = this.px(x), py = this.py(y), pr = r * this.scale;
    c.moveTo(px + pr, py);
    c.arc(px, py, pr, 0, 2 * Math.PI);
  }

  capsules(c, rows, colour) {
    c.strokeStyle = colour;
    c.lineCap = "round";
    for (const [x0, y0, x1, y1, r] of rows) {
      c.lineWidth = 2 * r * this.scale;
      c.beginPath();
      c.moveTo(this.px(x0), this.py(y0));
      c.lineTo(this.px(x1), this.py(y1));
      c.stroke();
    }
  }

  // arms as capsules, one path for a colour
  arms(c, angles, wanted) {
    const { plane, states } = this.model, { colours, paper } = this.look;
    const inSight = this.sight(plane.reach_mm[0] + 5);
    const alpha = new Path2D(), beta = new Map(), lost = new Path2D();
    for (let row = 0; row < plane.n; row++) {
      if (!wanted(row)) continue;
      const [cx, cy] = plane.centres_mm[row];
      if (!inSight(cx, cy)) continue;
      const arm = plane.arm(row, angles), name = plane.states[states[row]];
      if (!arm.length) {  // it may be anywhere within its reach
        const r = plane.reach_mm[row] * this.scale;
        lost.moveTo(this.px(cx) + r, this.py(cy));
        lost.arc(this.px(cx), this.py(cy), r, 0, 2 * Math.PI);
        continue;
      }
      alpha.moveTo(this.px(cx), this.py(cy));
      alpha.lineTo(this.px(arm[0]), this.py(arm[1]));
      if (!beta.has(name)) beta.set(name, new Path2D());
      const path = beta.get(name);
      path.moveTo(this.px(arm[2]), this.py(arm[3]));
      path.lineTo(this.px(arm[4]), this.py(arm[5]));
    }
    c.lineWidth = 1.3 * plane.buffer_mm * this.scale;
    c.lineCap = this.cap(c.lineWidth);
    c.strokeStyle = paper.alpha;
    c.stroke(alpha);
    c.lineWidth = 2 * plane.buffer_mm * this.scale;
    c.lineCap = this.cap(c.lineWidth);
    for (const [name, path] of beta) {
      c.globalAlpha = name === "excluded" || name === "offline" ? 0.35 : 0.75;
      c.strokeStyle = colours[name];
      c.stroke(path);
    }
    c.globalAlpha = 1;
    c.setLineDash([6, 5]);
    c.lineWidth = 1.5;
    c.strokeStyle = colours.unknown;
    c.stroke(lost);
    c.setLineDash([]);
  }

  // tells of a place in mm whether it is in sight, or no farther from that than so many mm
  sight(far) {
    const { width, height } = this.still.canvas, [x0, y1] = this.at0(0, 0), [x1, y0] = this.at0(width, height);
    return (x, y) => x > x0 - far && x < x1 + far && y > y0 - far && y < y1 + far;
  }

  at0(px, py) {
    const { width, height } = this.still.canvas;
    return [this.centre[0] + (px - width / 2) / this.scale, this.centre[1] - (py - height / 2) / this.scale];
  }

  // the shape of a state at each fibre; targets and errors, which do not move, once
  marks(c, wanted, all = true) {
    const { model } = this, { plane, states } = model, { colours, paper } = this.look, angles = model.shownAngles();
    const r = this.markRadius;
    if (this.far && model.moves() && all) return;  // targets are with what is still
    const paths = new Map(), moves = model.moves(), inSight = this.sight(plane.reach_mm[0] + 5);
    for (let row = 0; row < plane.n; row++) {
      if ((moves && !wanted(row)) || !inSight(...plane.centres_mm[row])) continue;
      const arm = plane.arm(row, angles);
      const [x, y] = arm.length ? [arm[6], arm[7]] : plane.centres_mm[row];
      const name = plane.states[states[row]];
      if (!paths.has(name)) paths.set(name, []);
      paths.get(name).push([this.px(x), this.py(y)]);
    }
    for (const [name, places] of paths) {
      c.beginPath();
      let filled = true;
      for (const [x, y] of places) filled = shape(c, name, x, y, r);
      c.lineWidth = Math.max(1, 0.3 * r);
      c.strokeStyle = filled ? paper.back : colours[name];
      c.fillStyle = colours[name];
      if (filled) c.fill();
      c.stroke();
    }
    if (all) this.targets(c, paper, r);
  }

  targets(c, paper, r) {
    const { seen, showErrors } = this.model;
    if (!seen.targets) return;
    c.lineCap = "butt";
    c.lineWidth = Math.max(1, 0.9 * this.ratio);
    c.strokeStyle = c.fillStyle = paper.target;
    c.beginPath();
    const dot = 1.5 * this.ratio, far = this.far, inSight = this.sight(LONGEST_MM + 5);
    for (const [x, y] of seen.targets) {
      if (x === null || !inSight(x, y)) continue;
      const px = this.px(x), py = this.py(y), s = 1.5 * r;
      if (far) { c.rect(px - dot / 2, py - dot / 2, dot, dot); continue; }
      c.moveTo(px - s, py); c.lineTo(px - s / 2, py); c.moveTo(px + s / 2, py); c.lineTo(px + s, py);
      c.moveTo(px, py - s); c.lineTo(px, py - s / 2); c.moveTo(px, py + s / 2); c.lineTo(px, py + s);
    }
    if (far) c.fill();
    else c.stroke();
    if (!showErrors || !seen.errors_um) return;
    c.strokeStyle = paper.error;
    c.lineWidth = Math.max(1.5, 1.4 * this.ratio);
    c.beginPath();
    seen.errors_um.forEach(([ex, ey], row) => {
      const [x, y] = seen.targets[row];
      if (ex === null || x === null || !inSight(x, y)) return;
      const times = ERROR_TIMES / 1000, drawn_mm = times * Math.hypot(ex, ey), part = Math.min(1, LONGEST_MM / drawn_mm);
      const tx = x + part * times * ex, ty = y + part * times * ey;
      c.moveTo(this.px(x), this.py(y));
      c.lineTo(this.px(tx), this.py(ty));
      if (part < 1) this.disc(c, tx, ty, 1.2);
    });
    c.stroke();
  }

  chosen(c) {
    const { plane, chosen } = this.model, [cx, cy] = plane.centres_mm[chosen], { paper } = this.look;
    c.strokeStyle = paper.chosen;
    c.lineWidth = 2 * this.ratio;
    c.beginPath();
    this.disc(c, cx, cy, plane.reach_mm[chosen]);
    c.stroke();
    c.fillStyle = paper.text;
    c.font = `${13 * this.ratio}px system-ui, sans-serif`;
    c.fillText(String(plane.positioner_id[chosen]), this.px(cx) + 4, this.py(cy + plane.reach_mm[chosen]) - 5);
  }
}
