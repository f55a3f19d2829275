"use strict";
/* The scene player: where metres fall on a canvas, how people move about in it, and how things are drawn there. */

const NEAREST_M = 6, FARTHEST_M = 160, FIRST_M = 32;
const NUDGE_PX = 40, ZOOM = 1.3;
/** @param {number} size */
const FONT = (size) => `600 ${size}px system-ui, "Liberation Sans", sans-serif`;

/** A canvas over the ground around the ego. */
class GroundView {
  pan = [0, 0];
  headingUp = true;
  width = 0;
  height = 0;
  ratio = 1;
  /** Pixels of a metre. */
  scale = 1;
  matrix = [1, 0, 0, 1, 0, 0];
  colours = THEMES.light;
  stop = new AbortController();

  /** @param {HTMLCanvasElement} canvas @param {Scene} scene @param {() => void} redraw Asks for a new drawing.
   * @param {boolean} steered Whether pointer and wheel move it. @param {number} extent Metres to its nearer edge. */
  constructor(canvas, scene, redraw, steered, extent) {
    this.canvas = canvas;
    this.scene = scene;
    this.redraw = redraw;
    this.extent = extent;
    this.context = contextOf(canvas, { alpha: false });
    if (steered) this.listen();
    this.resized = new ResizeObserver(() => redraw());
    this.resized.observe(canvas);
  }

  destroy() {
    this.stop.abort();
    this.resized.disconnect();
  }

  /** @param {number} factor Above 1 shows less. @param {number[]} [at] What stays in place, pixels. */
  zoom(factor, at) {
    const before = this.extent;
    this.extent = Math.min(Math.max(before / factor, NEAREST_M), FARTHEST_M);
    const ratio = before / this.extent;
    const { clientWidth, clientHeight } = this.canvas;
    const [x, y] = at ? [at[0] - clientWidth / 2, at[1] - clientHeight * this.share()] : [0, 0];
    this.pan = [x - (x - this.pan[0]) * ratio, y - (y - this.pan[1]) * ratio];
    this.redraw();
  }

  reset() {
    this.extent = FIRST_M;
    this.pan = [0, 0];
    this.redraw();
  }

  /** @param {number} x @param {number} y Pixels. */
  move(x, y) {
    this.pan = [this.pan[0] + x, this.pan[1] + y];
    this.redraw();
  }

  /** How far down the canvas the ego is: with its heading up, what is ahead matters more. */
  share = () => (this.headingUp ? 0.62 : 0.5);

  listen() {
    const { canvas } = this;
    const { signal } = this.stop;
    canvas.addEventListener("wheel", (event) => {
      event.preventDefault();
      this.zoom(Math.exp(-event.deltaY * (event.deltaMode ? 0.05 : 0.0015)), [event.offsetX, event.offsetY]);
    }, { signal, passive: false });
    let [x, y] = [0, 0];
    canvas.addEventListener("pointerdown", ({ pointerId, isPrimary, offsetX, offsetY }) => {
      if (isPrimary) canvas.setPointerCapture(pointerId);
      if (isPrimary) [x, y] = [offsetX, offsetY];
    }, { signal });
    canvas.addEventListener("pointermove", ({ pointerId, offsetX, offsetY }) => {
      if (!canvas.hasPointerCapture(pointerId)) return;
      this.move(offsetX - x, offsetY - y);
      [x, y] = [offsetX, offsetY];
    }, { signal });
    canvas.addEventListener("dblclick", () => this.reset(), { signal });
  }

  /** @returns {boolean} Whether there is anything to draw on. */
  fit() {
    const { clientWidth: width, clientHeight: height } = this.canvas;
    if (!width || !height) return false;
    this.ratio = fitCanvas(this.canvas, height);
    Object.assign(this, { width, height, colours: THEMES[theme()] });
    return true;
  }

  /** @param {number} frame Puts the ego of this frame where it belongs on the canvas. */
  place(frame) {
    const { ego } = this.scene;
    const [x, y, yaw] = ego ? [ego.x[frame], ego.y[frame], ego.yaw[frame]] : [0, 0, 0];
    const angle = this.headingUp ? yaw : Math.PI / 2;
    this.scale = Math.min(this.width, this.height) / (2 * this.extent);
    const [sin, cos] = [this.scale * Math.sin(angle), this.scale * Math.cos(angle)];
    const [left, top] = [this.width / 2 + this.pan[0], this.height * this.share() + this.pan[1]];
    const [e, f] = [left - sin * x + cos * y, top + cos * x + sin * y];
    this.matrix = [sin, -cos, -cos, -sin, e, f];
  }

