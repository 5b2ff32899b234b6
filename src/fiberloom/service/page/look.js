// How states look: a colour (Okabe and Ito's palette, told apart by the colour-blind) and a shape of its own each.

export const SHAPES = {
  unknown: "ring", on_target: "disc", off_target: "square", blocked: "triangle", parked: "dot", dark: "moon",
  lying: "cross", astray: "star", unsure: "question", disconnected: "bar", dead: "diamond", offline: "minus",
  collided: "burst", excluded: "stop",
};

const WELL = ["unknown", "on_target", "off_target", "parked", "excluded", "offline"];

// somebody has to look at it
export const isFault = (name) => !WELL.includes(name);

const DARK = {
  unknown: "#8793a3", on_target: "#2fc7a0", off_target: "#e69f00", blocked: "#56b4e9", parked: "#8793a3",
  dark: "#cc79a7", lying: "#ff6a3d", astray: "#ff6a3d", unsure: "#f0e442", disconnected: "#4f9be0",
  dead: "#ff6a3d", offline: "#5f6b7a", collided: "#ff3b30", excluded: "#6d7887",
};
const LIGHT = {
  ...DARK, on_target: "#007a5a", off_target: "#b06f00", blocked: "#0072b2", unknown: "#6b7684", parked: "#6b7684",
  dark: "#a0447a", lying: "#b83200", astray: "#b83200", unsure: "#7d7400", dead: "#b83200", disconnected: "#0057a3",
};
const RED = Object.fromEntries(Object.keys(DARK).map((s) => [s, "#c03a2e"]));
Object.assign(RED, { on_target: "#ff6a58", off_target: "#ff9a86", collided: "#ffb8a8", lying: "#ff9a86",
  astray: "#ff9a86", dead: "#ff9a86", excluded: "#a83428", offline: "#a83428", parked: "#b0382c" });

const PAPER = {
  dark: { back: "#12161c", base: "#2a333f", fixed: "#3d4959", text: "#e4e9f0", target: "#e4e9f0", error: "#f0e442", chosen: "#ffffff", alpha: "#46525f", bar: ["#38688c", "#37705a"] },
  light: { back: "#f7f8fa", base: "#e2e7ee", fixed: "#b9c3cf", text: "#16202c", target: "#16202c", error: "#8a4b00", chosen: "#000000", alpha: "#aab5c2", bar: ["#8fbfe0", "#9fd3bf"] },
  red: { back: "#0b0000", base: "#240606", fixed: "#4a1010", text: "#ff5a4a", target: "#ff8a7a", error: "#ffc0b0", chosen: "#ffd8d0", alpha: "#541512", bar: ["#4a120e", "#50150f"] },
};

export function lookOf(theme) {
  return { colours: { dark: DARK, light: LIGHT, red: RED }[theme], paper: PAPER[theme] };
}

export function shape(context, name, x, y, r) {
  const c = context;
  const polygon = (...points) => {
    points.forEach(([px, py], k) => (k ? c.lineTo(x + r * px, y + r * py) : c.moveTo(x + r * px, y + r * py)));
    c.closePath();
  };
  const strokes = (...lines) => lines.forEach(([ax, ay, bx, by]) => { c.moveTo(x + r * ax, y + r * ay); c.lineTo(x + r * bx, y + r * by); });
  const circle = (s) => { c.moveTo(x + s * r, y); c.arc(x, y, s * r, 0, 2 * Math.PI); };
  switch (SHAPES[name]) {
    case "disc": circle(1); return true;
    case "dot": circle(0.55); return true;
    case "square": polygon([-0.9, -0.9], [0.9, -0.9], [0.9, 0.9], [-0.9, 0.9]); return true;
    case "triangle": polygon([0, -1.1], [1, 0.8], [-1, 0.8]); return true;
    case "diamond": polygon([0, -1.2], [1.2, 0], [0, 1.2], [-1.2, 0]); return true;
    case "moon": c.moveTo(x, y - r); c.arc(x, y, r, -Math.PI / 2, Math.PI / 2, true); c.closePath(); return true;
    case "burst": polygon(...Array.from({ length: 16 }, (_, k) => [Math.cos(k * Math.PI / 8) * (k % 2 ? 0.7 : 1.7), Math.sin(k * Math.PI / 8) * (k % 2 ? 0.7 : 1.7)])); return true;
    case "cross": strokes([-1, -1, 1, 1], [-1, 1, 1, -1]); return false;
    case "star": strokes([-1, -1, 1, 1], [-1, 1, 1, -1], [0, -1.3, 0, 1.3]); return false;
    case "bar": strokes([0, -1.2, 0, 1.2], [-0.6, -1.2, 0.6, -1.2], [-0.6, 1.2, 0.6, 1.2]); return false;
    case "minus": strokes([-1.1, 0, 1.1, 0]); return false;
    case "stop": circle(1); strokes([-0.7, 0.7, 0.7, -0.7]); return false;
    case "question": c.moveTo(x - 0.6 * r, y - 0.5 * r); c.arc(x, y - 0.5 * r, 0.6 * r, Math.PI, 2.2 * Math.PI); strokes([0.1, 0.2, 0, 0.6]); return false;
    default: circle(0.9); return false;
  }
}
