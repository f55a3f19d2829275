"use strict";
/* The scene player: what is played, how it is steered, and what is said of it in words. */
(() => {
  const player = window.ChallengerPlayer;
  const SAY_EVERY_MS = 1200, REMEMBER_EVERY_MS = 250;
  const { element } = player;

  /** A player in an element of the page. */
  class Player extends player.Layout {
    /** @param {HTMLElement} place @param {string} key @param {*} options See `mount`. */
    constructor(place, key, options) {
      super();
      Object.assign(this, { place, options, views: [], playing: false, speed: 1, frame: 0, timers: new Set() });
      this.stop = new AbortController();
      if (!place.dataset.testid) place.dataset.testid = "player";
      this.waiting = element("p", { class: "cp-loading", role: "status" }, "Loading the scene …");
      place.replaceChildren(this.waiting);
      player.load(key).then((scene) => {
        if (!this.stop.signal.aborted) this.begin(scene);
      }).catch((error) => this.giveUp(error));
    }

    /** Nobody waits for what will not come. @param {Error} error */
    giveUp(error) {
      if (this.stop.signal.aborted) return;
      // What the loader says is for readers; anything else is a fault in the script, and the console has it.
      const said = error instanceof player.LoadError;
      if (!said) console.error(error);
      this.destroy();
      this.place.replaceChildren(element("p", { class: "error", role: "alert", "data-testid": "error" }, said
        ? error.message : "The script of this scene is damaged; write the site again with challenger-bench leaderboard."));
    }

    destroy() {
      this.stop.abort();
      this.playing = false;
      cancelAnimationFrame(this.drawing);
      for (const timer of this.timers) clearTimeout(timer);
      for (const view of this.views) view.destroy();
      this.cameras?.destroy();
      this.watch?.disconnect();
      this.place.replaceChildren();
    }

    /** @param {*} scene Decoded. */
    begin(scene) {
      this.scene = scene;
      if (!scene.frames.length) {
        const why = "No record and no sheet has a sample of this scene.";
        this.place.replaceChildren(element("p", { class: "cp-loading" }, why));
        return;
      }
      this.names = this.order();
      this.places = [...new Set([...(this.options.models_order ?? []), ...this.names])];
      const { protocol } = this.options;
      this.protocol = scene.protocols.includes(protocol) ? protocol : scene.protocols[0] ?? null;
      this.chosen = this.firstChosen();
      this.compare = Boolean(this.options.compare) && this.chosen.length > 0;
      this.show = Object.fromEntries(player.TOGGLES.map(([name, , on]) => [name, on]));
      const first = this.chosen.map((name) => this.model(name));
      this.frame = this.frameAt(this.options.t ?? player.beginning(scene, first, this.protocol));
      this.build();
      this.listen();
      this.retheme();
      this.chooseCamera(this.options.camera ?? null, false);
      this.changed();
    }

    /** @returns {string[]} Names of the planners that ran, in the order of their lanes. */
    order() {
      const ran = this.scene.models.map((model) => model.name);
      const known = (this.options.models_available ?? []).filter((name) => ran.includes(name));
      return [...known, ...ran.filter((name) => !known.includes(name))];
    }

    /** @returns {string[]} Who is shown at first: who was asked for, else those whose verdicts differ. */
    firstChosen() {
      const asked = [...new Set(this.options.models ?? [])].filter((name) => this.names.includes(name));
      if (this.options.compare) return [...new Set([...asked, ...this.names])].slice(0, 2);
      if (asked.length) return asked;
      return player.differing(this.scene, this.names.map((name) => this.model(name)), this.protocol);
    }

    /** @param {string} name @returns {*} */
    model(name) {
      return this.scene.models.find((model) => model.name === name);
    }

    /** @returns {number} Number of the protocol; -1 if nothing was judged. */
    judge() {
      return this.scene.protocols.indexOf(this.protocol);
    }

    /** @param {string} name @returns {number[]} Samples that collide and count. */
    collisions(name) {
      return player.collisions(this.scene, this.model(name), this.protocol);
    }

    /** @param {number} seconds @returns {number} The nearest frame. */
    frameAt(seconds) {
      const { frames } = this.scene;
      let best = 0;
      for (let at = 1; at < frames.length; at++) {
        if (Math.abs(frames[at] - seconds) < Math.abs(frames[best] - seconds)) best = at;
      }
      return best;
    }

    // --- steering ------------------------------------------------------------------------------------------------------
    listen() {
      const { signal } = this.stop;
      document.addEventListener("keydown", (event) => this.press(event), { signal });
      this.watch = new MutationObserver(() => this.retheme());
      this.watch.observe(document.documentElement, { attributes: true, attributeFilter: ["data-theme"] });
      document.addEventListener("visibilitychange", () => { this.tick = null; }, { signal });
    }

    /** @param {KeyboardEvent} event */
    press(event) {
      const { target } = event;
      if (event.defaultPrevented || event.ctrlKey || event.metaKey || event.altKey || !(target instanceof Element)) return;
      if (target.closest("select, textarea, [contenteditable], input:not([type=range]):not([type=checkbox])")) return;
      const pressing = target.closest("button, a, summary, input[type=checkbox]");
      if (pressing && (event.key === " " || event.key === "Enter")) return;
      const act = this.actions(event.shiftKey)[event.key.length === 1 ? event.key.toLowerCase() : event.key];
      if (!act) return;
      event.preventDefault();
      act();
    }

    /** @param {boolean} shift @returns {Object<string, () => void>} What keys do. */
    actions(shift) {
      const each = (act) => () => { for (const view of this.views) act(view); };
      const step = (direction) => () => (shift ? this.stepSample(direction) : this.seek(this.frame + direction));
      const nudge = (x, y) => each((view) => view.nudge(x, y));
      const zoom = (factor) => each((view) => view.zoom(factor));
      return {
        __proto__: null,
        ArrowLeft: step(-1), ArrowRight: step(1), ArrowDown: step(-1), ArrowUp: step(1), " ": () => this.toggle(),
        Home: () => this.seek(0), End: () => this.seek(this.scene.frames.length - 1),
        PageUp: () => this.stepSample(-1), PageDown: () => this.stepSample(1),
        "[": () => this.jump(-1), "]": () => this.jump(1),
        "+": zoom(1.3), "=": zoom(1.3), "-": zoom(1 / 1.3), _: zoom(1 / 1.3), 0: each((view) => view.reset()),
        w: nudge(0, 1), s: nudge(0, -1), a: nudge(1, 0), d: nudge(-1, 0),
        h: () => this.turn(), c: () => this.nextCamera(),
      };
    }

    /** @param {number} frame */
    seek(frame) {
      const to = Math.min(Math.max(frame, 0), this.scene.frames.length - 1);
      this.tick = null;
      if (to === this.frame) return;
      this.frame = to;
      this.changed();
    }

    /** @param {number} direction To the sample before or after. */
    stepSample(direction) {
      const frames = this.scene.samples.map(({ frame }) => frame);
      this.seek(this.nearest(frames, direction) ?? (direction > 0 ? this.scene.frames.length - 1 : 0));
    }

    /** @param {number} direction To the collision before or after, of any planner that is shown. */
    jump(direction) {
      const samples = this.chosen.flatMap((name) => this.collisions(name)).sort((a, b) => a - b);
      const found = this.nearest(samples.map((sample) => this.scene.samples[sample].frame), direction);
      if (found !== undefined) this.seek(found);
    }

    /** @param {number[]} frames In order. @param {number} direction @returns {number|undefined} Next to the present one. */
    nearest(frames, direction) {
      return direction > 0 ? frames.find((frame) => frame > this.frame) : frames.findLast((frame) => frame < this.frame);
    }

    toggle() {
      const last = this.scene.frames.length - 1;
      this.playing = !this.playing;
      if (this.playing && this.frame === last) this.seek(0);
      this.playButton.textContent = this.playing ? "❚❚" : "▶";
      this.playButton.setAttribute("aria-label", this.playing ? "Stop" : "Play");
      this.playButton.title = this.playing ? "Stop" : "Play";
      this.tick = null;
      if (this.playing) requestAnimationFrame((now) => this.advance(now));
      else this.changed();
    }

    /** @param {number} now Milliseconds; plays by the clock, so that a slow machine leaves frames out. */
    advance(now) {
      if (!this.playing) return;
      const { frames } = this.scene;
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

    turn() {
      if (!this.scene.ego) return;
      for (const view of this.views) view.headingUp = !view.headingUp;
      for (const button of this.turns) button.textContent = this.views[0].headingUp ? "▲ heading up" : "▲ north up";
      this.redraw();
    }

    nextCamera() {
      if (!this.cameras) return;
      const names = [null, ...this.scene.cameras.map(({ name }) => name)];
      this.chooseCamera(names[(names.indexOf(this.cameras.camera?.name ?? null) + 1) % names.length]);
    }

    /** @param {string|null} name Null for all. @param {boolean} [tell] */
    chooseCamera(name, tell = true) {
      if (!this.cameras) return;
      this.cameras.choose(name);
      this.cameraSelect.value = this.cameras.camera?.name ?? "";
      if (tell) this.remember();
    }

    /** @returns {string} */
    theme() {
      return document.documentElement.dataset.theme === "dark" ? "dark" : "light";
    }

    retheme() {
      for (const view of this.views) view.theme = this.theme();
      if (this.cameras) {
        this.cameras.theme = this.theme();
        this.cameras.paint();
      }
      this.paintSwatches();
      if (this.choosers) this.fillChoosers();
      this.redraw();
    }

    // --- showing -------------------------------------------------------------------------------------------------------
    /** The frame, who is shown or who judges is another. */
    changed() {
      const { scene, frame } = this;
      const sample = scene.sampleOf[frame];
      const seconds = scene.frames[frame];
      this.scrub.value = String(frame);
      const place = sample < 0 ? "before the first sample" : `sample ${sample + 1} of ${scene.samples.length}`;
      this.time.textContent = `${seconds.toFixed(2)} s`;
      this.scrub.setAttribute("aria-valuetext", `${seconds.toFixed(2)} seconds, ${place}`);
      this.place.dataset.frame = String(frame);
      const told = JSON.stringify([sample, this.chosen, this.protocol]);
      if (told !== this.told) {
        this.told = told;
        this.tell(sample);
      }
      this.redraw();
      if (this.ready) this.remember();
      this.ready = true;
    }

    redraw() {
      if (this.drawing || !this.scrub) return;
      this.drawing = requestAnimationFrame(() => {
        this.drawing = 0;
        const chosen = this.chosen.map((name) => ({ model: this.model(name), place: this.places.indexOf(name) }));
        for (const [at, view] of this.views.entries()) {
          view.draw({
            frame: this.frame, protocol: this.judge(), exact: this.protocol === "exact", show: this.show,
            chosen: this.compare ? chosen.slice(at, at + 1) : chosen,
          });
        }
        this.cameras?.show(this.frame);
      });
    }

    /** Tells the page: at once if that was not just now, for browsers limit how often an address may change. */
    remember() {
      const told = () => {
        this.remembered = performance.now();
        this.options.onState?.({
          t: Math.round(100 * this.scene.frames[this.frame]) / 100, models: [...this.chosen], protocol: this.protocol,
          camera: this.cameras?.camera?.name ?? null,
        });
      };
      const wait = (this.remembered ?? -Infinity) + REMEMBER_EVERY_MS - performance.now();
      if (wait > 0) this.later("remember", wait, told);
      else if (!this.due?.remember) told();
    }

    /** Does something after a while, once. @param {string} what @param {number} after @param {() => void} act */
    later(what, after, act) {
      this.due = this.due ?? {};
      if (this.due[what]) return;
      const timer = setTimeout(() => {
        this.timers.delete(timer);
        this.due[what] = false;
        act();
      }, after);
      this.due[what] = true;
      this.timers.add(timer);
    }

    /** @param {number} sample What is said of its plans. */
    tell(sample) {
      if (sample < 0) return this.verdicts.replaceChildren();
      const { scene, protocol } = this;
      const models = this.chosen.map((name) => this.model(name));
      for (const model of models) {
        const verdict = model.verdict(sample, this.judge());
        const contact = verdict?.contact ?? null;
        const frame = contact === null ? null : this.frameAt(scene.samples[sample].t + contact);
        player.markMoment(this.tracks.get(model.name), scene, frame, contact !== null && player.fails(verdict));
      }
      this.verdicts.replaceChildren(...player.verdicts(scene, models, sample, protocol, this.compare));
      this.later("say", SAY_EVERY_MS, () => {
        const now = scene.sampleOf[this.frame];
        if (!this.playing && now >= 0) {
          this.live.textContent = player.sentence(scene, this.chosen.map((name) => this.model(name)), now, this.protocol);
        }
      });
      return undefined;
    }
  }

  /**
   * Put a player into the page.
   * @param {HTMLElement} place Its content is replaced. @param {string} key Key of the scene.
   * @param {{models?: string[], compare?: boolean, t?: number, protocol?: string, camera?: string,
   *   models_available?: string[], models_order?: string[],
   *   onState?: (state: {t: number, models: string[], protocol: string|null, camera: string|null}) => void}} options
   *   What is shown at first; ``models_available`` in the order of lanes,
   *   ``models_order`` all planners of the site in the order of colours.
   * @returns {{destroy: () => void}}
   */
  player.mount = (place, key, options = {}) => new Player(place, key, options);
})();
