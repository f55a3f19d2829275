"use strict";
/* The first page: what this is, a scene that plays, the table that matters, a figure, and where to go on. */

const AFTER_S = 1.4, REST_S = 1.2, EXTENT_M = 22;
const STILL = matchMedia("(prefers-reduced-motion: reduce)");

/** Plays what happens around a scene's first contact, again and again. */
class Showing extends Player {
  words = element("div", { class: "showing-words" });
  button = element("button", { type: "button", "data-testid": "showing-play", onclick: () => this.toggle() }, "▶ Play");
  time = element("output", { class: "showing-time" });
  first = 0;
  last = 0;
  /** @type {Viewer|null} */
  viewer = null;

  /** Without the scene's script there is nothing to show. @param {unknown} error */
  giveUp(error) {
    if (!(error instanceof LoadError)) console.error(error);
    this.place.remove();
  }

  destroy() {
    super.destroy();
    this.viewer?.destroy();
  }

  /** @param {Scene} scene */
  begin(scene) {
    const names = scene.shown[0] ?? [];
    const models = scene.models.filter((model) => names.includes(model.name));
    const moment = decisive(scene, models, 0);
    const from = Math.max(moment - BEFORE_S, 0);
    [this.first, this.last] = [from, moment + AFTER_S].map((seconds) => frameAt(scene, seconds));
    this.frame = STILL.matches ? frameAt(scene, (from + moment) / 2) : this.first;
    const viewer = new Viewer(scene, () => ({ frame: this.frame, protocol: scene.protocols[0] ?? null, chosen: models,
      show: { bodies: true, recorded: true } }), (frame) => {
      this.time.textContent = `${scene.frames[frame].toFixed(1)} s`;
      this.place.dataset.frame = String(frame);
    });
    const above = element("canvas", { class: "showing-above", role: "img",
      "aria-label": `Scene ${scene.scene} from above, with the plans of ${names.join(", ")}` });
    viewer.addView(above, false).extent = EXTENT_M;
    const stage = element("div", { class: "showing-stage" }, above);
    if (scene.pictures.length && scene.cameras.length) {
      const cameras = element("canvas", { class: "showing-cameras", role: "img",
        "aria-label": "Its cameras, with the box of the adversary" });
      viewer.cameras = new Cameras(cameras, scene);
      stage.append(element("div", { class: "showing-side" }, cameras, this.words));
    }
    this.place.replaceChildren(stage);
    viewer.swatches = models.map((model) => swatch(model.name));
    const planners = models.map(({ name, shown, outcome = ["", ""] }, at) => element("li", {}, viewer.swatches[at],
      element("a", { href: address(["model", name]) }, shown), element("span", { class: outcome[0] }, outcome[1])));
    this.words.replaceChildren(
      kindLegend(scene, ["ego", "adversary"]),
      element("ul", { class: "showing-planners" }, planners),
      element("p", { class: "showing-do" }, this.button, this.time, element("a", { class: "button",
        href: address(["scene", scene.key], { model: names }) }, "All of this scene")),
      element("p", { class: "quiet showing-name" },
        [scene.scene, scene.manoeuvre, scene.description].filter(Boolean).join(" · ")));
    this.viewer = viewer;
    viewer.retheme();
    if (!STILL.matches) this.toggle();
  }

  toggle() {
    this.playing = !this.playing;
    this.button.textContent = this.playing ? "❚❚ Stop" : "▶ Play";
    this.tick = null;
    if (this.playing) requestAnimationFrame((now) => this.advance(now));
  }

  /** @param {number} now Milliseconds; by the clock, and from the start again after a rest. */
  advance(now) {
    const { first, last, viewer } = this;
    if (!this.playing || !viewer) return;
    const { frames } = viewer.scene;
    if (this.frame >= last && !this.tick) this.frame = first;
    this.tick ??= { now, seconds: frames[this.frame] };
    const seconds = this.tick.seconds + (now - this.tick.now) / 1000;
    while (this.frame < last && frames[this.frame + 1] <= seconds) this.frame += 1;
    if (seconds > frames[last] + REST_S) this.tick = null;
    viewer.draw();
    requestAnimationFrame((later) => this.advance(later));
  }
}

pages.start = (here) => {
  const { figures, keyTables, scenes, starts } = site();
  const data = asked(here, "data", starts.map((each) => each.data));
  const start = starts.find((each) => each.data === data);
  const stage = element("section", { class: "showing", "data-testid": "showing", "aria-label": "A scene that plays" });
  /** @type {Showing|null} */
  let showing = null;
  const key = keyTables.find((table) => table.data === data);
  const mine = figures.filter((figure) => figure.data === data);
  const figure = mine.find((each) => each.title.startsWith("Collision rate over the horizon")) ?? mine[0];
  return {
    title: "Overview",
    nodes: [
      element("h1", {}, "Driving planners against an adversary"),
      element("p", { class: "lead wide" }, start?.lead),
      pageChoice(here, "Data set", "data", starts.map((each) => each.data)),
      start?.scene ? stage : (scenes.length ? element("p", { class: "remark" }, "No scene has a sheet yet, so that none plays "
        + "here: ", element("code", {}, "challenger-bench sheets --split adv"), " makes them; then write the leaderboard "
        + "again.") : null),
      element("div", { class: "essence" },
        key ? tableView(key).node : element("p", { class: "quiet" }, "Protocol exact has judged nothing here yet."),
        figure ? figureView(figure) : null),
      element("nav", { class: "onwards", "aria-label": "Where to go on", "data-testid": "onwards" },
        (start?.onwards ?? []).map(([href, title, words]) => element("a", { href },
          element("strong", {}, title), element("span", {}, words)))),
    ],
    ready: () => { showing = start?.scene ? new Showing(stage, start.scene, {}) : null; },
    destroy: () => { hideNote(); showing?.destroy(); },
  };
};
