"use strict";
/* The scene player: colours, line patterns and shapes; nothing is told apart by colour alone. */

const TAU = 2 * Math.PI;
/** One colour for adversaries, in the light and in the dark: benchmark/report/palette.py. */
const ADVERSARY = "#d54a00";
/** Colours of benchmark/report/palette.py on paper, and their like on black. @type {Record<string, Record<string, string>>} */
const THEMES = {
  light: {
    land: "#f3f2ed", road: "#cdcfd3", kerb: "#a4a6aa", walkways: "#e5dfd3", carparks: "#dadbe0", crossings: "#e9ebee",
    white: "#ffffff", yellow: "#d79a14", unpainted: "#bfc1c6", ego: "#009e73", adversary: ADVERSARY,
    vehicle: "#808ea2", cycle: "#606084", person: "#5c4a42", thing: "#aca494",
    ink: "#222428", faint: "#686c74", paper: "#ffffff", contact: "#b00020", grid: "#dddcd4",
  },
  dark: {
    land: "#191c1f", road: "#3a3e44", kerb: "#5d636b", walkways: "#2a2b2b", carparks: "#31353b", crossings: "#484d54",
    white: "#8d939b", yellow: "#a57a1c", unpainted: "#4a4f56", ego: "#1fb88b", adversary: ADVERSARY,
    vehicle: "#8796ad", cycle: "#9a9ac6", person: "#d0b3a4", thing: "#7d776b",
    ink: "#f1f3f5", faint: "#a3abb4", paper: "#101214", contact: "#ff5c77", grid: "#2a2e32",
  },
};
/** Okabe and Ito's colours without those of ego and adversary, as in benchmark/report/palette.py. */
const COLOURS = {
  light: ["#0072b2", "#cc5c9e", "#b8a000", "#000000", "#56b4e9", "#8c6d31"],
  dark: ["#4aa3df", "#e58fc0", "#dec83c", "#ffffff", "#8fd3ff", "#c9a86a"],
};
const DASHES = [[], [9, 4], [3, 4], [11, 4, 3, 4]];

/** @param {number} corners @param {number} turn @param {number} inner @returns {[number, number][]} On a unit circle. */
const star = (corners, turn, inner = 1) => Array.from({ length: inner < 1 ? 2 * corners : corners }, (_, at) => {
  const [angle, radius] = [turn + TAU * at / (inner < 1 ? 2 * corners : corners), inner < 1 && at % 2 ? inner : 1];
  return [radius * Math.cos(angle), radius * Math.sin(angle)];
});
const UP = -Math.PI / 2;
const ARM = 0.35;
/** @type {Record<string, [number, number][]>} */
const OUTLINES = {
  circle: star(24, 0), square: star(4, Math.PI / 4), triangle: star(3, UP), diamond: star(4, UP), star: star(5, UP, 0.45),
  cross: [[-ARM, -1], [ARM, -1], [ARM, -ARM], [1, -ARM], [1, ARM], [ARM, ARM], [ARM, 1], [-ARM, 1], [-ARM, ARM],
    [-1, ARM], [-1, -ARM], [-ARM, -ARM]],
  wedge: star(3, -UP), pentagon: star(5, UP), hourglass: [[-1, -1], [1, -1], [-1, 1], [1, 1]], hexagon: star(6, 0),
  contact: star(8, 0, 0.5),
};
const SHAPES = Object.keys(OUTLINES).filter((shape) => shape !== "contact");

/** How a planner is drawn, everywhere: by its place among those of the site. @param {string} name @returns {Style} */
function styleOf(name) {
  const place = Math.max(site().models.findIndex((model) => model.name === name), 0);
  const at = place % COLOURS.light.length;
  const [dash, shape] = [DASHES[place % DASHES.length], SHAPES[place % SHAPES.length]];
  return { place: at, colour: COLOURS[theme()][at], dash, shape };
}

/** @param {CanvasRenderingContext2D} context @param {string} shape @param {number} x @param {number} y @param {number} size */
function traceShape(context, shape, x, y, size) {
  traceLine(context, OUTLINES[shape].flat(), (dx, dy) => [x + size * dx, y + size * dy]);
  context.closePath();
}

/** @param {string} shape @param {Record<string, any>} attributes @returns {Element} Ten units high and wide. */
const outline = (shape, attributes = {}, x = 0, y = 0) => drawn("polygon",
  { points: OUTLINES[shape].map(([dx, dy]) => `${x + 5 * dx},${y + 5 * dy}`).join(" "), ...attributes });

/** @param {string} name @returns {Element} A piece of a planner's line. */
function swatch(name) {
  const { place, dash, shape } = styleOf(name);
  const colour = `light-dark(${COLOURS.light[place]}, ${COLOURS.dark[place]})`;
  const paint = { stroke: colour, fill: colour };
  return drawn("svg", { class: "cp-swatch", viewBox: "-13 -7 26 14", "aria-hidden": "true", ...paint },
    drawn("line", { x1: -13, x2: 13, "stroke-width": 2, "stroke-dasharray": dash.join(" ") || null }), outline(shape));
}

/** @param {HTMLCanvasElement} canvas @param {CanvasRenderingContext2DSettings} [settings] */
function contextOf(canvas, settings) {
  const context = canvas.getContext("2d", settings);
  if (!context) throw new Error("this browser draws on no canvas");
  return context;
}

const KINDS = [
  ["ego", "ego, as recorded"], ["adversary", "A: adversary"], ["vehicle", "vehicle"], ["cycle", "two-wheeler"],
  ["person", "person"], ["thing", "object"],
];

/** @param {Scene} scene @param {string[]} [kinds] To name at most. @returns {HTMLElement} Whose boxes have which colour. */
function kindLegend(scene, kinds = KINDS.map(([kind]) => kind)) {
  const there = new Set(["ego", ...scene.agents.map((agent) => (agent.adversary ? "adversary" : agent.kind))]);
  return element("div", { class: "cp-legend" }, KINDS.filter(([kind]) => there.has(kind) && kinds.includes(kind))
    .map(([kind, words]) => element("span", { class: `cp-kind cp-${kind}` },
      scene.driven && kind === "ego" ? "ego, as driven" : words)));
}