  /** @param {number} x @param {number} y Metres. @returns {[number, number]} Pixels. */
  pixel(x, y) {
    const [a, b, c, d, e, f] = this.matrix;
    return [a * x + c * y + e, b * x + d * y + f];
  }

  /** @param {() => void} draw @param {number} alpha Draws fainter. */
  faintly(alpha, draw) {
    const { context } = this;
    const before = context.globalAlpha;
    context.globalAlpha = alpha * before;
    draw();
    context.globalAlpha = before;
  }

  /** @param {string} colour Fills the path. */
  paint(colour) {
    this.context.fillStyle = colour;
    this.context.fill();
  }

  /** @param {string} colour @param {number} width @param {number[]} dash Strokes the path. */
  stroke(colour, width = 1, dash = /** @type {number[]} */ ([])) {
    const { context } = this;
    context.strokeStyle = colour;
    context.lineWidth = width;
    context.lineJoin = "round";
    context.setLineDash(dash);
    context.stroke();
    context.setLineDash([]);
  }

  /** @param {ArrayLike<number>} points Metres, x and y in turn. @param {string} colour @param {number} width */
  line(points, colour, width, dash = /** @type {number[]} */ ([])) {
    if (points.length < 4) return;
    this.context.beginPath();
    traceLine(this.context, points, (x, y) => this.pixel(x, y));
    this.stroke(colour, width, dash);
  }

  /** @param {ArrayLike<number>} points @param {string} shape @param {number} size @param {string} colour */
  marks(points, shape, size, colour, hollow = false) {
    if (!points.length) return;
    const { context, colours } = this;
    context.beginPath();
    for (let at = 0; at < points.length; at += 2) {
      traceShape(context, shape, ...this.pixel(points[at], points[at + 1]), size);
    }
    this.paint(hollow ? colours.paper : colour);
    this.stroke(hollow ? colour : colours.paper);
  }

  /** @param {Box} box @returns {(along: number, aside: number) => [number, number]} Pixels, by shares of its sides. */
  inBox({ x, y, yaw, length, width }) {
    const [cos, sin] = [Math.cos(yaw), Math.sin(yaw)];
    return (along, aside) => this.pixel(x + along * length * cos - aside * width * sin,
      y + along * length * sin + aside * width * cos);
  }

  /** @param {Box[]} boxes Begins a path of their outlines. */
  trace(boxes) {
    const { context } = this;
    context.beginPath();
    for (const box of boxes) {
      traceLine(context, [0.5, 0.5, -0.5, 0.5, -0.5, -0.5, 0.5, -0.5], this.inBox(box));
      context.closePath();
    }
  }

  /** @param {Box[]} boxes @param {string} colour @param {boolean} noses A light wedge at the front of each.
   * @param {number} edge How wide their outlines in ink are. */
  boxes(boxes, colour, noses, edge = 0) {
    const { context, colours } = this;
    this.trace(boxes);
    this.paint(colour);
    if (edge) this.stroke(colours.ink, edge);
    else if (this.scale >= 4) this.stroke(colours.paper);
    if (!noses || this.scale < 4) return;
    context.beginPath();
    for (const box of boxes) traceLine(context, [0.2, 0.3, 0.42, 0, 0.2, -0.3], this.inBox(box));
    this.stroke(colours.paper);
  }

  /** @param {string} text @param {number} x @param {number} y @param {number} size @param {string} colour
   * @param {boolean} plate Whether there is paper behind it; without, it is centred. */
  write(text, x, y, size, colour, plate = false) {
    const { context, colours } = this;
    context.font = FONT(size);
    context.textAlign = plate ? "left" : "center";
    context.textBaseline = "middle";
    if (plate) {
      context.fillStyle = colours.paper;
      const { width } = context.measureText(text);
      this.faintly(0.85, () => context.fillRect(x - 3, y - size * 0.65, width + 6, size * 1.3));
    }
    context.fillStyle = colour;
    context.fillText(text, x, y);
  }
}

/** @param {HTMLCanvasElement} canvas @param {number} height As it is shown. @returns {number} Its pixels to one shown. */
function fitCanvas(canvas, height) {
  const ratio = Math.min(window.devicePixelRatio || 1, 2);
  const [wide, high] = [Math.round(canvas.clientWidth * ratio), Math.round(height * ratio)];
  if (canvas.width !== wide || canvas.height !== high) Object.assign(canvas, { width: wide, height: high });
  return ratio;
}
