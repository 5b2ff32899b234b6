// The focal plane: where arms are, by the layout and the angles. Lengths in mm, angles in deg or rad by name.

const RAD = Math.PI / 180;

export class Plane {
  constructor(about) {
    Object.assign(this, about);
    this.n = about.positioner_id.length;
    this.row = new Map(about.positioner_id.map((id, row) => [id, row]));
    this.angles = new Float32Array(2 * this.n).fill(NaN);
    this.code = Object.fromEntries(about.states.map((name, code) => [name, code]));
    const x = about.centres_mm.map((c) => c[0]), y = about.centres_mm.map((c) => c[1]);
    const reach = Math.max(...about.reach_mm);
    this.bounds = [Math.min(...x) - reach, Math.min(...y) - reach, Math.max(...x) + reach, Math.max(...y) + reach];
  }

  // elbow, ends of the beta arm's capsule, and the metrology fibre of one row; [] where its angles are not known
  arm(row, angles = this.angles) {
    const alpha = angles[row], beta = angles[this.n + row];
    if (!(Number.isFinite(alpha) && Number.isFinite(beta))) return [];
    const [cx, cy] = this.centres_mm[row];
    const first = alpha * RAD + this.alpha_off_rad[row];
    const ex = cx + this.l_alpha_mm[row] * Math.cos(first), ey = cy + this.l_alpha_mm[row] * Math.sin(first);
    const second = first + beta * RAD + this.beta_off_rad[row];
    const c = Math.cos(second), s = Math.sin(second);
    const [near, far] = this.beta_segment_mm, [tx, ty] = this.tip_mm[row];
    return [ex, ey, ex + near * c, ey + near * s, ex + far * c, ey + far * s, ex + tx * c - ty * s, ey + tx * s + ty * c];
  }

  // the row whose fibre, or axis, is nearest to a point
  nearest(x, y) {
    let best = -1, least = Infinity;
    for (let row = 0; row < this.n; row++) {
      const arm = this.arm(row), [cx, cy] = this.centres_mm[row];
      const tip = arm.length ? Math.hypot(arm[6] - x, arm[7] - y) : Infinity;
      const away = Math.min(tip, Math.hypot(cx - x, cy - y));
      if (away < least) [best, least] = [row, away];
    }
    return least < 12 ? best : -1;
  }
}

// "FLP1", number, N, time in the plan; then N alpha, N beta (float32, deg), N states
export function readPicture(buffer, n) {
  const head = new DataView(buffer);
  if (head.getUint32(0, false) !== 0x464c5031 || head.getUint32(8, true) !== n) return null;
  return {
    time_s: head.getFloat32(12, true),
    angles: new Float32Array(buffer, 16, 2 * n),
    states: new Uint8Array(buffer, 16 + 8 * n, n),
  };
}

// step in s, T, N; then T x N pairs of alpha and beta
export function readPlan(buffer) {
  if (buffer.byteLength < 12) return null;
  const head = new DataView(buffer);
  const step_s = head.getFloat32(0, true), steps = head.getUint32(4, true), n = head.getUint32(8, true);
  const samples = new Float32Array(buffer, 12, 2 * steps * n);
  const moves = new Uint8Array(n);
  for (let k = 1; k < steps; k++)
    for (let i = 0; i < n; i++) {
      const a = 2 * (k * n + i), b = a - 2 * n;
      if (samples[a] !== samples[b] || samples[a + 1] !== samples[b + 1]) moves[i] = 1;
    }
  return { step_s, steps, n, samples, moves, duration_s: step_s * (steps - 1) };
}

// all angles of a plan at one time, as N alpha and N beta
export function anglesAt(plan, time_s) {
  const place = Math.min(Math.max(time_s / plan.step_s, 0), plan.steps - 1);
  const k = Math.min(Math.floor(place), plan.steps - 2), part = place - k, n = plan.n;
  const out = new Float32Array(2 * n), s = plan.samples;
  for (let i = 0; i < n; i++) {
    const a = 2 * (k * n + i), b = a + 2 * n;
    out[i] = (1 - part) * s[a] + part * s[b];
    out[n + i] = (1 - part) * s[a + 1] + part * s[b + 1];
  }
  return out;
}
