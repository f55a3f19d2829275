"use strict";
/* The scene player: its elements, what is played, and how it is steered. */

const REMEMBER_AFTER_MS = 250;
const SPEEDS = [0.25, 0.5, 1, 2, 4];
const KEYS = [
  ["← →", "one frame"], ["Shift + ← →", "one sample"], ["Space", "play or stop"], ["Home, End", "first, last frame"],
  ["[ ]", "collision before, after"], ["+ −", "zoom"], ["W A S D", "move the view"], ["0", "view as at first"],
  ["H", "heading or north up"], ["C", "next camera"],
];
const MARKS = "✕ a plan made then collides, ┃ where the present one first does, ? the planner failed";
const MARKS_BY_WHOM = "✕ a plan made then hits the adversary, ◇ another, – whom is not said, ┃ where the present one does, "
  + "? the planner failed";
/** @type {[string, string, boolean][]} */
const TOGGLES = [
  ["recorded", "recorded ways", true], ["bodies", "footprints", true], ["forecasts", "forecasts", false],
  ["modes", "other modes", false], ["considered", "what the adversary considered", true],
];
const TIMES_S = [1, 2, 5, 10, 20, 60, 300], MOST_TIMES = 12;

/** Makes a viewer once a scene's script is there. @param {HTMLElement} place @param {string} key
 * @param {(scene: Scene) => Viewer} make @param {(sentence: string) => void} otherwise What to do without one. */
function playIn(place, key, make, otherwise) {
  let [made, gone] = [/** @type {Viewer|null} */ (null), false];
  place.replaceChildren(element("p", { class: "cp-loading", role: "status" }, "Loading the scene …"));
  loadScene(key).then((scene) => {
    if (!scene.frames.length) throw new LoadError("No record and no sheet has a sample of this scene.");
    made = gone ? null : make(scene);
  }).catch((error) => {
    // What the loader says is for readers; anything else is a fault in the script, and the console has it.
    if (!(error instanceof LoadError)) console.error(error);
    if (!gone) otherwise(error instanceof LoadError ? error.message : missing(key));
  });
  return { destroy: () => { gone = true; made?.destroy(); } };
}

/** A scene that is drawn when the browser paints, and played by the clock. */
class Viewer {
  views = /** @type {BirdsEye[]} */ ([]);
  cameras = /** @type {Cameras|null} */ (null);
  /** Names of planners; in a comparison from left to right. */
  chosen = /** @type {string[]} */ ([]);
  show = /** @type {Record<string, boolean>} */ ({ recorded: true, bodies: true });
  /** Since when it plays, and from where. */
  tick = /** @type {{now: number, seconds: number}|null} */ (null);
  stop = new AbortController();
  playing = false;
  speed = 1;
  frame = 0;
  first = 0;
  drawing = 0;
  timer = 0;
  playButton = element("button", { type: "button", onclick: () => this.toggle() }, "▶ Play");

  /** @param {HTMLElement} place @param {Scene} scene @param {string|null} protocol */
  constructor(place, scene, protocol) {
    this.place = place;
    this.scene = scene;
    this.protocol = protocol;
    this.last = scene.frames.length - 1;
    document.addEventListener("theme", () => { this.cameras?.paint(); this.draw(); }, { signal: this.stop.signal });
  }

  destroy() {
    this.stop.abort();
    this.playing = false;
    clearTimeout(this.timer);
    cancelAnimationFrame(this.drawing);
    for (const view of [...this.views, this.cameras]) view?.destroy();
    this.place.replaceChildren();
  }

  shown = () => this.chosen.flatMap((name) => this.scene.models.filter((model) => model.name === name));

  /** @param {Record<string, any>} attributes @returns {HTMLCanvasElement} A view from above. */
  addView(attributes, steered = true, extent = FIRST_M) {
    const canvas = element("canvas", { role: "img", ...attributes });
    this.views.push(new BirdsEye(canvas, this.scene, () => this.draw(), steered, extent));
    return canvas;
  }

  /** @param {Record<string, any>} attributes @returns {HTMLCanvasElement|null} Its cameras, if it has pictures. */
  addCameras(attributes) {
    if (!this.scene.pictures.length || !this.scene.cameras.length) return null;
    const canvas = element("canvas", { role: "img", ...attributes });
    this.cameras = new Cameras(canvas, this.scene);
    return canvas;
  }

