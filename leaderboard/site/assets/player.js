"use strict";
/* The scene player: its elements, what is played, and how it is steered. */

const SAY_EVERY_MS = 1200, REMEMBER_EVERY_MS = 250;
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

/** Views and cameras of a scene that show the same frame, drawn when the browser paints. */
class Viewer {
  /** @type {BirdsEye[]} */
  views = [];
  /** @type {Cameras|null} */
  cameras = null;
  /** @type {HTMLCanvasElement[]} */
  swatches = [];
  drawing = 0;

  /** @param {Scene} scene @param {() => ViewState} state What is to be seen. @param {(frame: number) => void} [painted] */
  constructor(scene, state, painted = () => {}) {
    this.scene = scene;
    this.state = state;
    this.painted = painted;
    this.watch = new MutationObserver(() => this.retheme());
    this.watch.observe(document.documentElement, { attributes: true, attributeFilter: ["data-theme"] });
  }

  destroy() {
    cancelAnimationFrame(this.drawing);
    for (const view of this.views) view.destroy();
    this.cameras?.destroy();
    this.watch.disconnect();
  }

  /** @param {HTMLCanvasElement} canvas @param {boolean} steered @returns {BirdsEye} */
  addView(canvas, steered) {
    const view = new BirdsEye(canvas, this.scene, () => this.draw(), steered);
    this.views.push(view);
    return view;
  }

  /** Beside each other, views show one planner each. */
  draw() {
    if (this.drawing) return;
    this.drawing = requestAnimationFrame(() => {
      this.drawing = 0;
      const state = this.state();
      for (const [at, view] of this.views.entries()) {
        view.draw(this.views.length > 1 ? { ...state, chosen: state.chosen.slice(at, at + 1) } : state);
      }
      this.cameras?.show(state.frame);
      this.painted(state.frame);
    });
  }

  retheme() {
    this.cameras?.paint();
    this.swatches.forEach(paintSwatch);
    this.draw();
  }
}

/** @param {string} words @param {string} label @param {() => void} onclick @param {string} [testid] */
const iconButton = (words, label, onclick, testid) => element("button",
  { type: "button", title: label, "aria-label": label, onclick, "data-testid": testid }, words);

/** @param {any[]} values @param {any} chosen @param {(value: any) => string} [words] @returns {HTMLElement[]} */
const optionsOf = (values, chosen, words = String) =>
  values.map((value) => element("option", { value, selected: value === chosen }, words(value)));

/** A player in an element of the page. */
class Player {
  stop = new AbortController();
  playing = false;
  speed = 1;
  frame = 0;
  /** Since when it plays, and from where. @type {{now: number, seconds: number}|null} */
  tick = null;
  /** @type {Map<string, number>} */
  timers = new Map();
  remembered = -Infinity;
  told = "";
  ready = false;

  /** @param {HTMLElement} place Its content is replaced. @param {string} key Key of the scene.
   * @param {PlayerOptions} options What is shown at first. */
  constructor(place, key, options) {
    this.place = place;
    this.options = options;
    place.replaceChildren(element("p", { class: "cp-loading", role: "status" }, "Loading the scene …"));
    loadScene(key).then((scene) => {
      if (!this.stop.signal.aborted) this.begin(scene);
    }).catch((error) => this.giveUp(error));
  }

  /** Nobody waits for what will not come. @param {unknown} error */
  giveUp(error) {
    if (this.stop.signal.aborted) return;
    // What the loader says is for readers; anything else is a fault in the script, and the console has it.
    const said = error instanceof LoadError ? error.message
      : "The script of this scene is damaged; write the site again with challenger-bench leaderboard.";
    if (!(error instanceof LoadError)) console.error(error);
    this.destroy();
    this.place.replaceChildren(element("p", { class: "error", role: "alert", "data-testid": "error" }, said));
  }

  destroy() {
    this.stop.abort();
    this.playing = false;
    for (const timer of this.timers.values()) clearTimeout(timer);
    this.stage?.viewer.destroy();
    this.place.replaceChildren();
  }

