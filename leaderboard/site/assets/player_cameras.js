"use strict";
/* The scene player: pictures of the cameras, with the adversaries' boxes. */

/** Pictures around the present one that are loaded before they are needed. */
const AROUND = 24;
/** Pictures from the present one on without which nothing plays. */
const SOON = 6;

/** Shows the picture in force of all cameras or of one; loads those around it before they are needed. */
class Cameras {
  camera = /** @type {Scene["cameras"][0]|null} */ (null);
  /** Place of the picture that is shown. */
  at = -1;
  images = /** @type {Map<number, HTMLImageElement>} */ (new Map());

  /** @param {HTMLCanvasElement} canvas @param {Scene} scene */
  constructor(canvas, scene) {
    this.canvas = canvas;
    this.scene = scene;
    this.context = contextOf(canvas);
    this.size = scene.cameras.reduce(([wide, high], { left, top, width, height }) =>
      [Math.max(wide, left + width), Math.max(high, top + height)], [0, 0]);
    this.resized = new ResizeObserver(() => this.paint());
    this.resized.observe(canvas);
    this.choose(null);
  }

  destroy() {
    this.resized.disconnect();
    this.images.clear();
  }

  /** @param {string|null} name Null for all. The canvas has the shape of what it shows. */
  choose(name) {
    this.camera = this.scene.cameras.find((each) => each.name === name) ?? null;
    const { width, height } = this.shown();
    this.canvas.style.aspectRatio = `${width} / ${height}`;
    this.paint();
  }

  /** Part of the picture. */
  shown() {
    return this.camera ?? { left: 0, top: 0, width: this.size[0], height: this.size[1] };
  }

  /** @param {number} x @param {number} y Pixels of the canvas. @returns {string|null} The camera that is there. */
  cameraAt(x, y) {
    const scale = this.size[0] / this.canvas.clientWidth;
    const found = this.scene.cameras.find(({ left, top, width, height }) => x * scale >= left && x * scale < left + width
      && y * scale >= top && y * scale < top + height);
    return found?.name ?? null;
  }

  /** @param {number} frame Shows the last picture that is not newer; the first if all are. */
  show(frame) {
    const { pictures } = this.scene;
    const at = Math.max(pictures.findLastIndex((each) => each <= frame), 0);
    if (at === this.at) return;
    this.at = at;
    this.canvas.dataset.frame = String(pictures[at]);
    // Those around it are loaded, the nearest first; those far away are forgotten.
    for (const each of [...pictures.keys()].sort((a, b) => Math.abs(a - at) - Math.abs(b - at)).slice(0, AROUND)) {
      if (!this.images.has(each)) this.load(each);
    }
    for (const each of this.images.keys()) if (Math.abs(each - at) > AROUND) this.images.delete(each);
    this.paint();
  }

  /** @returns {boolean} Whether pictures that are shown soon are still loading; a missing one is not waited for. */
  loading = () => Array.from({ length: SOON }, (_, ahead) => this.images.get(this.at + ahead))
    .some((image) => image && !image.complete);

  /** @param {number} at */
  load(at) {
    const image = new Image();
    this.images.set(at, image);
    image.src = `${this.scene.media}${String(this.scene.pictures[at]).padStart(6, "0")}.webp`;
    // Decoded now, it need not be when it is drawn.
    image.decode().catch(() => {}).then(() => { if (at === this.at) this.paint(); });
  }

  paint() {
    const { canvas, context } = this;
    if (this.at < 0 || !canvas.clientWidth) return;
    const { left, top, width, height } = this.shown();
    const ratio = fitCanvas(canvas, canvas.clientWidth * height / width);
    const image = this.images.get(this.at);
    context.setTransform(1, 0, 0, 1, 0, 0);
    // The picture before stays until this one is there.
    if (!image?.complete) return;
    canvas.title = image.naturalWidth ? "" : "This picture is missing.";
    if (!image.naturalWidth) return context.clearRect(0, 0, canvas.width, canvas.height);
    // Enlarged, a picture has fewer pixels than the screen.
    context.imageSmoothingQuality = "high";
    context.drawImage(image, left, top, width, height, 0, 0, canvas.width, canvas.height);
    const scale = canvas.width / width;
    context.setTransform(scale, 0, 0, scale, -left * scale, -top * scale);
    this.paintEdges(scale / ratio);
    this.paintNames(scale / ratio);
  }

  /** @param {number} scale Pixels of the screen to one of the picture. */
  paintEdges(scale) {
    const { context, scene } = this;
    context.beginPath();
    for (const flat of Object.values(scene.edges[scene.pictures[this.at]] ?? {})) {
      for (let at = 0; at < flat.length; at += 4) traceLine(context, flat.slice(at, at + 4));
    }
    for (const [width, colour] of [[3.4, THEMES[theme()].paper], [1.6, ADVERSARY]]) {
      Object.assign(context, { lineWidth: Number(width) / scale, strokeStyle: colour });
      context.stroke();
    }
  }

  /** @param {number} scale */
  paintNames(scale) {
    const { context } = this;
    const size = 10.5 / scale;
    context.font = FONT(size);
    context.textBaseline = "top";
    for (const { name, left, top } of this.scene.cameras) {
      const words = name.replace(/^CAM_/, "").replaceAll("_", " ").toLowerCase();
      context.fillStyle = "rgba(0, 0, 0, .55)";
      context.fillRect(left, top, context.measureText(words).width + size, size * 1.5);
      context.fillStyle = "#ffffff";
      context.fillText(words, left + size / 2, top + size / 4);
    }
  }
}
