"use strict";
/* The scene player: where metres fall on a canvas, how people move about in it, and how things are drawn there. */

const NEAREST_M = 6, FARTHEST_M = 160, FIRST_M = 32;
const NUDGE_PX = 40;
/** @param {number} size */
const FONT = (size) => `600 ${size}px system-ui, "Liberation Sans", sans-serif`;

/** A canvas over the ground around the ego. */
class GroundView {
  extent = FIRST_M;
  pan = [0, 0];
  headingUp = true;
  width = 0;
  height = 0;
  ratio = 1;
  /** Pixels of a metre. */
  scale = 1;
  matrix = [1, 0, 0, 1, 0, 0];
  /** What is in the middle, and how far it is to the corners, metres. */
  middle = [0, 0];
  radius = 0;
  colours = THEMES.light;
  stop = new AbortController();

  /** @param {HTMLCanvasElement} canvas @param {Scene} scene @param {() => void} redraw Asks for a new drawing.
   * @param {boolean} steered Whether pointer and wheel move it. */
  constructor(canvas, scene, redraw, steered) {
    this.canvas = canvas;
    this.scene = scene;
    this.redraw = redraw;
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
  share() {
    return this.headingUp ? 0.62 : 0.5;
  }

  listen() {
    const { canvas } = this;
    const { signal } = this.stop;
    /** @type {Map<number, number[]>} */
    const pointers = new Map();
    canvas.addEventListener("wheel", (event) => {
      event.preventDefault();
      this.zoom(Math.exp(-event.deltaY * (event.deltaMode ? 0.05 : 0.0015)), [event.offsetX, event.offsetY]);
    }, { signal, passive: false });
    canvas.addEventListener("pointerdown", (event) => {
      pointers.set(event.pointerId, [event.offsetX, event.offsetY]);
      canvas.setPointerCapture(event.pointerId);
    }, { signal });
    canvas.addEventListener("pointermove", ({ pointerId, offsetX, offsetY }) => {
      const before = pointers.get(pointerId);
      if (!before) return;
      const other = [...pointers].find(([id]) => id !== pointerId)?.[1];
      if (other) {
        /** @param {number} x @param {number} y */
        const distance = (x, y) => Math.max(Math.hypot(x - other[0], y - other[1]), 1);
        this.zoom(distance(offsetX, offsetY) / distance(before[0], before[1]),
          [(offsetX + other[0]) / 2, (offsetY + other[1]) / 2]);
      } else this.move(offsetX - before[0], offsetY - before[1]);
      pointers.set(pointerId, [offsetX, offsetY]);
    }, { signal });
    for (const name of /** @type {const} */ (["pointerup", "pointercancel"])) {
      canvas.addEventListener(name, (event) => pointers.delete(event.pointerId), { signal });
    }
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
    const [dx, dy] = [this.width / 2 - e, this.height / 2 - f].map((pixels) => pixels / this.scale ** 2);
    this.middle = [sin * dx - cos * dy, -cos * dx - sin * dy];
    this.radius = Math.hypot(this.width, this.height) / 2 / this.scale;
  }

  /** @param {number} x @param {number} y Metres. @returns {[number, number]} Pixels. */
  pixel(x, y) {
    const [a, b, c, d, e, f] = this.matrix;
    return [a * x + c * y + e, b * x + d * y + f];
  }

  /** @param {number} x @param {number} y @param {number} reach @returns {boolean} Whether it is on the canvas. */
  sees(x, y, reach) {
    return Math.hypot(x - this.middle[0], y - this.middle[1]) <= this.radius + reach;
  }

  /** @param {() => void} draw @param {number} alpha Draws fainter. */
  faintly(alpha, draw) {
    const { context } = this;
    const before = context.globalAlpha;
    context.globalAlpha = alpha * before;
    draw();
    context.globalAlpha = before;
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
    for (let at = 0; at < points.length; at += 2) {
      const [x, y] = this.pixel(points[at], points[at + 1]);
      if (at) this.context.lineTo(x, y);
      else this.context.moveTo(x, y);
    }
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
    context.fillStyle = hollow ? colours.paper : colour;
    context.fill();
    this.stroke(hollow ? colour : colours.paper);
  }

  /** @param {Box[]} boxes Begins a path of their outlines. */
  trace(boxes) {
    const { context } = this;
    context.beginPath();
    for (const { x, y, yaw, length, width } of boxes) {
      const [ax, ay] = [length / 2 * Math.cos(yaw), length / 2 * Math.sin(yaw)];
      const [lx, ly] = [-width / 2 * Math.sin(yaw), width / 2 * Math.cos(yaw)];
      context.moveTo(...this.pixel(x + ax + lx, y + ay + ly));
      context.lineTo(...this.pixel(x - ax + lx, y - ay + ly));
      context.lineTo(...this.pixel(x - ax - lx, y - ay - ly));
      context.lineTo(...this.pixel(x + ax - lx, y + ay - ly));
      context.closePath();
    }
  }

  /** @param {Box[]} boxes @param {string} colour @param {boolean} noses A light wedge at the front of each. */
  boxes(boxes, colour, noses) {
    if (!boxes.length) return;
    const { context, colours } = this;
    this.trace(boxes);
    context.fillStyle = colour;
    context.fill();
    if (this.scale < 4) return;
    this.stroke(colours.paper);
    if (!noses) return;
    context.beginPath();
    for (const { x, y, yaw, length, width } of boxes) {
      const [cos, sin] = [Math.cos(yaw), Math.sin(yaw)];
      const [bx, by] = [x + 0.2 * length * cos, y + 0.2 * length * sin];
      context.moveTo(...this.pixel(bx - 0.3 * width * sin, by + 0.3 * width * cos));
      context.lineTo(...this.pixel(x + 0.42 * length * cos, y + 0.42 * length * sin));
      context.lineTo(...this.pixel(bx + 0.3 * width * sin, by - 0.3 * width * cos));
    }
    context.stroke();
  }

  /** @param {string} text @param {number} x @param {number} y @param {number} size @param {string} colour
   * @param {number} plate How wide the paper behind it is; without one it is centred. */
  write(text, x, y, size, colour, plate = 0) {
    const { context, colours } = this;
    context.font = FONT(size);
    context.textAlign = plate ? "left" : "center";
    context.textBaseline = "middle";
    if (plate) {
      context.fillStyle = colours.paper;
      this.faintly(0.85, () => context.fillRect(x - 3, y - size * 0.65, plate + 6, size * 1.3));
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