  /** @param {Scene} scene */
  begin(scene) {
    if (!scene.frames.length) {
      const why = "No record and no sheet has a sample of this scene.";
      this.place.replaceChildren(element("p", { class: "cp-loading" }, why));
      return;
    }
    const { options } = this;
    const protocol = scene.protocols.includes(options.protocol ?? "") ? options.protocol ?? null : scene.protocols[0] ?? null;
    const names = scene.models.map((model) => model.name);
    const asked = (options.models ?? []).filter((name) => names.includes(name));
    const chosen = options.compare ? unique([...asked, ...names]).slice(0, 2) : asked.length ? unique(asked)
      : scene.shown[scene.protocols.indexOf(protocol ?? "")] ?? names.slice(0, 3);
    const compare = Boolean(options.compare) && chosen.length > 0;
    const shown = scene.models.filter((model) => chosen.includes(model.name));
    const moment = decisive(scene, shown, scene.protocols.indexOf(protocol ?? ""));
    this.frame = frameAt(scene, options.t ?? Math.max(moment - BEFORE_S, 0));
    this.stage = new Stage(this, scene, protocol, chosen, compare);
    this.place.replaceChildren(this.stage.root);
    const { signal } = this.stop;
    document.addEventListener("keydown", (event) => this.press(event), { signal });
    document.addEventListener("visibilitychange", () => { this.tick = null; }, { signal });
    this.stage.viewer.retheme();
    this.stage.chooseCamera(options.camera ?? null);
    this.changed();
  }

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
    /** @param {(view: BirdsEye) => void} act */
    const each = (act) => () => this.stage?.viewer.views.forEach(act);
    /** @param {number} direction */
    const step = (direction) => () => (shift ? this.stepSample(direction) : this.seek(this.frame + direction));
    /** @param {number} x @param {number} y */
    const nudge = (x, y) => each((view) => view.move(NUDGE_PX * x, NUDGE_PX * y));
    const [nearer, farther] = [1.3, 1 / 1.3].map((factor) => each((view) => view.zoom(factor)));
    return {
      ArrowLeft: step(-1), ArrowRight: step(1), ArrowDown: step(-1), ArrowUp: step(1), " ": () => this.toggle(),
      Home: () => this.seek(0), End: () => this.seek(Infinity),
      PageUp: () => this.stepSample(-1), PageDown: () => this.stepSample(1),
      "[": () => this.jump(-1), "]": () => this.jump(1),
      "+": nearer, "=": nearer, "-": farther, _: farther, 0: each((view) => view.reset()),
      w: nudge(0, 1), s: nudge(0, -1), a: nudge(1, 0), d: nudge(-1, 0),
      h: () => this.stage?.turn(), c: () => this.stage?.nextCamera(),
    };
  }

  /** @param {number} frame */
  seek(frame) {
    const to = Math.min(Math.max(frame, 0), (this.stage?.scene.frames.length ?? 1) - 1);
    this.tick = null;
    if (to === this.frame) return;
    this.frame = to;
    this.changed();
  }

  /** @param {number} direction To the sample before or after. */
  stepSample(direction) {
    const frames = this.stage?.scene.samples.map(({ frame }) => frame) ?? [];
    this.seek(this.nearest(frames, direction) ?? (direction > 0 ? Infinity : 0));
  }

  /** @param {number} direction To the collision before or after, of any planner that is shown. */
  jump(direction) {
    const { scene, judge, shown } = /** @type {Stage} */ (this.stage);
    const samples = shown().flatMap((model) => collisions(scene, model, judge())).sort((a, b) => a - b);
    this.seek(this.nearest(samples.map((sample) => scene.samples[sample].frame), direction) ?? this.frame);
  }

  /** @param {number[]} frames In order. @param {number} direction @returns {number|undefined} Next to the present one. */
  nearest(frames, direction) {
    return direction > 0 ? frames.find((frame) => frame > this.frame) : frames.findLast((frame) => frame < this.frame);
  }

  toggle() {
    const { stage } = this;
    if (!stage) return;
    this.playing = !this.playing;
    if (this.playing && this.frame === stage.scene.frames.length - 1) this.seek(0);
    const words = this.playing ? "Stop" : "Play";
    stage.playButton.textContent = this.playing ? "❚❚" : "▶";
    stage.playButton.setAttribute("aria-label", words);
    stage.playButton.title = words;
    this.tick = null;
    if (this.playing) requestAnimationFrame((now) => this.advance(now));
    else this.changed();
  }

  /** @param {number} now Milliseconds; plays by the clock, so that a slow machine leaves frames out. */
  advance(now) {
    const frames = this.stage?.scene.frames ?? [];
    if (!this.playing) return;
    this.tick ??= { now, seconds: frames[this.frame] };
    const seconds = this.tick.seconds + this.speed * (now - this.tick.now) / 1000;
    let next = this.frame;
    while (next < frames.length - 1 && frames[next + 1] <= seconds) next += 1;
    if (next !== this.frame) {
      this.frame = next;
      this.changed();
    }
    if (next === frames.length - 1) this.toggle();
    else requestAnimationFrame((later) => this.advance(later));
  }

  // --- showing ---------------------------------------------------------------------------------------------------------
  /** The frame, who is shown or who judges is another. */
  changed() {
    const { stage, frame } = this;
    if (!stage) return;
    const { scene } = stage;
    const sample = scene.sampleOf[frame];
    const seconds = scene.frames[frame].toFixed(2);
    const where = sample < 0 ? "before the first sample" : `sample ${sample + 1} of ${scene.samples.length}`;
    stage.scrub.value = String(frame);
    stage.time.textContent = `${seconds} s`;
    stage.scrub.setAttribute("aria-valuetext", `${seconds} seconds, ${where}`);
    this.place.dataset.frame = String(frame);
    const told = JSON.stringify([sample, stage.chosen, stage.protocol]);
    if (told !== this.told) {
      this.told = told;
      stage.tell(sample);
      this.later("say", SAY_EVERY_MS, () => {
        const now = scene.sampleOf[this.frame];
        if (!this.playing && now >= 0) stage.live.textContent = sentenceOf(scene, stage.shown(), now, stage.protocol);
      });
    }
    stage.viewer.draw();
    if (this.ready) this.remember();
    this.ready = true;
  }

  /** Tells the page: at once if that was not just now, for browsers limit how often an address may change. */
  remember() {
    const wait = this.remembered + REMEMBER_EVERY_MS - performance.now();
    this.later("remember", Math.max(wait, 0), () => {
      const { stage } = this;
      this.remembered = performance.now();
      if (stage) {
        this.options.onState?.({
          t: Math.round(100 * stage.scene.frames[this.frame]) / 100, models: [...stage.chosen], protocol: stage.protocol,
          camera: stage.viewer.cameras?.camera?.name ?? null,
        });
      }
    });
  }

  /** Does something after a while, once. @param {string} what @param {number} after @param {() => void} act */
  later(what, after, act) {
    if (this.timers.has(what)) return;
    const timer = setTimeout(() => {
      this.timers.delete(what);
      act();
    }, after);
    this.timers.set(what, timer);
  }
}

