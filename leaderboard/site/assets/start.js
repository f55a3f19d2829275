"use strict";
/* The first page: what this is, a scene that plays, the table that matters, a figure, and where to go on. */
(() => {
  const site = window.ChallengerSite;
  const player = window.ChallengerPlayer;
  const { AddressError, address, choice, counted, element, own, pages, unique } = site;

  const AFTER_S = 1.4, REST_S = 1.2, EXTENT_M = 22;
  const still = matchMedia("(prefers-reduced-motion: reduce)");

  // --- which scene -----------------------------------------------------------------------------------------------------
  /** @param {string} data @returns {*} The scene with a sheet on which plain planners differ most; adversarial ones first. */
  function tellingScene(data) {
    const { models, scenes, protocols } = window.CHALLENGER;
    const plain = models.filter((model) => !model.privileged).map((model) => model.name);
    const verdicts = (scene) => (plain.length ? plain : Object.keys(scene.verdicts))
      .map((name) => own(own(scene.verdicts, name) ?? {}, protocols[0] ?? "exact"));
    const ranked = scenes.filter((scene) => scene.data === data && scene.hasSheet && scene.thumb).map((scene, place) => {
      const found = verdicts(scene);
      const [bad, clear] = [true, false].map((value) => found.filter((each) => each === value).length);
      return { scene, rank: [scene.manoeuvre ? 1 : 0, Math.min(bad, clear), bad, -place] };
    });
    ranked.sort((a, b) => {
      const at = a.rank.findIndex((value, index) => value !== b.rank[index]);
      return at < 0 ? 0 : b.rank[at] - a.rank[at];
    });
    return ranked[0]?.scene ?? null;
  }

  // --- a scene that plays ------------------------------------------------------------------------------------------------
  /** Plays what happens around a scene's first contact, again and again. */
  class Showing {
    /** @param {*} entry Of the index. */
    constructor(entry) {
      Object.assign(this, { entry, drawing: 0, playing: false, gone: false });
      this.stage = element("div", { class: "showing-stage" },
        element("p", { class: "quiet" }, "Loading a scene …"));
      this.words = element("div", { class: "showing-words" });
      this.node = element("section", { class: "showing", "data-testid": "showing", "aria-label": "A scene that plays" },
        this.stage, this.words);
    }

    begin() {
      player.load(this.entry.key).then((scene) => {
        if (!this.gone) this.build(scene);
      }).catch((error) => {
        if (!(error instanceof player.LoadError)) console.error(error);
        if (!this.gone) this.node.remove();
      });
    }

    destroy() {
      this.gone = true;
      this.playing = false;
      cancelAnimationFrame(this.drawing);
      this.view?.destroy();
      this.cameras?.destroy();
      this.watch?.disconnect();
    }

    /** @param {*} scene Decoded. */
    build(scene) {
      this.scene = scene;
      const order = window.CHALLENGER.models.map((model) => model.name);
      const ran = order.map((name) => scene.models.find((model) => model.name === name)).filter(Boolean);
      this.protocol = scene.protocols[0] ?? null;
      const names = player.differing(scene, ran, this.protocol);
      this.models = names.map((name) => scene.models.find((model) => model.name === name));
      this.chosen = this.models.map((model) => ({ model, place: order.indexOf(model.name) }));
      const [from, moment] = [player.beginning, player.decisive].map((of) => of(scene, this.models, this.protocol));
      [this.first, this.last] = [from, moment + AFTER_S].map((seconds) => this.frameAt(seconds));
      this.frame = still.matches ? this.frameAt((from + moment) / 2) : this.first;
      const canvas = (kind, words) => element("canvas", { class: kind, role: "img", "aria-label": words });
      const above = canvas("showing-above", `Scene ${scene.scene} from above, with the plans of ${names.join(", ")}`);
      this.view = new player.BirdsEye(above, scene, () => this.draw(), false);
      this.view.extent = EXTENT_M;
      const nodes = [above];
      if (scene.pictures.length && scene.cameras.length) {
        const cameras = canvas("showing-cameras", "Its cameras, with the box of the adversary");
        this.cameras = new player.Cameras(cameras, scene);
        nodes.push(element("div", { class: "showing-side" }, cameras, this.words));
      }
      this.stage.replaceChildren(...nodes);
      this.describe();
      this.watch = new MutationObserver(() => this.draw());
      this.watch.observe(document.documentElement, { attributes: true, attributeFilter: ["data-theme"] });
      this.draw();
      if (!still.matches) this.toggle();
    }

    /** What is seen, in words, and what can be done. */
    describe() {
      const { entry, scene } = this;
      this.button = element("button", { type: "button", "data-testid": "showing-play", onclick: () => this.toggle() },
        "▶ Play");
      this.time = element("output", { class: "showing-time" });
      const kinds = [["ego", "ego, as recorded"], ...(scene.agents.some((agent) => agent.adversary)
        ? [["adversary", "A: adversary"]] : [])];
      this.swatches = this.chosen.map(({ place }) => [place,
        element("canvas", { class: "cp-swatch", width: 48, height: 28, "aria-hidden": "true" })]);
      const planners = this.models.map((model, at) => {
        const [kind, words] = this.outcome(model);
        return element("li", {}, this.swatches[at][1], element("a", { href: address(["model", model.name]) },
          site.marked(model)), element("span", { class: kind }, words));
      });
      this.words.replaceChildren(
        element("p", { class: "cp-legend" }, kinds.map(([kind, words]) =>
          element("span", { class: `cp-kind cp-${kind}` }, words))),
        element("ul", { class: "showing-planners" }, planners),
        element("p", { class: "showing-do" }, this.button, this.time,
          element("a", { class: "button", href: address(["scene", entry.key], { model: this.models.map(({ name }) => name) }) },
            "All of this scene")),
        element("p", { class: "quiet showing-name" }, [entry.scene, entry.manoeuvre, entry.description].filter(Boolean)
          .join(" · ")));
    }

    /** @param {*} model @returns {[string, string]} What its plans come to: class and words. */
    outcome(model) {
      const { scene } = this;
      const first = (...whom) => player.firstContact(scene, [model], this.protocol, (verdict) => whom.includes(verdict.whom));
      const [contact, other] = [first("anybody", "adversary"), first("other")];
      if (contact !== null) {
        return ["bad", `✕ would ${scene.adversarial ? "hit the adversary" : "collide"} at ${contact.toFixed(1)} s`];
      }
      if (other !== null) return ["other", `◇ would hit another than the adversary at ${other.toFixed(1)} s`];
      return first("unsaid") === null ? ["good", "○ stays clear"] : ["open", "– would collide; with whom is not said"];
    }

    /** @param {number} seconds @returns {number} The nearest frame. */
    frameAt(seconds) {
      const apart = this.scene.frames.map((each) => Math.abs(each - seconds));
      return apart.indexOf(Math.min(...apart));
    }

    toggle() {
      this.playing = !this.playing;
      this.button.textContent = this.playing ? "❚❚ Stop" : "▶ Play";
      this.begun = null;
      if (this.playing) requestAnimationFrame((now) => this.advance(now));
    }

    /** @param {number} now Milliseconds; by the clock, and from the start again after a rest. */
    advance(now) {
      if (!this.playing) return;
      const { frames } = this.scene;
      if (this.frame >= this.last && !this.begun) this.frame = this.first;
      this.begun ??= now - 1000 * (frames[this.frame] - frames[this.first]);
      const seconds = frames[this.first] + (now - this.begun) / 1000;
      if (seconds > frames[this.last] + REST_S) {
        this.begun = now;
        this.frame = this.first;
      }
      let next = this.frame;
      while (next < this.last && frames[next + 1] <= seconds) next += 1;
      if (next !== this.drawn) {
        this.frame = next;
        this.draw();
      }
      requestAnimationFrame((later) => this.advance(later));
    }

    draw() {
      if (this.drawing || !this.view) return;
      this.drawing = requestAnimationFrame(() => {
        this.drawing = 0;
        const theme = document.documentElement.dataset.theme === "dark" ? "dark" : "light";
        this.view.theme = theme;
        this.view.draw({
          frame: this.frame, protocol: this.scene.protocols.indexOf(this.protocol), exact: this.protocol === "exact",
          show: { forecasts: false, modes: false, bodies: true, recorded: true }, chosen: this.chosen,
        });
        if (this.cameras) {
          this.cameras.theme = theme;
          this.cameras.show(this.frame);
          if (this.painted !== theme) this.cameras.paint();
        }
        if (this.painted !== theme) {
          for (const [place, swatch] of this.swatches) player.paintSwatch(swatch, player.styleOf(place, theme));
        }
        this.painted = theme;
        this.drawn = this.frame;
        this.time.textContent = `${this.scene.frames[this.frame].toFixed(1)} s`;
        this.node.dataset.frame = String(this.frame);
      });
    }
  }

  // --- the page ----------------------------------------------------------------------------------------------------------
  /** @param {string} data @returns {HTMLElement} What this is. */
  function introduction(data) {
    const { models, scenes } = window.CHALLENGER;
    const here = scenes.filter((scene) => !data || scene.data === data);
    const adversarial = here.filter((scene) => scene.manoeuvre).length;
    return element("p", { class: "lead wide" },
      "challenger-bench tests end-to-end driving models on driving scenes in which one other car was made to drive "
      + "adversarially: it cuts in, brakes, squeezes or tailgates. ",
      "Every half second a planner says where it wants to drive for the next 3 s, and what is counted is how often that "
      + "would hit something, under named protocols that never share a column. ",
      `Here are ${counted(models.length, "planner")} on ${counted(here.length, "scene")}${
        adversarial ? `, ${adversarial} of them adversarial` : ""}: every number with its interval, every scene to play.`);
  }

  /** @param {string} data @param {*} scene The one that plays. @returns {HTMLElement} Where to go on. */
  function onwards(data, scene) {
    const { attempts, models, scenes, tables, protocols } = window.CHALLENGER;
    const compared = scene ?? scenes.find((each) => each.data === data && Object.keys(each.verdicts).length > 1);
    const [a, b] = compared ? site.pairOf(compared, protocols[0] ?? "exact") : [];
    const of = (list) => list.filter((each) => each.data === data || each.data === "").length;
    const several = unique(scenes.map((each) => each.data)).length > 1;
    const cards = [
      [["tables"], several ? { data } : {}, counted(of(tables), "table"),
        "Every protocol, transfer between planners, causes, what protocols miss and invent."],
      [["models"], several ? { data } : {}, counted(models.length, "planner"),
        "Rates under every protocol, why it collides, its worst scenes, what exactly ran."],
      [["scenes"], several ? { data } : {}, counted(of(scenes), "scene"),
        "By manoeuvre, by who fails and who does not; each plays, with all plans."],
      attempts.length ? [["attempts"], {}, counted(attempts.length, "attempt"),
        "Vehicles that the search tried as adversaries, and why most were discarded."] : null,
      b ? [["compare", compared.key], { a, b }, "Two side by side",
        `${a} and ${b} on ${scene ? "the scene above" : compared.scene}, moment by moment.`] : null,
    ].filter(Boolean);
    return element("nav", { class: "onwards", "aria-label": "Where to go on", "data-testid": "onwards" },
      cards.map(([parts, params, title, words]) => element("a", { href: address(parts, params) },
        element("strong", {}, title), element("span", {}, words))));
  }

  pages.start = (here) => {
    const { figures, keyTables, scenes } = window.CHALLENGER;
    const names = unique([...keyTables.map((table) => table.data), ...scenes.map((scene) => scene.data)]);
    const data = here.params.get("data") ?? names[0] ?? "";
    if (names.length && !names.includes(data)) throw new AddressError(`There is no data set called “${data}”.`);
    const scene = tellingScene(data);
    const showing = scene ? new Showing(scene) : null;
    const key = keyTables.find((table) => table.data === data);
    const mine = figures.filter((figure) => figure.data === data);
    const figure = mine.find((each) => each.title.startsWith("Collision rate over the horizon")) ?? mine[0];
    return {
      title: "Overview",
      nodes: [
        element("h1", {}, "Driving planners against an adversary"),
        introduction(data),
        names.length > 1 ? element("div", { class: "toolbar" }, choice({ label: "Data set", value: data, choices: names,
          testid: "filter-data", change: (value) => { location.hash = address([], { data: value }); } })) : null,
        showing?.node ?? (scenes.length ? element("p", { class: "remark" }, "No scene has a sheet yet, so that none plays "
          + "here: ", element("code", {}, "challenger-bench sheets --split adv"), " makes them; then write the leaderboard "
          + "again.") : null),
        element("div", { class: "essence" },
          key ? site.tableView(key).node : element("p", { class: "quiet" }, "Protocol exact has judged nothing here yet."),
          figure ? site.figureView(figure) : null),
        onwards(data, scene),
      ].filter((node) => node !== null),
      ready: () => showing?.begin(),
      destroy: () => { site.hideNote(); showing?.destroy(); },
    };
  };
})();
