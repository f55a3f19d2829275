"use strict";
/* The first page: what this is, a scene that plays, the table that matters, a figure, and where to go on. */

const AFTER_S = 1.4, REST_S = 1.2, EXTENT_M = 22;
const STILL = matchMedia("(prefers-reduced-motion: reduce)");

/** Plays what happens around a scene's first contact, again and again. */
class Showing {
  /** @param {SceneData} entry */
  constructor(entry) {
    this.entry = entry;
    this.stage = element("div", { class: "showing-stage" }, element("p", { class: "quiet" }, "Loading a scene …"));
    this.words = element("div", { class: "showing-words" });
    this.node = element("section", { class: "showing", "data-testid": "showing", "aria-label": "A scene that plays" },
      this.stage, this.words);
    this.button = element("button", { type: "button", "data-testid": "showing-play", onclick: () => this.toggle() }, "▶ Play");
    this.time = element("output", { class: "showing-time" });
    this.playing = false;
    this.gone = false;
    /** @type {number|null} */
    this.begun = null;
  }

  begin() {
    loadScene(this.entry.key).then((scene) => {
      if (!this.gone) this.build(scene);
    }).catch((error) => {
      if (!(error instanceof LoadError)) console.error(error);
      if (!this.gone) this.node.remove();
    });
  }

  destroy() {
    this.gone = true;
    this.playing = false;
    this.viewer?.destroy();
  }

  /** @param {Scene} scene */
  build(scene) {
    const protocol = scene.protocols[0] ?? null;
    const names = scene.shown[0] ?? [];
    const models = scene.models.filter((model) => names.includes(model.name));
    const moment = decisive(scene, models, 0);
    const from = Math.max(moment - BEFORE_S, 0);
    this.first = frameAt(scene, from);
    this.last = frameAt(scene, moment + AFTER_S);
    this.scene = scene;
    this.frame = STILL.matches ? frameAt(scene, (from + moment) / 2) : this.first;
    const above = element("canvas", { class: "showing-above", role: "img",
      "aria-label": `Scene ${scene.scene} from above, with the plans of ${names.join(", ")}` });
    const swatches = models.map((model) => swatch(model.name));
    const viewer = new Viewer(scene, () => ({
      frame: this.frame ?? 0, protocol, chosen: models, show: { bodies: true, recorded: true } }), (frame) => {
      this.time.textContent = `${scene.frames[frame].toFixed(1)} s`;
      this.node.dataset.frame = String(frame);
    });
    viewer.addView(above, false).extent = EXTENT_M;
    viewer.swatches.push(...swatches);
    this.viewer = viewer;
    /** @type {HTMLElement[]} */
    const nodes = [above];
    if (scene.pictures.length && scene.cameras.length) {
      const cameras = element("canvas", { class: "showing-cameras", role: "img",
        "aria-label": "Its cameras, with the box of the adversary" });
      viewer.cameras = new Cameras(cameras, scene);
      nodes.push(element("div", { class: "showing-side" }, cameras, this.words));
    }
    this.stage.replaceChildren(...nodes);
    this.describe(scene, models, swatches);
    viewer.retheme();
    if (!STILL.matches) this.toggle();
  }

  /** What is seen, in words, and what can be done.
   * @param {Scene} scene @param {Planner[]} models @param {HTMLCanvasElement[]} swatches */
  describe(scene, models, swatches) {
    const planners = models.map(({ name, shown, outcome = ["", ""] }, at) => element("li", {}, swatches[at],
      element("a", { href: address(["model", name]) }, shown), element("span", { class: outcome[0] }, outcome[1])));
    this.words.replaceChildren(
      kindLegend(scene, ["ego", "adversary"]),
      element("ul", { class: "showing-planners" }, planners),
      element("p", { class: "showing-do" }, this.button, this.time, element("a", { class: "button",
        href: address(["scene", this.entry.key], { model: models.map(({ name }) => name) }) }, "All of this scene")),
      element("p", { class: "quiet showing-name" },
        [scene.scene, scene.manoeuvre, scene.description].filter(Boolean).join(" · ")));
  }

  toggle() {
    this.playing = !this.playing;
    this.button.textContent = this.playing ? "❚❚ Stop" : "▶ Play";
    this.begun = null;
    if (this.playing) requestAnimationFrame((now) => this.advance(now));
  }

  /** @param {number} now Milliseconds; by the clock, and from the start again after a rest. */
  advance(now) {
    const { scene, first = 0, last = 0 } = this;
    if (!this.playing || !scene) return;
    let frame = this.frame ?? first;
    if (frame >= last && this.begun === null) frame = first;
    this.begun ??= now - 1000 * (scene.frames[frame] - scene.frames[first]);
    const seconds = scene.frames[first] + (now - this.begun) / 1000;
    if (seconds > scene.frames[last] + REST_S) {
      this.begun = now;
      frame = first;
    }
    while (frame < last && scene.frames[frame + 1] <= seconds) frame += 1;
    this.frame = frame;
    this.viewer?.draw();
    requestAnimationFrame((later) => this.advance(later));
  }
}

pages.start = (here) => {
  const { figures, keyTables, scenes, starts } = site();
  const data = asked(here, "data", starts.map((each) => each.data));
  const start = starts.find((each) => each.data === data);
  const scene = scenes.find((each) => each.key === start?.scene);
  const showing = scene ? new Showing(scene) : null;
  const key = keyTables.find((table) => table.data === data);
  const mine = figures.filter((figure) => figure.data === data);
  const figure = mine.find((each) => each.title.startsWith("Collision rate over the horizon")) ?? mine[0];
  return {
    title: "Overview",
    nodes: [
      element("h1", {}, "Driving planners against an adversary"),
      element("p", { class: "lead wide" }, start?.lead),
      element("div", { class: "toolbar" }, pageChoice(here, "Data set", "data", starts.map((each) => each.data))),
      showing?.node ?? (scenes.length ? element("p", { class: "remark" }, "No scene has a sheet yet, so that none plays "
        + "here: ", element("code", {}, "challenger-bench sheets --split adv"), " makes them; then write the leaderboard "
        + "again.") : null),
      element("div", { class: "essence" },
        key ? tableView(key).node : element("p", { class: "quiet" }, "Protocol exact has judged nothing here yet."),
        figure ? figureView(figure) : null),
      element("nav", { class: "onwards", "aria-label": "Where to go on", "data-testid": "onwards" },
        (start?.onwards ?? []).map(([href, title, words]) => element("a", { href },
          element("strong", {}, title), element("span", {}, words)))),
    ],
    ready: () => showing?.begin(),
    destroy: () => { hideNote(); showing?.destroy(); },
  };
};