/** The elements of a player. */
class Stage {
  /** @type {Map<string, HTMLElement>} By planner. */
  tracks = new Map();
  /** @type {HTMLSelectElement[]} */
  choosers = [];
  /** @type {HTMLButtonElement[]} */
  turns = [];
  lanes = element("div", { class: "cp-lanes" });
  verdicts = element("div", { class: "cp-verdicts", "data-testid": "player-verdicts" });
  live = element("p", { class: "cp-unseen", "aria-live": "polite", "data-testid": "player-live" });
  time = element("output", { class: "cp-time", "data-testid": "player-time" });
  cameraSelect = element("select", { "data-testid": "player-camera" });
  show = Object.fromEntries(TOGGLES.map(([name, , on]) => [name, on]));

  /** @param {Player} player @param {Scene} scene @param {string|null} protocol @param {string[]} chosen Names.
   * @param {boolean} compare */
  constructor(player, scene, protocol, chosen, compare) {
    this.player = player;
    this.scene = scene;
    this.protocol = protocol;
    this.chosen = chosen;
    this.compare = compare;
    this.viewer = new Viewer(scene, () => ({
      frame: player.frame, protocol: this.protocol, show: this.show, chosen: this.shown() }));
    this.playButton = iconButton("▶", "Play", () => player.toggle(), "player-play");
    this.scrub = element("input", {
      type: "range", min: 0, max: scene.frames.length - 1, step: 1, value: player.frame, "data-testid": "player-scrub",
      "aria-label": "Time", oninput: () => player.seek(Number(this.scrub.value)),
    });
    const views = (compare ? [0, 1].slice(0, chosen.length) : [null]).map((slot) => this.buildView(slot));
    this.root = element("div", { class: compare ? "cp cp-compare" : "cp" },
      element("div", { class: "cp-stage" }, element("div", { class: "cp-views" }, views), this.buildSide()),
      this.buildTransport(), this.buildLine(), this.buildChoices(), this.live,
      element("details", { class: "cp-keys" }, element("summary", {}, "Keys"),
        element("dl", {}, KEYS.map(([keys, words]) => [element("dt", {}, keys), element("dd", {}, words)]))));
    this.fillLanes();
  }

  /** Number of the protocol; -1 if nothing was judged. */
  judge = () => this.scene.protocols.indexOf(this.protocol ?? "");