  /** Beside each other, views show one planner each. */
  draw() {
    this.drawing ||= requestAnimationFrame(() => {
      const { frame, protocol, show, views } = this;
      const chosen = this.shown();
      this.drawing = 0;
      views.forEach((view, at) =>
        view.draw({ frame, protocol, show, chosen: views.length > 1 ? chosen.slice(at, at + 1) : chosen }));
      this.cameras?.show(frame);
    });
  }

  /** The frame, who is shown or who judges is another. */
  changed() {
    this.place.dataset.frame = String(this.frame);
    this.draw();
  }

  toggle() {
    this.playing = !this.playing;
    if (this.playing && this.frame === this.last) this.frame = this.first;
    this.tick = null;
    this.name();
    this.changed();
    if (this.playing) requestAnimationFrame((now) => this.advance(now));
  }

  /** Names the button. @returns {boolean} Whether what is played waits for pictures. */
  name() {
    const loading = this.playing && Boolean(this.cameras?.loading());
    this.playButton.textContent = loading ? "Loading …" : this.playing ? "❚❚ Stop" : "▶ Play";
    return loading;
  }

  /** @param {number} now Milliseconds; plays by the clock, so that a slow machine leaves frames out. */
  advance(now) {
    if (!this.playing) return;
    if (this.name()) this.tick = null;
    else this.step(now);
    requestAnimationFrame((later) => this.advance(later));
  }

  /** @param {number} now */
  step(now) {
    const { frame, last, scene: { frames } } = this;
    this.tick ??= { now, seconds: frames[frame] };
    const seconds = this.tick.seconds + this.speed * (now - this.tick.now) / 1000;
    while (this.frame < last && frames[this.frame + 1] <= seconds) this.frame += 1;
    if (this.frame !== frame) this.changed();
    if (this.frame === last) this.ended(seconds - frames[last]);
  }

  /** @param {number} _seconds Since the last frame began. */
  ended(_seconds) {
    this.toggle();
  }
}

/** @param {string} words @param {string} label @param {() => void} onclick @param {string} [testid] */
const iconButton = (words, label, onclick, testid) => element("button",
  { type: "button", title: label, "aria-label": label, onclick, "data-testid": testid }, words);

/** @param {boolean} checked @param {Record<string, any>} attributes @param {(checked: boolean) => void} change */
function checkbox(checked, attributes, change) {
  const box = element("input", { type: "checkbox", checked, ...attributes, onchange: () => change(box.checked) });
  return box;
}

/** A player in an element of the page, whose content is replaced. */
class Player extends Viewer {
  tracks = /** @type {Map<string, HTMLElement>} */ (new Map());
  choosers = /** @type {HTMLSelectElement[]} */ ([]);
  cameraSelect = /** @type {HTMLSelectElement|null} */ (null);
  lanes = element("div", { class: "cp-lanes" });
  verdicts = element("div", { class: "cp-verdicts", "data-testid": "player-verdicts", "aria-live": "polite" });
  time = element("output", { class: "cp-time", "data-testid": "player-time" });
  scrub = element("input", { type: "range", min: 0, step: 1, "data-testid": "player-scrub", "aria-label": "Time",
    oninput: () => this.seek(Number(this.scrub.value)) });
  turnButton = iconButton("▲ heading up", "Turn: heading or north up", () => this.turn(), "player-turn");
  show = Object.fromEntries(TOGGLES.map(([name, , on]) => [name, on]));
  told = "";

  /** @param {HTMLElement} place @param {Scene} scene @param {PlayerOptions} options What is shown at first. */
  constructor(place, scene, options) {
    super(place, scene, scene.protocols.find((name) => name === options.protocol) ?? scene.protocols[0] ?? null);
    this.options = options;
    const names = scene.models.map((model) => model.name);
    const asked = unique(options.models ?? []).filter((name) => names.includes(name));
    const wanted = asked.length ? asked : scene.shown[this.judge()] ?? names.slice(0, 3);
    this.chosen = options.compare ? unique([...asked, ...names]).slice(0, 2)
      : names.filter((name) => wanted.includes(name));
    this.compare = Boolean(options.compare) && this.chosen.length > 0;
    const begins = () => scene.opens ?? Math.max(decisive(scene, this.shown(), this.judge()) - BEFORE_S, 0);
    this.frame = frameAt(scene, options.t ?? begins());
    this.scrub.max = String(this.last);
    place.replaceChildren(this.build());
    this.fillLanes();
    this.chooseCamera(options.camera ?? null);
    const { signal } = this.stop;
    document.addEventListener("keydown", (event) => this.press(event), { signal });
    document.addEventListener("visibilitychange", () => { this.tick = null; }, { signal });
    this.tell();
  }

