"use strict";
/* The scene player, part 4: the scene from above, drawn from vectors. */
(() => {
  const player = window.ChallengerPlayer;
  const { THEMES, styleOf, star, traceShape, cut } = player;
  const PAST_S = 2, FUTURE_S = 3;
  const FONT = (size) => `600 ${size}px system-ui, "Liberation Sans", sans-serif`;

  /** Draws frames. */
  class BirdsEye extends player.GroundView {
    /**
     * @param {{frame: number, chosen: {model: *, place: number}[], protocol: number, exact: boolean,
     *   show: {forecasts: boolean, modes: boolean, bodies: boolean, recorded: boolean,
     *   considered: boolean}}} state
     */
    draw(state) {
      if (!this.fit()) return;
      const sample = this.scene.sampleOf[state.frame];
      this.state = state;
      this.sample = sample;
      this.colours = THEMES[this.theme];
      this.place(state.frame);
      this.drawGround();
      const plans = sample < 0 ? [] : state.chosen.map(({ model, place }) => ({
        model, plan: model.at(sample), style: styleOf(place, this.theme),
        verdict: model.verdict(sample, state.protocol),
      })).filter(({ plan }) => plan && plan.failed === undefined);
      if (state.show.recorded) {
        this.drawRecordedPath();
        this.drawWays();
      }
      if (state.show.considered) this.drawConsidered();
      const age = sample < 0 ? 0 : this.scene.frames[state.frame] - this.scene.samples[sample].t;
      this.context.globalAlpha = Math.max(1 - 0.8 * age, 0.45);
      for (const each of plans) this.drawExpectations(each);
      this.context.globalAlpha = 1;
      this.drawAgents();
      this.drawEgo(state.frame);
      const reversed = [...plans].reverse();
      this.context.globalAlpha = Math.max(1 - 0.8 * age, 0.45);
      for (const each of reversed) this.drawPlan(each);
      this.context.globalAlpha = 1;
      /** @type {[number, number, number][]} Left, middle and width of what is written. */
      this.labels = [];
      for (const each of reversed) this.drawContact(each, age);
      this.drawEnd();
      this.drawScale();
    }

    drawGround() {
      const { context, colours, ratio } = this;
      const { ground } = this.scene;
      context.setTransform(ratio, 0, 0, ratio, 0, 0);
      context.fillStyle = colours.land;
      context.fillRect(0, 0, this.width, this.height);
      if (!this.scene.hasSheet) this.drawGrid();
      context.setTransform(...this.matrix.map((value) => value * ratio));
      for (const name of ["walkways", "carparks"]) {
        context.fillStyle = colours[name];
        context.fill(ground[name], "evenodd");
      }
      context.strokeStyle = colours.kerb;
      context.lineWidth = 0.5;
      context.stroke(ground.drivable);
      context.fillStyle = colours.road;
      context.fill(ground.drivable, "evenodd");
      context.fillStyle = colours.crossings;
      context.fill(ground.crossings, "evenodd");
      context.lineWidth = Math.max(0.15, 1 / this.scale);
      for (const [paint, path] of ground.dividers) {
        const [pattern, colour] = paint.includes("-") ? paint.split("-") : ["solid", paint];
        context.strokeStyle = colours[colour] ?? colours.unpainted;
        context.setLineDash(pattern === "dashed" ? [2, 2.5] : []);
        context.stroke(path);
      }
      context.setLineDash([]);
      context.setTransform(ratio, 0, 0, ratio, 0, 0);
    }

    /** Squares of ten metres, where there is no map. */
    drawGrid() {
      const { context } = this;
      const reach = Math.ceil(this.radius / 10) * 10;
      const [x, y] = this.middle.map((metres) => Math.round(metres / 10) * 10);
      context.strokeStyle = this.colours.grid;
      context.lineWidth = 1;
      context.beginPath();
      for (let at = -reach; at <= reach; at += 10) {
        context.moveTo(...this.pixel(x + at, y - reach));
        context.lineTo(...this.pixel(x + at, y + reach));
        context.moveTo(...this.pixel(x - reach, y + at));
        context.lineTo(...this.pixel(x + reach, y + at));
      }
      context.stroke();
    }

    /** Of a drive: where the recorded ego went. */
    drawRecordedPath() {
      if (!this.scene.recordedPath) return;
      this.context.globalAlpha = 0.6;
      this.line(this.scene.recordedPath, this.colours.ego, 2, [5, 6]);
      this.context.globalAlpha = 1;
    }

    /** Of a drive: what an adversary considered at the planning frame in force, the driven one thick. */
    drawConsidered() {
      const { considered, frames } = this.scene;
      const now = considered.findLast(({ t }) => t <= frames[this.state.frame] + 0.001);
      if (!now) return;
      for (const [at, path] of now.paths.entries()) {
        this.context.globalAlpha = 0.7 - 0.5 * now.shares[at];
        this.line(path, this.colours.adversary, 1);
      }
      this.context.globalAlpha = 1;
      if (!now.chosen) return;
      this.line(now.chosen, this.colours.paper, 5);
      this.line(now.chosen, this.colours.adversary, 3);
      this.marks(now.chosen.subarray(2), "diamond", 4, this.colours.adversary);
    }

    /** Of a drive: the contact that ended it, from `FUTURE_S` before. */
    drawEnd() {
      const { contact, frames } = this.scene;
      const left = contact ? contact.t - frames[this.state.frame] : Infinity;
      if (left > FUTURE_S) return;
      const [x, y] = this.pixel(contact.x, contact.y);
      this.drawStar(x, y);
      this.label(left >= 0.1 ? `contact in ${left.toFixed(1)} s` : "contact now", x + 14, y);
    }

    /** Ways of ego and adversaries: thin where they were, thick with a dot each half second where they go. */
    drawWays() {
      const { scene, state } = this;
      for (const agent of scene.agents) {
        if (agent.adversary) {
          this.drawWay((frame) => {
            const at = frame - agent.first;
            return at >= 0 && at < agent.count && !Number.isNaN(agent.x[at]) ? [agent.x[at], agent.y[at]] : null;
          }, this.colours.adversary);
        }
      }
      if (scene.ego) {
        const { x, y, yaw, ahead } = scene.ego;
        this.drawWay((frame) => [x[frame] + ahead * Math.cos(yaw[frame]), y[frame] + ahead * Math.sin(yaw[frame])],
          this.colours.ego);
      } else if (scene.recorded[state.frame]) {
        const way = scene.recorded[state.frame];
        this.line(way, this.colours.ego, 2);
        this.marks(way, "circle", 2.5, this.colours.ego);
      }
    }

    /** @param {(frame: number) => [number, number]|null} place @param {string} colour */
    drawWay(place, colour) {
      const { frames } = this.scene;
      const now = this.state.frame;
      const [behind, ahead, dots] = [[], [], []];
      let next = 0.5;
      for (let frame = now; frame >= 0 && frames[now] - frames[frame] <= PAST_S; frame--) {
        behind.push(...(place(frame) ?? []));
      }
      for (let frame = now; frame < frames.length && frames[frame] - frames[now] <= FUTURE_S + 0.01; frame++) {
        const at = place(frame);
        if (!at) continue;
        ahead.push(...at);
        if (frames[frame] - frames[now] >= next - 0.01) {
          dots.push(...at);
          next += 0.5;
        }
      }
      this.context.globalAlpha = 0.55;
      this.line(behind, colour, 1);
      this.line(ahead, colour, 2);
      this.context.globalAlpha = 1;
      this.marks(dots, "circle", 2.5, colour);
    }

    /** @param {ArrayLike<number>} points Metres, x and y in turn. @param {string} colour @param {number} width */
    line(points, colour, width, dash = []) {
      if (points.length < 4) return;
      const { context } = this;
      context.beginPath();
      for (let at = 0; at < points.length; at += 2) {
        const [x, y] = this.pixel(points[at], points[at + 1]);
        if (at) context.lineTo(x, y);
        else context.moveTo(x, y);
      }
      context.strokeStyle = colour;
      context.lineWidth = width;
      context.lineJoin = "round";
      context.setLineDash(dash);
      context.stroke();
      context.setLineDash([]);
    }

    /** @param {ArrayLike<number>} points @param {string} shape @param {number} size @param {string} colour */
    marks(points, shape, size, colour, hollow = false) {
      if (!points.length) return;
      const { context, colours } = this;
      context.beginPath();
      for (let at = 0; at < points.length; at += 2) {
        traceShape(context, shape, ...this.pixel(points[at], points[at + 1]), size);
      }
      context.fillStyle = hollow ? colours.paper : colour;
      context.strokeStyle = hollow ? colour : colours.paper;
      context.lineWidth = 1;
      context.fill();
      context.stroke();
    }

    /** Adds a box to the path. @param {{x: number, y: number, yaw: number, length: number, width: number}} box */
    trace({ x, y, yaw, length, width }) {
      const { context } = this;
      const [ax, ay] = [length / 2 * Math.cos(yaw), length / 2 * Math.sin(yaw)];
      const [lx, ly] = [-width / 2 * Math.sin(yaw), width / 2 * Math.cos(yaw)];
      context.moveTo(...this.pixel(x + ax + lx, y + ay + ly));
      context.lineTo(...this.pixel(x - ax + lx, y - ay + ly));
      context.lineTo(...this.pixel(x - ax - lx, y - ay - ly));
      context.lineTo(...this.pixel(x + ax - lx, y + ay - ly));
      context.closePath();
    }

    /** A light wedge at the front of a box. */
    traceNose({ x, y, yaw, length, width }) {
      const { context } = this;
      const [cos, sin] = [Math.cos(yaw), Math.sin(yaw)];
      const [bx, by] = [x + 0.2 * length * cos, y + 0.2 * length * sin];
      context.moveTo(...this.pixel(bx - 0.3 * width * sin, by + 0.3 * width * cos));
      context.lineTo(...this.pixel(x + 0.42 * length * cos, y + 0.42 * length * sin));
      context.lineTo(...this.pixel(bx + 0.3 * width * sin, by - 0.3 * width * cos));
    }

    /** @param {*} agent @param {number} frame @returns {*} Its box, or null where it is not there. */
    boxOf(agent, frame) {
      const at = frame - agent.first;
      if (at < 0 || at >= agent.count || Number.isNaN(agent.x[at])) return null;
      return { x: agent.x[at], y: agent.y[at], yaw: agent.yaw[at], length: agent.length, width: agent.width };
    }

    drawAgents() {
      const { context, colours, scene, state } = this;
      /** @type {Map<string, *[]>} */
      const groups = new Map([["thing", []], ["person", []], ["cycle", []], ["vehicle", []]]);
      const adversaries = [];
      for (const agent of scene.agents) {
        const box = this.boxOf(agent, state.frame);
        if (!box || !this.sees(box.x, box.y, agent.reach)) continue;
        if (agent.adversary) adversaries.push([agent, box]);
        else groups.get(agent.kind).push(box);
      }
      for (const [kind, boxes] of groups) this.drawBoxes(boxes, colours[kind], kind === "vehicle" || kind === "cycle");
      for (const [agent, box] of adversaries) {
        this.drawBoxes([box], colours.adversary, false);
        context.beginPath();
        this.trace(box);
        context.strokeStyle = colours.ink;
        context.lineWidth = 2;
        context.stroke();
        const size = Math.max(10, Math.min(16, 1.4 * this.scale));
        this.write(agent.letter, ...this.pixel(box.x, box.y), { size, colour: "#ffffff", centred: true });
      }
    }

    /** @param {*[]} boxes @param {string} colour @param {boolean} noses */
    drawBoxes(boxes, colour, noses) {
      if (!boxes.length) return;
      const { context, colours } = this;
      context.beginPath();
      for (const box of boxes) this.trace(box);
      context.fillStyle = colour;
      context.fill();
      if (this.scale < 4) return;
      context.strokeStyle = colours.paper;
      context.lineWidth = 1;
      context.stroke();
      if (!noses) return;
      context.beginPath();
      for (const box of boxes) this.traceNose(box);
      context.stroke();
    }

    /** @param {number} frame */
    drawEgo(frame) {
      const { context, colours, scene } = this;
      const box = this.egoBox(frame);
      if (!box) return;
      this.drawBoxes([box], colours.ego, true);
      context.beginPath();
      this.trace(box);
      context.strokeStyle = colours.ink;
      context.lineWidth = scene.ego ? 2 : 1;
      context.stroke();
    }

    /** @param {number} frame @returns {*} The recorded body; without a sheet that of any planner's start. */
    egoBox(frame) {
      const { ego, body, models } = this.scene;
      if (ego) {
        const yaw = ego.yaw[frame];
        return {
          x: ego.x[frame] + ego.ahead * Math.cos(yaw), y: ego.y[frame] + ego.ahead * Math.sin(yaw), yaw,
          length: ego.length, width: ego.width,
        };
      }
      const plan = models.map((model) => model.at(frame)).find((each) => each?.path);
      return plan ? { ...body, x: plan.path[0] + body.ahead, y: plan.path[1], yaw: 0 } : null;
    }

    /** Other modes of a plan, and what the planner expects of others. */
    drawExpectations({ plan, style }) {
      const { context, state, colours } = this;
      const opacity = context.globalAlpha;
      if (state.show.modes) {
        context.globalAlpha = 0.5 * opacity;
        for (const mode of plan.modes) this.line([plan.path[0], plan.path[1], ...mode], style.colour, 1.2, style.dash);
      }
      if (state.show.forecasts) {
        context.globalAlpha = 0.9 * opacity;
        context.beginPath();
        for (const forecast of plan.forecasts) {
          if (this.sees(forecast.x, forecast.y, 10)) this.trace({ ...forecast });
        }
        context.strokeStyle = style.colour;
        context.lineWidth = 1;
        context.setLineDash([2, 2]);
        context.stroke();
        context.setLineDash([]);
        for (const { path, x, y } of plan.forecasts) {
          if (!path || !this.sees(x, y, 60)) continue;
          this.line([x, y, ...path], colours.paper, 3);
          this.line([x, y, ...path], style.colour, 1.4, [3, 3]);
          this.marks(path, "circle", 2.2, style.colour, true);
        }
      }
      context.globalAlpha = opacity;
    }

    /** The ego's outline at each waypoint, a line in the planner's pattern, its mark at each waypoint. */
    drawPlan({ plan, style }) {
      const { context, colours, state } = this;
      const opacity = context.globalAlpha;
      if (state.show.bodies) {
        context.globalAlpha = 0.6 * opacity;
        context.beginPath();
        for (const box of plan.boxes) this.trace(box);
        context.strokeStyle = style.colour;
        context.lineWidth = 1;
        context.stroke();
        context.globalAlpha = opacity;
      }
      this.line(plan.path, colours.paper, 5);
      this.line(plan.path, style.colour, 2.6, style.dash);
      this.marks(plan.path.subarray(2), style.shape, 5, style.colour);
    }

    /** Where and when a plan first touches something, and with what. */
    drawContact({ model, plan, style, verdict }, age) {
      if (!verdict || verdict.contact === null) return;
      const counts = player.fails(verdict);
      const { context, colours, scene, state } = this;
      const start = scene.samples[this.sample];
      const startYaw = scene.ego ? scene.ego.yaw[start.frame] : 0;
      const box = player.bodyAlong(plan, verdict.contact, scene.body, startYaw);
      context.beginPath();
      this.trace(box);
      context.globalAlpha = 0.35;
      context.fillStyle = style.colour;
      context.fill();
      context.globalAlpha = 1;
      context.strokeStyle = counts ? colours.contact : colours.faint;
      context.lineWidth = 2;
      context.stroke();
      const hit = state.exact && plan.hit !== null ? this.hitBox(plan.hit, start.t + verdict.contact) : null;
      if (hit) {
        context.beginPath();
        this.trace(hit);
        context.strokeStyle = colours.ink;
        context.setLineDash([4, 3]);
        context.stroke();
        context.setLineDash([]);
      }
      const [x, y] = this.pixel(...(hit ? [(hit.x + box.x) / 2, (hit.y + box.y) / 2] : [box.x, box.y]));
      this.drawStar(x, y, counts);
      const left = verdict.contact - age;
      const when = left >= 0.05 ? `in ${left.toFixed(1)} s` : "now";
      const whom = verdict.whom === "other" ? " another" : "";
      this.label(`${cut(model.name)}${whom} ${when}`, x + 14, y, counts);
    }

    /** @param {number} x @param {number} y Pixels. @param {boolean} counts Hollow if not. */
    drawStar(x, y, counts = true) {
      const { context, colours } = this;
      context.beginPath();
      for (const [at, [dx, dy]] of star(8, 0, 0.5).entries()) {
        if (at) context.lineTo(x + 10 * dx, y + 10 * dy);
        else context.moveTo(x + 10 * dx, y + 10 * dy);
      }
      context.closePath();
      context.fillStyle = counts ? colours.contact : colours.paper;
      context.strokeStyle = counts ? colours.paper : colours.faint;
      context.lineWidth = 2;
      context.fill();
      context.stroke();
    }

    /** @param {number} number Of the agent. @param {number} seconds Since the scene began. @returns {*} Its box then. */
    hitBox(number, seconds) {
      const { frames, agents } = this.scene;
      if (!agents[number] || seconds > frames.at(-1) + 0.05) return null;
      let frame = 0;
      while (frame < frames.length - 1 && frames[frame] + frames[frame + 1] < 2 * seconds) frame += 1;
      return this.boxOf(agents[number], frame);
    }

    /** Text beside a point, inside the canvas and clear of what is written there already; faint if it does not count. */
    label(text, x, y, counts = true) {
      const { context } = this;
      const size = 12, line = 16;
      context.font = FONT(size);
      const { width } = context.measureText(text);
      // Where it would leave the canvas it is moved, and up, so that it does not cover what it names.
      const outside = x + width + 6 > this.width;
      const left = Math.max(outside ? this.width - width - 6 : x, 4);
      const meets = ([otherLeft, otherTop, otherWidth]) => left < otherLeft + otherWidth + 6
        && otherLeft < left + width + 6 && Math.abs(otherTop - top) < line;
      let top = outside ? y - 22 : y;
      while (this.labels.some(meets)) top += outside ? -line : line;
      this.labels.push([left, top, width]);
      this.write(text, left, top, { size, colour: counts ? this.colours.contact : this.colours.faint, plate: width });
    }

    /** @param {string} text @param {number} x @param {number} y @param {*} how A plate is as wide as it says. */
    write(text, x, y, { size, colour, centred = false, plate = 0 }) {
      const { context, colours } = this;
      context.font = FONT(size);
      context.textAlign = centred ? "center" : "left";
      context.textBaseline = "middle";
      if (plate) {
        context.globalAlpha = 0.85;
        context.fillStyle = colours.paper;
        context.fillRect(x - 3, y - size * 0.65, plate + 6, size * 1.3);
        context.globalAlpha = 1;
      }
      context.fillStyle = colour;
      context.fillText(text, x, y);
    }

    /** A bar of a round number of metres. */
    drawScale() {
      const { context, colours } = this;
      const metres = [50, 20, 10, 5, 2].find((length) => length * this.scale <= this.width / 4) ?? 1;
      const [x, y, length] = [12, 18, metres * this.scale];
      context.beginPath();
      context.moveTo(x, y - 5);
      context.lineTo(x, y);
      context.lineTo(x + length, y);
      context.lineTo(x + length, y - 5);
      for (const [colour, width] of [[colours.paper, 4], [colours.ink, 1.5]]) {
        context.strokeStyle = colour;
        context.lineWidth = width;
        context.stroke();
      }
      context.font = FONT(11);
      const plate = context.measureText(`${metres} m`).width;
      this.write(`${metres} m`, x + length + 8, y - 5, { size: 11, colour: colours.ink, plate });
    }
  }

  Object.assign(player, { BirdsEye });
})();