  /** Planners that are shown; in a comparison from left to right. */
  shown = () => {
    const found = this.scene.models.filter((model) => this.chosen.includes(model.name));
    return this.compare ? found.sort((a, b) => this.chosen.indexOf(a.name) - this.chosen.indexOf(b.name)) : found;
  };

  /** @param {number|null} slot Of a comparison, 0 on the left. @returns {HTMLElement} A view with its buttons. */
  buildView(slot) {
    const canvas = element("canvas", { class: "cp-birdseye", "data-testid": "player-birdseye", tabindex: "0", role: "img",
      "aria-label": slot === null ? "The scene from above" : "The scene from above with one planner's plan" });
    this.viewer.addView(canvas, true);
    // Both views of a comparison move together.
    /** @param {(view: BirdsEye) => void} act */
    const both = (act) => () => this.viewer.views.forEach(act);
    const turn = iconButton("▲ heading up", "Turn: heading or north up", () => this.turn(), "player-turn");
    turn.hidden = !this.scene.ego;
    this.turns.push(turn);
    const tools = element("div", { class: "cp-tools" }, turn,
      iconButton("+", "Zoom in", both((view) => view.zoom(1.3))),
      iconButton("−", "Zoom out", both((view) => view.zoom(1 / 1.3))),
      iconButton("reset", "View as at first", both((view) => view.reset())));
    return element("figure", { class: "cp-view" }, slot === null ? null : this.buildChooser(slot), canvas, tools);
  }

  /** @param {number} slot 0 on the left. @returns {HTMLElement} A select of planners. */
  buildChooser(slot) {
    const names = this.scene.models.map((model) => model.name);
    const select = element("select", {
      "data-testid": slot ? "compare-b" : "compare-a",
      "aria-label": slot ? "Planner on the right" : "Planner on the left",
      onchange: () => {
        if (this.chosen[1 - slot] === select.value) this.chosen[1 - slot] = this.chosen[slot];
        this.chosen[slot] = select.value;
        this.fillLanes();
        this.player.changed();
      },
    }, optionsOf(names, this.chosen[slot]));
    this.choosers.push(select);
    return element("figcaption", {}, select);
  }

  /** Cameras, whose boxes have which colour, and the verdicts. */
  buildSide() {
    const { scene, viewer } = this;
    if (!scene.pictures.length || !scene.cameras.length) {
      const why = scene.driven ? "Records of drives hold no pictures; challenger-bench film --drives shows what cameras saw."
        : scene.hasSheet ? "The sheet of this scene has no pictures of cameras."
        : "Without a sheet, plans stand in the frame of the ego at each sample.";
      return element("div", { class: "cp-side" }, element("p", { class: "cp-note" }, why), kindLegend(scene), this.verdicts);
    }
    const canvas = element("canvas", {
      class: "cp-cameras", "data-testid": "player-cameras", role: "img",
      "aria-label": "Pictures of the cameras with the box of the adversary",
      onclick: (/** @type {MouseEvent} */ { offsetX, offsetY }) =>
        this.chooseCamera(cameras.camera ? null : cameras.cameraAt(offsetX, offsetY), true),
    });
    const cameras = new Cameras(canvas, scene);
    viewer.cameras = cameras;
    this.cameraSelect.append(...optionsOf(["", ...scene.cameras.map(({ name }) => name)], "", (name) => name || "all cameras"));
    this.cameraSelect.addEventListener("change", () => this.chooseCamera(this.cameraSelect.value || null, true));
    return element("div", { class: "cp-side" }, canvas, element("div", { class: "cp-under" },
      element("label", { class: "cp-field" }, "Camera ", this.cameraSelect), kindLegend(scene)), this.verdicts);
  }

  buildTransport() {
    const { player, scene } = this;
    const speed = element("select", { "aria-label": "Speed",
      onchange: () => { player.speed = Number(speed.value); player.tick = null; },
    }, optionsOf(SPEEDS, 1, (value) => `${value}×`));
    const protocol = element("select", { "data-testid": "player-protocol",
      onchange: () => { this.protocol = protocol.value; this.fillLanes(); player.changed(); },
    }, optionsOf(scene.protocols, this.protocol));
    return element("div", { class: "cp-transport" },
      iconButton("|◀", "First frame", () => player.seek(0)),
      iconButton("◀", "One frame back", () => player.seek(player.frame - 1)), this.playButton,
      iconButton("▶|", "One frame on", () => player.seek(player.frame + 1), "player-step"),
      iconButton("◂✕", "Collision before", () => player.jump(-1), "player-collision-before"),
      iconButton("✕▸", "Next collision", () => player.jump(1), "player-collision-next"),
      speed, this.time, scene.protocols.length ? element("label", { class: "cp-field" }, "Protocol ", protocol) : null);
  }

