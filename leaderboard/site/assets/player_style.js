"use strict";
/* The scene player, part 2: colours, line patterns and shapes; nothing is told apart by colour alone. */
(() => {
  const player = window.ChallengerPlayer;
  const TAU = 2 * Math.PI;

  /** One colour for adversaries, in the light and in the dark: benchmark/report/palette.py. */
  const ADVERSARY = "#d54a00";
  /** Colours of benchmark/report/palette.py on paper, and their like on black. */
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
  const SHAPES = ["circle", "square", "triangle", "diamond", "star", "cross", "wedge", "pentagon", "hourglass", "hexagon"];

  /**
   * How the planner at a place of the list is drawn, everywhere.
   * @param {number} place @param {string} theme @returns {{colour: string, dash: number[], shape: string}}
   */
  function styleOf(place, theme) {
    const colours = COLOURS[theme];
    const at = (list) => list[place % list.length];
    return { colour: at(colours), dash: at(DASHES), shape: at(SHAPES) };
  }

  /** @param {number} corners @param {number} turn @param {number} inner @returns {[number, number][]} On a unit circle. */
  const star = (corners, turn, inner = 1) => Array.from({ length: inner < 1 ? 2 * corners : corners }, (_, at) => {
    const [angle, radius] = [turn + TAU * at / (inner < 1 ? 2 * corners : corners), inner < 1 && at % 2 ? inner : 1];
    return [radius * Math.cos(angle), radius * Math.sin(angle)];
  });
  const UP = -Math.PI / 2;
  /** @type {Object<string, [number, number][]>} */
  const OUTLINES = {
    square: star(4, Math.PI / 4), triangle: star(3, UP), diamond: star(4, UP), star: star(5, UP, 0.45),
    cross: [[-.35, -1], [.35, -1], [.35, -.35], [1, -.35], [1, .35], [.35, .35], [.35, 1], [-.35, 1], [-.35, .35],
      [-1, .35], [-1, -.35], [-.35, -.35]],
    pentagon: star(5, UP), hourglass: [[-1, -1], [1, -1], [-1, 1], [1, 1]], wedge: star(3, -UP), hexagon: star(6, 0),
  };

  /** @param {CanvasRenderingContext2D} context @param {string} shape @param {number} x @param {number} y @param {number} size */
  function traceShape(context, shape, x, y, size) {
    const outline = OUTLINES[shape];
    if (!outline) {
      context.moveTo(x + size, y);
      context.arc(x, y, size, 0, TAU);
      return;
    }
    for (const [at, [dx, dy]] of outline.entries()) {
      if (at) context.lineTo(x + size * dx, y + size * dy);
      else context.moveTo(x + size * dx, y + size * dy);
    }
    context.closePath();
  }

  /** @param {string} name @returns {string} Short enough for a canvas. */
  function cut(name) {
    const letters = [...name];
    return letters.length > 24 ? `${letters.slice(0, 23).join("")}…` : name;
  }

  Object.assign(player, { THEMES, styleOf, star, traceShape, cut });
})();