  /** Number of the protocol; -1 if nothing was judged. */
  judge = () => this.scene.protocols.indexOf(this.protocol ?? "");

  // --- steering --------------------------------------------------------------------------------------------------------
  /** @param {KeyboardEvent} event */
  press(event) {
    const { target } = event;
    if (event.defaultPrevented || event.ctrlKey || event.metaKey || event.altKey || !(target instanceof Element)) return;
    if (target.closest("select, textarea, [contenteditable], input:not([type=range]):not([type=checkbox])")) return;
    const pressing = target.closest("button, a, summary, input[type=checkbox]");
    if (pressing && (event.key === " " || event.key === "Enter")) return;
    const act = own(this.actions(event.shiftKey), event.key.length === 1 ? event.key.toLowerCase() : event.key);
    if (!act) return;
    event.preventDefault();
    act();
  }

  /** @param {boolean} shift @returns {Record<string, () => void>} What keys do. */
  actions(shift) {
    /** @param {number} direction */
    const step = (direction) => () => (shift
      ? this.leap([...this.scene.samples.keys()], direction, Infinity * direction) : this.seek(this.frame + direction));
    /** @param {number} x @param {number} y */
    const nudge = (x, y) => this.each((view) => view.move(NUDGE_PX * x, NUDGE_PX * y));
    const [nearer, farther] = [ZOOM, 1 / ZOOM].map((factor) => this.each((view) => view.zoom(factor)));
    return {
      ArrowLeft: step(-1), ArrowRight: step(1), ArrowDown: step(-1), ArrowUp: step(1), " ": () => this.toggle(),
      Home: () => this.seek(0), End: () => this.seek(Infinity), "[": () => this.jump(-1), "]": () => this.jump(1),
      "+": nearer, "=": nearer, "-": farther, _: farther, 0: this.each((view) => view.reset()),
      w: nudge(0, 1), s: nudge(0, -1), a: nudge(1, 0), d: nudge(-1, 0),
      h: () => this.turn(), c: () => this.nextCamera(),
    };
  }

  /** Both views of a comparison move together. @param {(view: BirdsEye) => void} act @returns {() => void} */
  each = (act) => () => this.views.forEach(act);

  /** @param {number} frame */
  seek(frame) {
    const to = Math.min(Math.max(frame, 0), this.last);
    this.tick = null;
    if (to === this.frame) return;
    this.frame = to;
    this.changed();
  }

  /** To the frame before or after of these samples. @param {number[]} samples @param {number} direction
   * @param {number} otherwise */
  leap(samples, direction, otherwise) {
    const frames = samples.map((sample) => this.scene.samples[sample].frame).sort((a, b) => a - b);
    const next = direction > 0 ? frames.find((frame) => frame > this.frame)
      : frames.findLast((frame) => frame < this.frame);
    this.seek(next ?? otherwise);
  }

  /** To the collision before or after, of any planner that is shown. @param {number} direction */
  jump(direction) {
    this.leap(this.shown().flatMap((model) => collisions(this.scene, model, this.judge())), direction, this.frame);
  }

  turn() {
    const up = !this.views[0].headingUp;
    if (!this.scene.ego) return;
    this.views.forEach((view) => { view.headingUp = up; });
    this.turnButton.textContent = up ? "▲ heading up" : "▲ north up";
    this.draw();
  }

  nextCamera() {
    const names = [null, ...this.scene.cameras.map(({ name }) => name)];
    this.chooseCamera(names[(names.indexOf(this.cameras?.camera?.name ?? null) + 1) % names.length]);
    this.remember();
  }

  /** @param {string|null} name Null for all. */
  chooseCamera(name) {
    this.cameras?.choose(name);
    if (this.cameraSelect) this.cameraSelect.value = this.cameras?.camera?.name ?? "";
  }

  // --- showing ---------------------------------------------------------------------------------------------------------
  changed() {
    this.tell();
    clearTimeout(this.timer);
    // Browsers limit how often an address may change.
    this.timer = setTimeout(() => this.remember(), REMEMBER_AFTER_MS);
  }

