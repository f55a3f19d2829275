"use strict";
/* The scene player, part 3: where metres fall on a canvas, and how people move about in it. */
(() => {
  const player = window.ChallengerPlayer;
  const NEAREST_M = 6, FARTHEST_M = 160, FIRST_M = 32;
  const NUDGE_PX = 40;

  /** A canvas over the ground around the ego. */
  class GroundView {
    /** @param {HTMLCanvasElement} canvas @param {*} scene Decoded. @param {() => void} redraw Asks for a new drawing.
     * @param {boolean} [steered] Whether pointer and wheel move it. */
    constructor(canvas, scene, redraw, steered = true) {
      Object.assign(this, { canvas, scene, redraw, extent: FIRST_M, pan: [0, 0], headingUp: true, theme: "light" });
      this.context = canvas.getContext("2d", { alpha: false });
      this.pointers = new Map();
      this.stop = new AbortController();
      if (steered) this.listen();
      this.resized = new ResizeObserver(() => redraw());
      this.resized.observe(canvas);
    }

    destroy() {
      this.stop.abort();
      this.resized.disconnect();
    }

    /** @param {number} factor Above 1 shows less. @param {[number, number]} [at] What stays in place, pixels. */
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

    /** @param {number} x @param {number} y In steps of `NUDGE_PX`. */
    nudge(x, y) {
      this.pan = [this.pan[0] + NUDGE_PX * x, this.pan[1] + NUDGE_PX * y];
      this.redraw();
    }

    /** How far down the canvas the ego is: with its heading up, what is ahead matters more. */
    share() {
      return this.headingUp ? 0.62 : 0.5;
    }

    listen() {
      const { canvas, pointers } = this;
      const signal = this.stop.signal;
      const place = (event) => [event.offsetX, event.offsetY];
      canvas.addEventListener("wheel", (event) => {
        event.preventDefault();
        this.zoom(Math.exp(-event.deltaY * (event.deltaMode ? 0.05 : 0.0015)), place(event));
      }, { signal, passive: false });
      canvas.addEventListener("pointerdown", (event) => {
        pointers.set(event.pointerId, place(event));
        canvas.setPointerCapture(event.pointerId);
      }, { signal });
      canvas.addEventListener("pointermove", (event) => {
        const before = pointers.get(event.pointerId);
        if (!before) return;
        const now = place(event);
        const other = [...pointers].find(([id]) => id !== event.pointerId)?.[1];
        if (other) {
          const distance = (point) => Math.max(Math.hypot(point[0] - other[0], point[1] - other[1]), 1);
          this.zoom(distance(now) / distance(before), [(now[0] + other[0]) / 2, (now[1] + other[1]) / 2]);
        } else {
          this.pan = [this.pan[0] + now[0] - before[0], this.pan[1] + now[1] - before[1]];
          this.redraw();
        }
        pointers.set(event.pointerId, now);
      }, { signal });
      for (const name of ["pointerup", "pointercancel"]) {
        canvas.addEventListener(name, (event) => pointers.delete(event.pointerId), { signal });
      }
      canvas.addEventListener("dblclick", () => this.reset(), { signal });
    }

    /** @returns {boolean} Whether there is anything to draw on. */
    fit() {
      const { canvas } = this;
      const [width, height] = [canvas.clientWidth, canvas.clientHeight];
      if (!width || !height) return false;
      this.ratio = Math.min(window.devicePixelRatio || 1, 2);
      const [wide, high] = [Math.round(width * this.ratio), Math.round(height * this.ratio)];
      if (canvas.width !== wide || canvas.height !== high) Object.assign(canvas, { width: wide, height: high });
      Object.assign(this, { width, height });
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
      this.matrix = [sin, -cos, -cos, -sin, left - sin * x + cos * y, top + cos * x + sin * y];
      const [a, b, c, d, e, f] = this.matrix;
      const determinant = a * d - b * c;
      const [dx, dy] = [this.width / 2 - e, this.height / 2 - f];
      this.middle = [(d * dx - c * dy) / determinant, (a * dy - b * dx) / determinant];
      this.radius = Math.hypot(this.width, this.height) / 2 / this.scale;
    }

    /** @returns {[number, number]} Pixels of a point in metres. */
    pixel(x, y) {
      const [a, b, c, d, e, f] = this.matrix;
      return [a * x + c * y + e, b * x + d * y + f];
    }

    /** @returns {boolean} Whether something of this reach is on the canvas. */
    sees(x, y, reach) {
      const limit = this.radius + reach;
      return (x - this.middle[0]) ** 2 + (y - this.middle[1]) ** 2 <= limit * limit;
    }
  }

  Object.assign(player, { GroundView });
})();
