"use strict";
/* The scene player, part 8: its elements. */
(() => {
  const player = window.ChallengerPlayer;
  const SPEEDS = [0.25, 0.5, 1, 2, 4];
  const KINDS = [
    ["ego", "ego, as recorded"], ["adversary", "A: adversary"], ["vehicle", "vehicle"], ["cycle", "two-wheeler"],
    ["person", "person"], ["thing", "object"],
  ];
  const KEYS = [
    ["← →", "one frame"], ["Shift + ← →", "one sample"], ["Space", "play or stop"], ["Home, End", "first, last frame"],
    ["[ ]", "collision before, after"], ["+ −", "zoom"], ["W A S D", "move the view"], ["0", "view as at first"],
    ["H", "heading or north up"], ["C", "next camera"],
  ];
  const MARKS = "✕ a plan made then collides, ┃ where the present one first does, ? the planner failed";
  const MARKS_BY_WHOM = "✕ a plan made then hits the adversary, ◇ another, – whom is not said, ┃ where the present one does, "
    + "? the planner failed";
  const TOGGLES = [
    ["recorded", "recorded ways", true], ["bodies", "footprints", true], ["forecasts", "forecasts", false],
    ["modes", "other modes", false], ["considered", "what the adversary considered", true],
  ];

  const TIMES_S = [1, 2, 5, 10, 20, 60, 300], MOST_TIMES = 12;

  const { element } = player;
  const option = (value, words, selected) => element("option", { value, selected }, words);

  /** Makes the elements of a player; what they do is said in player.js. */
  class Layout {
    build() {
      const { compare } = this;
      this.verdicts = element("div", { class: "cp-verdicts", "data-testid": "player-verdicts" });
      const side = this.buildCameras();
      this.live = element("p", { class: "cp-unseen", "aria-live": "polite", "data-testid": "player-live" });
      this.root = element("div", { class: compare ? "cp cp-compare" : "cp" },
        element("div", { class: "cp-stage" }, this.buildViews(), side),
        this.buildTransport(), this.buildLanes(), this.buildChoices(), this.live, this.buildKeys());
      this.place.replaceChildren(this.root);
    }

    buildViews() {
      const { compare } = this;
      const slots = compare ? this.chosen.map((_, slot) => slot) : [null];
      const figures = slots.map((slot) => {
        const canvas = element("canvas", {
          class: "cp-birdseye", "data-testid": "player-birdseye", tabindex: "0", role: "img",
          "aria-label": slot === null ? "The scene from above" : "The scene from above with one planner's plan",
        });
        const view = new player.BirdsEye(canvas, this.scene, () => this.redraw());
        this.views.push(view);
        const chooser = slot === null ? null : this.buildChooser(slot);
        return element("figure", { class: "cp-view" }, chooser, canvas, this.buildTools());
      });
      return element("div", { class: "cp-views" }, ...figures);
    }

    /** @param {number} slot 0 on the left. @returns {HTMLElement} A select of planners. */
    buildChooser(slot) {
      const swatch = element("canvas", { class: "cp-swatch", width: 48, height: 28, "aria-hidden": "true" });
      const select = element("select", {
        "data-testid": slot ? "compare-b" : "compare-a",
        "aria-label": slot ? "Planner on the right" : "Planner on the left",
        change: () => {
          const other = this.chosen[1 - slot];
          const before = this.chosen[slot];
          this.chosen[slot] = select.value;
          if (other === select.value) this.chosen[1 - slot] = before;
          this.fillChoosers();
          this.fillLanes();
          this.changed();
        },
      }, ...this.names.map((name) => option(name, name)));
      this.choosers = [...(this.choosers ?? []), { select, swatch, slot }];
      return element("figcaption", {}, swatch, select);
    }

    /** @returns {HTMLElement} Buttons on a view. */
    buildTools() {
      // Both views of a comparison move together.
      const both = (act) => () => { for (const each of this.views) act(each); };
      const button = (words, label, act) => element("button",
        { type: "button", title: label, "aria-label": label, click: act }, words);
      const turn = button("▲ heading up", "Turn: heading or north up", () => this.turn());
      turn.dataset.testid = "player-turn";
      turn.hidden = !this.scene.ego;
      this.turns = [...(this.turns ?? []), turn];
      return element("div", { class: "cp-tools" }, turn,
        button("+", "Zoom in", both((each) => each.zoom(1.3))),
        button("−", "Zoom out", both((each) => each.zoom(1 / 1.3))),
        button("reset", "View as at first", both((each) => each.reset())));
    }

    buildCameras() {
      const { scene } = this;
      const there = new Set(["ego", ...scene.agents.map((agent) => (agent.adversary ? "adversary" : agent.kind))]);
      const note = element("div", { class: "cp-legend" }, ...KINDS.filter(([kind]) => there.has(kind))
        .map(([kind, words]) => element("span", { class: `cp-kind cp-${kind}` },
          scene.driven && kind === "ego" ? "ego, as driven" : words)));
      if (!scene.pictures.length || !scene.cameras.length) {
        const why = scene.driven ? "Records of drives hold no pictures; challenger-bench film --drives shows what cameras saw."
          : scene.hasSheet ? "The sheet of this scene has no pictures of cameras."
          : "Without a sheet, plans stand in the frame of the ego at each sample.";
        return element("div", { class: "cp-side" }, element("p", { class: "cp-note" }, why), note, this.verdicts);
      }
      const canvas = element("canvas", {
        class: "cp-cameras", "data-testid": "player-cameras", role: "img",
        "aria-label": "Pictures of the cameras with the box of the adversary",
        click: ({ offsetX, offsetY }) => {
          this.chooseCamera(this.cameras.camera ? null : this.cameras.cameraAt(offsetX, offsetY));
        },
      });
      this.cameras = new player.Cameras(canvas, scene);
      this.cameraSelect = element("select", {
        "data-testid": "player-camera", change: () => this.chooseCamera(this.cameraSelect.value || null),
      }, option("", "all cameras"), ...scene.cameras.map(({ name }) => option(name, name)));
      return element("div", { class: "cp-side" }, canvas,
        element("div", { class: "cp-under" },
          element("label", { class: "cp-field" }, "Camera ", this.cameraSelect), note),
        this.verdicts);
    }

    buildTransport() {
      const button = (words, label, act, id) => element("button", {
        type: "button", title: label, "aria-label": label, click: act, "data-testid": id ?? null,
      }, words);
      this.playButton = button("▶", "Play", () => this.toggle(), "player-play");
      this.time = element("output", { class: "cp-time", "data-testid": "player-time" });
      const speed = element("select", {
        "aria-label": "Speed", change: () => { this.speed = Number(speed.value); this.tick = null; },
      }, ...SPEEDS.map((value) => option(value, `${value}×`, value === 1)));
      const protocol = element("select", {
        "data-testid": "player-protocol",
        change: () => { this.protocol = protocol.value; this.fillLanes(); this.changed(); },
      }, ...this.scene.protocols.map((name) => option(name, name, name === this.protocol)));
      return element("div", { class: "cp-transport" },
        button("|◀", "First frame", () => this.seek(0)), button("◀", "One frame back", () => this.seek(this.frame - 1)),
        this.playButton, button("▶|", "One frame on", () => this.seek(this.frame + 1), "player-step"),
        button("◂✕", "Collision before", () => this.jump(-1), "player-collision-before"),
        button("✕▸", "Next collision", () => this.jump(1), "player-collision-next"),
        speed, this.time,
        this.scene.protocols.length ? element("label", { class: "cp-field" }, "Protocol ", protocol) : null);
    }

    buildLanes() {
      const last = this.scene.frames.length - 1;
      this.scrub = element("input", {
        type: "range", min: 0, max: last, step: 1, value: this.frame, "data-testid": "player-scrub", "aria-label": "Time",
        input: () => this.seek(Number(this.scrub.value)),
      });
      const marks = this.scene.samples.map(({ frame }, number) => {
        const tick = element("i", number % 2 ? {} : { class: "cp-second" });
        tick.style.left = player.along(this.scene, frame);
        return tick;
      });
      const ticks = element("div", { class: "cp-ticks", "aria-hidden": "true" }, ...marks, ...this.buildTimes());
      this.lanes = element("div", { class: "cp-lanes" });
      /** @type {Map<string, HTMLCanvasElement>} */
      this.swatches = new Map();
      /** @type {Map<string, HTMLElement>} */
      this.tracks = new Map();
      this.fillLanes();
      if (this.choosers) this.fillChoosers();
      return element("div", { class: "cp-line" },
        element("div", { class: "cp-row" },
          element("span", { class: "cp-name cp-quiet" }, this.compare ? "" : "planners"),
          element("div", { class: "cp-track cp-range" }, this.scrub, ticks)),
        this.lanes);
    }

    /** @returns {HTMLElement[]} Round times, as many as can be read beside each other. */
    buildTimes() {
      const { frames } = this.scene;
      const length = frames.at(-1);
      const step = TIMES_S.find((seconds) => length / seconds <= MOST_TIMES) ?? TIMES_S.at(-1);
      return Array.from({ length: Math.floor(length / step + 1e-6) + 1 }, (_, at) => {
        const time = element("span", { class: "cp-when" }, `${at * step}${at ? "" : " s"}`);
        time.style.left = player.along(this.scene, this.frameAt(at * step));
        return time;
      });
    }

    fillLanes() {
      this.lanes.replaceChildren(...(this.compare ? this.chosen : this.names).map((name) => this.buildLane(name)));
      this.paintSwatches();
    }

    /** @param {string} name @returns {HTMLElement} */
    buildLane(name) {
      const { compare } = this;
      const swatch = element("canvas", { class: "cp-swatch", width: 48, height: 28, "aria-hidden": "true" });
      this.swatches.set(name, swatch);
      const model = this.model(name);
      const track = element("div", { class: "cp-track" });
      this.tracks.set(name, track);
      const fill = () => player.fillTrack(
        track, this.scene, this.chosen.includes(name) ? model : null, this.protocol, (frame) => this.seek(frame));
      const box = compare ? null : element("input", {
        type: "checkbox", value: name, checked: this.chosen.includes(name), "data-testid": "player-model",
        change: () => {
          this.chosen = this.names.filter((each) => (each === name ? box.checked : this.chosen.includes(each)));
          fill();
          this.changed();
        },
      });
      fill();
      return element("div", { class: "cp-row" },
        element("label", { class: "cp-name", title: name }, box, swatch, element("span", {}, name, ...player.marks(model))), track);
    }

    buildChoices() {
      const there = TOGGLES.filter(([name]) => name !== "considered" || this.scene.considered.length);
      const choices = there.map(([name, words]) => {
        const box = element("input", {
          type: "checkbox", checked: this.show[name], "data-testid": `player-show-${name}`,
          change: () => { this.show[name] = box.checked; this.redraw(); },
        });
        return element("label", {}, box, ` ${words}`);
      });
      return element("div", { class: "cp-choices", role: "group", "aria-label": "What is drawn" }, ...choices,
        element("span", { class: "cp-quiet" }, this.scene.adversarial ? MARKS_BY_WHOM : MARKS));
    }

    buildKeys() {
      return element("details", { class: "cp-keys" }, element("summary", {}, "Keys"),
        element("dl", {}, ...KEYS.flatMap(([keys, words]) => [element("dt", {}, keys), element("dd", {}, words)])));
    }

    fillChoosers() {
      for (const { select, swatch, slot } of this.choosers) {
        select.value = this.chosen[slot];
        this.paintSwatch(swatch, this.chosen[slot]);
      }
    }

    paintSwatches() {
      for (const [name, swatch] of this.swatches) this.paintSwatch(swatch, name);
    }

    /** @param {HTMLCanvasElement} canvas @param {string} name */
    paintSwatch(canvas, name) {
      player.paintSwatch(canvas, player.styleOf(this.places.indexOf(name), this.theme()));
    }
  }

  Object.assign(player, { Layout, TOGGLES });
})();