  /** Says what is shown. */
  tell() {
    const { frame, scene, protocol, verdicts } = this;
    const sample = scene.sampleOf[frame];
    const seconds = scene.frames[frame].toFixed(2);
    super.changed();
    this.scrub.value = String(frame);
    this.time.textContent = `${seconds} s`;
    this.scrub.setAttribute("aria-valuetext", `${seconds} seconds, ${
      sample < 0 ? "before the first sample" : `sample ${sample + 1} of ${scene.samples.length}`}`);
    verdicts.ariaLive = this.playing ? "off" : "polite";
    const told = JSON.stringify([sample, this.chosen, protocol]);
    if (told === this.told) return;
    this.told = told;
    const models = sample < 0 ? [] : this.shown();
    for (const model of models) markMoment(this.tracks.get(model.name), scene, sample, model.verdict(sample, this.judge()));
    verdicts.replaceChildren(...(sample < 0 ? [] : verdictNodes(scene, models, sample, protocol, this.compare)));
  }

  /** Tells the page. */
  remember() {
    this.options.onState?.({
      t: Math.round(100 * this.scene.frames[this.frame]) / 100, models: this.chosen, protocol: this.protocol,
      camera: this.cameras?.camera?.name ?? null,
    });
  }

  // --- elements ------------------------------------------------------------------------------------------------------
  build() {
    const views = this.compare ? this.chosen.map((_, slot) => this.buildView(slot)) : [this.buildView(null)];
    this.turnButton.hidden = !this.scene.ego;
    views[views.length - 1].append(element("div", { class: "cp-tools" }, this.turnButton,
      iconButton("+", "Zoom in", this.each((view) => view.zoom(ZOOM))),
      iconButton("−", "Zoom out", this.each((view) => view.zoom(1 / ZOOM))),
      iconButton("reset", "View as at first", this.each((view) => view.reset()))));
    return element("div", { class: this.compare ? "cp cp-compare" : "cp" },
      element("div", { class: "cp-stage" }, element("div", { class: "cp-views" }, views), this.buildSide()),
      this.buildTransport(), this.buildLine(), this.buildChoices(),
      element("details", { class: "cp-keys" }, element("summary", {}, "Keys"),
        element("dl", {}, KEYS.map(([keys, words]) => [element("dt", {}, keys), element("dd", {}, words)]))));
  }

  /** @param {number|null} slot Of a comparison, 0 on the left. @returns {HTMLElement} A view, and who is seen in it. */
  buildView(slot) {
    const canvas = this.addView({ class: "cp-birdseye", "data-testid": "player-birdseye", tabindex: "0",
      "aria-label": slot === null ? "The scene from above" : "The scene from above with one planner's plan" });
    if (slot === null) return element("figure", { class: "cp-view" }, canvas);
    const select = selectOf(this.scene.models.map((model) => model.name), this.chosen[slot], (name) => {
      if (this.chosen[1 - slot] === name) this.chosen[1 - slot] = this.chosen[slot];
      this.chosen[slot] = name;
      this.fillLanes();
      this.changed();
    }, { "data-testid": slot ? "compare-b" : "compare-a",
      "aria-label": slot ? "Planner on the right" : "Planner on the left" });
    this.choosers.push(select);
    return element("figure", { class: "cp-view" }, element("figcaption", {}, select), canvas);
  }

  /** Cameras, whose boxes have which colour, and the verdicts. */
  buildSide() {
    const { scene, verdicts } = this;
    /** @param {string|null} name */
    const choose = (name) => { this.chooseCamera(name); this.remember(); };
    const canvas = this.addCameras({ class: "cp-cameras", "data-testid": "player-cameras",
      "aria-label": "Pictures of the cameras with the box of the adversary",
      onclick: (/** @type {MouseEvent} */ { offsetX, offsetY }) =>
        choose(this.cameras?.camera ? null : this.cameras?.cameraAt(offsetX, offsetY) ?? null) });
    if (!canvas) {
      const why = scene.driven ? "Records of drives hold no pictures; challenger-bench film --drives shows what cameras saw."
        : scene.hasSheet ? "The sheet of this scene has no pictures of cameras."
        : "Without a sheet, plans stand in the frame of the ego at each sample.";
      return element("div", { class: "cp-side" }, element("p", { class: "cp-note" }, why), kindLegend(scene), verdicts);
    }
    this.cameraSelect = selectOf([["", "all cameras"], ...scene.cameras.map(({ name }) => name)], "",
      (name) => choose(name || null), { "data-testid": "player-camera" });
    return element("div", { class: "cp-side" }, canvas, element("div", { class: "cp-under" },
      element("label", { class: "cp-field" }, "Camera ", this.cameraSelect), kindLegend(scene)), verdicts);
  }

