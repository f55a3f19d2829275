"use strict";
/* The first page: the table that matters, a scene that plays, and all other results. */

const AFTER_S = 1.4, REST_S = 1.2, EXTENT_M = 22;
const STILL = matchMedia("(prefers-reduced-motion: reduce)");

/** Plays what happens around a scene's first contact, again and again. */
class Showing extends Viewer {
  time = element("output", { class: "showing-time" });

  /** @param {HTMLElement} place @param {Scene} scene @param {[string, string]|null} compare What compares two planners. */
  constructor(place, scene, compare) {
    super(place, scene, scene.protocols[0] ?? null);
    this.chosen = scene.shown[0] ?? [];
    const models = this.shown();
    const moment = decisive(scene, models, 0);
    const from = Math.max(moment - BEFORE_S, 0);
    [this.first, this.last] = [from, moment + AFTER_S].map((seconds) => frameAt(scene, seconds));
    this.frame = STILL.matches ? frameAt(scene, (from + moment) / 2) : this.first;
    this.playButton.dataset.testid = "showing-play";
    const planners = models.map(({ name, shown, outcome = ["", ""] }) => element("li", {}, swatch(name),
      element("a", { href: address(["model", name]) }, shown), element("span", { class: outcome[0] }, outcome[1])));
    const words = element("div", { class: "showing-words" },
      kindLegend(scene, ["ego", "adversary"]),
      element("ul", { class: "showing-planners" }, planners),
      element("p", { class: "showing-do" }, this.playButton, this.time, element("a", { class: "button",
        href: address(["scene", scene.key], { model: this.chosen }) }, "All of this scene"),
      compare && element("a", { href: compare[0] }, compare[1])),
      element("p", { class: "quiet showing-name" },
        [scene.scene, scene.manoeuvre, scene.description].filter(Boolean).join(" · ")));
    place.replaceChildren(element("div", { class: "showing-stage" },
      this.addView({ class: "showing-above",
        "aria-label": `Scene ${scene.scene} from above, with plans of ${this.chosen.join(", ")}` }, false, EXTENT_M),
      element("div", { class: "showing-side" }, this.addCameras({ class: "showing-cameras",
        "aria-label": "Its cameras, with the box of the adversary" }), words)));
    this.changed();
    if (!STILL.matches) this.toggle();
  }

  changed() {
    this.time.textContent = `${this.scene.frames[this.frame].toFixed(1)} s`;
    super.changed();
  }

  /** From the start again after a rest. @param {number} seconds */
  ended(seconds) {
    if (seconds < REST_S) return;
    this.tick = null;
    this.frame = this.first;
    this.changed();
  }
}

pages.results = (here) => {
  const { mainTables, scenes, starts } = site();
  const data = asked(here, "data", starts.map((each) => each.data));
  const start = starts.find((each) => each.data === data);
  const stage = element("section", { class: "showing", "data-testid": "showing", "aria-label": "A scene that plays" });
  let showing = /** @type {{destroy: () => void}|null} */ (null);
  const main = mainTables.find((table) => table.data === data);
  const page = tabPage(here, {
    tab: "results", title: "Driving planners against an adversary", lead: start?.lead ?? "",
    first: [
      element("p", { class: "splits" }, start?.splits),
      main ? tableView(main).node : element("p", { class: "quiet" }, "Protocol exact has judged nothing here yet."),
      start?.scene ? stage : scenes.length ? element("p", { class: "remark" }, "No scene has a sheet yet, so that none "
        + "plays here: ", element("code", {}, "challenger-bench sheets --split adv"), " makes them; then write the "
        + "leaderboard again.") : null,
    ],
  });
  return {
    ...page,
    ready() {
      // Without the scene's script there is nothing to show.
      if (!start?.scene) return;
      showing = playIn(stage, start.scene, (scene) => new Showing(stage, scene, start.compare), () => stage.remove());
    },
    destroy: () => showing?.destroy(),
  };
};