  /** The time line: samples, round times as many as can be read beside each other, and a lane a planner. */
  buildLine() {
    const { scene } = this;
    const ticks = scene.samples.map(({ frame }, number) =>
      along(element("i", { class: number % 2 ? null : "cp-second" }), scene, frame));
    const length = scene.frames[scene.frames.length - 1];
    const step = TIMES_S.find((seconds) => length / seconds <= MOST_TIMES) ?? 300;
    const times = Array.from({ length: Math.floor(length / step + 1e-6) + 1 }, (_, at) =>
      along(element("span", { class: "cp-when" }, `${at * step}${at ? "" : " s"}`), scene, frameAt(scene, at * step)));
    return element("div", { class: "cp-line" },
      element("div", { class: "cp-row" },
        element("span", { class: "cp-name cp-quiet" }, this.compare ? "" : "planners"),
        element("div", { class: "cp-track cp-range" }, this.scrub,
          element("div", { class: "cp-ticks", "aria-hidden": "true" }, ticks, times))),
      this.lanes);
  }

  fillLanes() {
    this.choosers.forEach((select, slot) => { select.value = this.chosen[slot]; });
    this.viewer.swatches = [];
    this.lanes.replaceChildren(...(this.compare ? this.shown() : this.scene.models).map((model) => this.buildLane(model)));
    this.viewer.retheme();
  }

  /** @param {Planner} model @returns {HTMLElement} */
  buildLane(model) {
    const { name, shown } = model;
    const track = element("div", { class: "cp-track" });
    this.tracks.set(name, track);
    const fill = () => (this.chosen.includes(name)
      ? fillTrack(track, this.scene, model, this.protocol, (frame) => this.player.seek(frame)) : track.replaceChildren());
    const box = element("input", { type: "checkbox", value: name, checked: this.chosen.includes(name),
      "data-testid": "player-model",
      onchange: () => {
        this.chosen = this.scene.models.map((each) => each.name)
          .filter((each) => (each === name ? box.checked : this.chosen.includes(each)));
        fill();
        this.player.changed();
      } });
    fill();
    const style = swatch(name);
    this.viewer.swatches.push(style);
    return element("div", { class: "cp-row" }, element("label", { class: "cp-name", title: name },
      this.compare ? null : box, style, element("span", {}, shown)), track);
  }

  buildChoices() {
    const there = TOGGLES.filter(([name]) => name !== "considered" || this.scene.considered.length);
    const boxes = there.map(([name, words]) => {
      const box = element("input", { type: "checkbox", checked: this.show[name], "data-testid": `player-show-${name}`,
        onchange: () => { this.show[name] = box.checked; this.viewer.draw(); } });
      return element("label", {}, box, ` ${words}`);
    });
    return element("div", { class: "cp-choices", role: "group", "aria-label": "What is drawn" }, boxes,
      element("span", { class: "cp-quiet" }, this.scene.adversarial ? MARKS_BY_WHOM : MARKS));
  }

  turn() {
    if (!this.scene.ego) return;
    const up = !this.viewer.views[0].headingUp;
    this.viewer.views.forEach((view) => { view.headingUp = up; });
    this.turns.forEach((button) => { button.textContent = up ? "▲ heading up" : "▲ north up"; });
    this.viewer.draw();
  }

  nextCamera() {
    const names = [null, ...this.scene.cameras.map(({ name }) => name)];
    const at = names.indexOf(this.viewer.cameras?.camera?.name ?? null);
    this.chooseCamera(names[(at + 1) % names.length], true);
  }

  /** @param {string|null} name Null for all. @param {boolean} [tell] */
  chooseCamera(name, tell = false) {
    const { cameras } = this.viewer;
    if (!cameras) return;
    cameras.choose(name);
    this.cameraSelect.value = cameras.camera?.name ?? "";
    if (tell) this.player.remember();
  }

  /** @param {number} sample What is said of its plans. */
  tell(sample) {
    const { scene, protocol } = this;
    if (sample < 0) return this.verdicts.replaceChildren();
    const models = this.shown();
    for (const model of models) markMoment(this.tracks.get(model.name), scene, sample, model.verdict(sample, this.judge()));
    return this.verdicts.replaceChildren(...verdictNodes(scene, models, sample, protocol, this.compare));
  }
}
