"use strict";
/* The scene player, part 5: pictures of the cameras, with the adversaries' boxes. */
(() => {
  const player = window.ChallengerPlayer;
  const AHEAD = 14, BEHIND = 4, KEPT = 40;
  const COLOURS = { light: ["#ffffff", player.THEMES.light.adversary], dark: ["#000000", player.THEMES.dark.adversary] };

  /** Shows the picture in force of all cameras or of one; loads those around it before they are needed. */
  class Cameras {
    /** @param {HTMLCanvasElement} canvas @param {*} scene Decoded. */
    constructor(canvas, scene) {
      Object.assign(this, { canvas, scene, camera: null, theme: "light", at: -1, broken: new Set() });
      this.context = canvas.getContext("2d", { alpha: false });
      /** @type {Map<number, HTMLImageElement>} */
      this.images = new Map();
      this.size = [
        Math.max(...scene.cameras.map(({ left, width }) => left + width)),
        Math.max(...scene.cameras.map(({ top, height }) => top + height)),
      ];
      this.resized = new ResizeObserver(() => this.paint());
      this.resized.observe(canvas);
      this.shape();
    }

    destroy() {
      this.resized.disconnect();
      for (const image of this.images.values()) image.src = "";
      this.images.clear();
    }

    /** @param {string|null} name Null for all. @returns {boolean} Whether there is such a camera. */
    choose(name) {
      const camera = this.scene.cameras.find((each) => each.name === name) ?? null;
      this.camera = camera;
      this.shape();
      this.paint();
      return camera !== null;
    }

    /** The canvas has the shape of what it shows. */
    shape() {
      const [, , width, height] = this.shown();
      this.canvas.style.aspectRatio = `${width} / ${height}`;
    }

    /** @returns {[number, number, number, number]} Part of the picture: left, top, width, height. */
    shown() {
      const { camera } = this;
      return camera ? [camera.left, camera.top, camera.width, camera.height] : [0, 0, ...this.size];
    }

    /** @param {number} x @param {number} y Pixels of the canvas. @returns {string|null} The camera that is there. */
    cameraAt(x, y) {
      const [left, top, width, height] = this.shown();
      const [px, py] = [left + x / this.canvas.clientWidth * width, top + y / this.canvas.clientHeight * height];
      const found = this.scene.cameras.find((each) => px >= each.left && px < each.left + each.width
        && py >= each.top && py < each.top + each.height);
      return found?.name ?? null;
    }

    /** @param {number} frame @returns {number} Place of the last picture that is not newer; the first if all are. */
    pictureAt(frame) {
      const { pictures } = this.scene;
      let [low, high] = [0, pictures.length - 1];
      while (low < high) {
        const middle = (low + high + 1) >> 1;
        if (pictures[middle] <= frame) low = middle;
        else high = middle - 1;
      }
      return low;
    }

    /** @param {number} frame */
    show(frame) {
      const at = this.pictureAt(frame);
      if (at === this.at) return;
      this.at = at;
      this.canvas.dataset.frame = String(this.scene.pictures[at]);
      this.prepare();
      this.paint();
    }

    /** Asks for the pictures around the present one, nearest first, and forgets those far away. */
    prepare() {
      const { pictures } = this.scene;
      const wanted = [this.at];
      for (let step = 1; step <= AHEAD; step++) wanted.push(this.at + step, ...(step <= BEHIND ? [this.at - step] : []));
      for (const at of wanted) if (at >= 0 && at < pictures.length && !this.images.has(at)) this.load(at);
      for (const [at, image] of this.images) {
        if (this.images.size <= KEPT) break;
        if (Math.abs(at - this.at) > AHEAD) {
          image.src = "";
          this.images.delete(at);
        }
      }
    }

    /** @param {number} at */
    load(at) {
      const image = new Image();
      this.images.set(at, image);
      image.addEventListener("load", () => {
        if (at === this.at) this.paint();
        // Decoded now, it need not be when it is drawn.
        else image.decode().catch(() => this.broken.add(at));
      });
      image.addEventListener("error", () => {
        if (this.images.get(at) !== image) return;
        this.broken.add(at);
        if (at === this.at) this.paint();
      });
      image.src = `${this.scene.media}${String(this.scene.pictures[at]).padStart(6, "0")}.webp`;
    }

    paint() {
      const { canvas, context } = this;
      if (this.at < 0 || !canvas.clientWidth) return;
      const ratio = Math.min(window.devicePixelRatio || 1, 2);
      const [left, top, width, height] = this.shown();
      const wide = Math.round(canvas.clientWidth * ratio);
      const high = Math.round(wide * height / width);
      if (canvas.width !== wide || canvas.height !== high) Object.assign(canvas, { width: wide, height: high });
      const image = this.images.get(this.at);
      context.setTransform(1, 0, 0, 1, 0, 0);
      if (this.broken.has(this.at)) return this.say("This picture is missing.");
      if (!image?.complete || !image.naturalWidth) {
        // The picture before stays until this one is there.
        if (!canvas.dataset.painted) this.say("");
        return undefined;
      }
      // Enlarged, a picture has fewer pixels than the screen.
      context.imageSmoothingQuality = "high";
      context.drawImage(image, left, top, width, height, 0, 0, wide, high);
      const scale = wide / width;
      context.setTransform(scale, 0, 0, scale, -left * scale, -top * scale);
      this.paintEdges(scale / ratio);
      this.paintNames(scale / ratio);
      canvas.dataset.painted = canvas.dataset.frame;
      return undefined;
    }

    /** @param {number} scale Pixels of the screen to one of the picture. */
    paintEdges(scale) {
      const { context, scene } = this;
      const edges = scene.edges[scene.pictures[this.at]];
      if (!edges) return;
      context.beginPath();
      for (const flat of Object.values(edges)) {
        for (let at = 0; at < flat.length; at += 4) {
          context.moveTo(flat[at], flat[at + 1]);
          context.lineTo(flat[at + 2], flat[at + 3]);
        }
      }
      for (const [index, colour] of COLOURS[this.theme].entries()) {
        context.strokeStyle = colour;
        context.lineWidth = (index ? 1.6 : 3.4) / scale;
        context.stroke();
      }
    }

    /** @param {number} scale */
    paintNames(scale) {
      const { context } = this;
      const size = 10.5 / scale;
      context.font = `600 ${size}px system-ui, "Liberation Sans", sans-serif`;
      context.textBaseline = "top";
      for (const { name, left, top } of this.scene.cameras) {
        const words = name.replace(/^CAM_/, "").replaceAll("_", " ").toLowerCase();
        context.fillStyle = "rgba(0, 0, 0, .55)";
        context.fillRect(left, top, context.measureText(words).width + size, size * 1.5);
        context.fillStyle = "#ffffff";
        context.fillText(words, left + size / 2, top + size / 4);
      }
    }

    /** @param {string} sentence */
    say(sentence) {
      const { context, canvas } = this;
      context.fillStyle = this.theme === "dark" ? "#22272c" : "#e3e5e6";
      context.fillRect(0, 0, canvas.width, canvas.height);
      context.fillStyle = this.theme === "dark" ? "#e4e7e9" : "#1b1e21";
      context.font = `${Math.round(canvas.width / 40)}px system-ui, sans-serif`;
      context.textBaseline = "middle";
      context.fillText(sentence, canvas.width / 20, canvas.height / 2);
    }
  }

  Object.assign(player, { Cameras });
})();