  buildTransport() {
    const { protocols } = this.scene;
    const speed = selectOf(SPEEDS.map((each) => [String(each), `${each}×`]), "1", (value) => {
      this.speed = Number(value);
      this.tick = null;
    }, { "aria-label": "Speed" });
    const protocol = selectOf(protocols, this.protocol ?? "", (name) => {
      this.protocol = name;
      this.fillLanes();
      this.changed();
    }, { "data-testid": "player-protocol" });
    this.playButton.dataset.testid = "player-play";
    return element("div", { class: "cp-transport" },
      iconButton("|◀", "First frame", () => this.seek(0)),
      iconButton("◀", "One frame back", () => this.seek(this.frame - 1)), this.playButton,
      iconButton("▶|", "One frame on", () => this.seek(this.frame + 1), "player-step"),
      iconButton("◂✕", "Collision before", () => this.jump(-1), "player-collision-before"),
      iconButton("✕▸", "Next collision", () => this.jump(1), "player-collision-next"),
      speed, this.time, protocols.length ? element("label", { class: "cp-field" }, "Protocol ", protocol) : null);
  }

  /** The time line: samples, round times as many as can be read beside each other, and a lane a planner. */
  buildLine() {
    const { scene } = this;
    const ticks = scene.samples.map(({ frame }, number) =>
      along(element("i", { class: number % 2 ? null : "cp-second" }), scene, frame));
    const length = scene.frames[this.last];
    const step = TIMES_S.find((seconds) => length / seconds <= MOST_TIMES) ?? 300;
    const times = Array.from({ length: Math.floor(length / step + 1e-6) + 1 }, (_, at) =>
      along(element("span", { class: "cp-when" }, `${at * step}${at ? "" : " s"}`), scene, frameAt(scene, at * step)));
    return element("div", { class: "cp-line" },
      element("div", { class: "cp-row" },
        element("span", { class: "cp-name cp-quiet" }, this.compare ? "" : "planners"),
        element("div", { class: "cp-track cp-range" }, this.scrub,
          element("div", { class: "cp-ticks", "aria-hidden": "true" }, ticks, times))),
      scene.strip && element("div", { class: "cp-row" }, element("span", { class: "cp-name cp-quiet" }, "time to collision"),
        element("div", { class: "cp-track cp-strip", "data-testid": "player-strip" }, scene.strip.map(
          // A style that is an attribute is refused (Content-Security-Policy).
          ([kind, style, title, words]) => Object.assign(element("i", { class: `cp-${kind}`, title }, words), { style })))),
      this.lanes);
  }

  fillLanes() {
    this.choosers.forEach((select, slot) => { select.value = this.chosen[slot]; });
    this.lanes.replaceChildren(...(this.compare ? this.shown() : this.scene.models).map((model) => this.buildLane(model)));
    this.told = "";
  }

  /** @param {Planner} model @returns {HTMLElement} */
  buildLane(model) {
    const { name, shown } = model;
    const track = element("div", { class: "cp-track" });
    this.tracks.set(name, track);
    const fill = () => fillTrack(track, this.scene, model, this.protocol, this.chosen.includes(name),
      (frame) => this.seek(frame));
    const box = checkbox(this.chosen.includes(name), { value: name, "data-testid": "player-model" }, (checked) => {
      this.chosen = this.scene.models.map((each) => each.name)
        .filter((each) => (each === name ? checked : this.chosen.includes(each)));
      fill();
      this.changed();
    });
    fill();
    return element("div", { class: "cp-row" }, element("label", { class: "cp-name", title: name },
      this.compare ? null : box, swatch(name), element("span", {}, shown)), track);
  }

  buildChoices() {
    const there = TOGGLES.filter(([name]) => name !== "considered" || this.scene.considered.length);
    return element("div", { class: "cp-choices", role: "group", "aria-label": "What is drawn" },
      there.map(([name, words]) => element("label", {}, checkbox(this.show[name],
        { "data-testid": `player-show-${name}` }, (on) => { this.show[name] = on; this.draw(); }), ` ${words}`)),
      element("span", { class: "cp-quiet" }, this.scene.adversarial ? MARKS_BY_WHOM : MARKS));
  }
}
