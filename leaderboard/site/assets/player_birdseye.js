"use strict";
/* The scene player: the scene from above, drawn from vectors. */

const PAST_S = 2, FUTURE_S = 3, GRID_M = 400;
const NAME_LETTERS = 24, LABEL_PX = 12, LINE_PX = 16;

/** What is drawn of one planner. @typedef {{model: Planner, plan: Plan, style: Style, verdict: Verdict|null}} Drawn */

/** Draws frames. */
class BirdsEye extends GroundView {
  /** @type {ViewState} */
  state = { frame: 0, protocol: null, chosen: [], show: {} };
  sample = -1;
  /** Left, middle and width of what is written. */
  labels = /** @type {[number, number, number][]} */ ([]);

  /** @param {ViewState} state */
  draw(state) {
    if (!this.fit()) return;
    const { scene } = this;
    const sample = scene.sampleOf[state.frame];
    const judge = scene.protocols.indexOf(state.protocol ?? "");
    Object.assign(this, { state, sample, labels: [] });
    this.place(state.frame);
    this.drawGround();
    const plans = state.chosen.flatMap((model) => {
      const plan = model.plan(sample);
      return plan ? [{ model, plan, style: styleOf(model.name), verdict: model.verdict(sample, judge) }] : [];
    });
    if (state.show.recorded) this.drawWays();
    if (state.show.considered) this.drawConsidered();
    const age = sample < 0 ? 0 : scene.frames[state.frame] - scene.samples[sample].t;
    const alpha = Math.max(1 - 0.8 * age, 0.45);
    this.faintly(alpha, () => plans.forEach((each) => this.drawExpectations(each)));
    this.drawAgents();
    this.drawEgo();
    plans.reverse();
    this.faintly(alpha, () => plans.forEach((each) => this.drawPlan(each)));
    plans.forEach((each) => this.drawContact(each));
    this.drawEnd();
    this.drawScale();
  }

  drawGround() {
    const { context, colours, ratio } = this;
    const { areas, dividers } = this.scene.ground;
    context.setTransform(ratio, 0, 0, ratio, 0, 0);
    context.fillStyle = colours.land;
    context.fillRect(0, 0, this.width, this.height);
    if (!this.scene.hasSheet) this.drawGrid();
    const [a, b, c, d, e, f] = this.matrix.map((value) => value * ratio);
    context.setTransform(a, b, c, d, e, f);
    context.strokeStyle = colours.kerb;
    context.lineWidth = 0.5;
    for (const name of ["walkways", "carparks", "drivable", "crossings"]) {
      if (name === "drivable") context.stroke(areas.drivable);
      context.fillStyle = name === "drivable" ? colours.road : colours[name];
      context.fill(areas[name], "evenodd");
    }
    context.lineWidth = Math.max(0.15, 1 / this.scale);
    for (const [paint, path] of dividers) {
      const [pattern, colour] = paint.includes("-") ? paint.split("-") : ["solid", paint];
      context.strokeStyle = colours[colour] ?? colours.unpainted;
      context.setLineDash(pattern === "dashed" ? [2, 2.5] : []);
      context.stroke(path);
    }
    context.setLineDash([]);
    context.setTransform(ratio, 0, 0, ratio, 0, 0);
  }

  /** Squares of ten metres around the ego, where there is no map. */
  drawGrid() {
    for (let at = -GRID_M; at <= GRID_M; at += 10) {
      this.line([at, -GRID_M, at, GRID_M], this.colours.grid, 1);
      this.line([-GRID_M, at, GRID_M, at], this.colours.grid, 1);
    }
  }

  /** Of a drive: what an adversary considered at the planning frame in force, the driven one thick. */
  drawConsidered() {
    const { adversary, paper } = this.colours;
    const seconds = this.scene.frames[this.state.frame];
    const now = this.scene.considered.findLast(({ t }) => t <= seconds + 0.001);
    for (const [at, path] of (now?.paths ?? []).entries()) {
      this.faintly(0.7 - 0.5 * (now?.shares[at] ?? 0), () => this.line(path, adversary, 1));
    }
    if (!now?.chosen) return;
    this.line(now.chosen, paper, 5);
    this.line(now.chosen, adversary, 3);
    this.marks(now.chosen.subarray(2), "diamond", 4, adversary);
  }

  /** Of a drive: the contact that ended it, from `FUTURE_S` before. */
  drawEnd() {
    const { contact, frames } = this.scene;
    if (!contact || contact.t - frames[this.state.frame] > FUTURE_S) return;
    this.announce(contact.x, contact.y, "contact", contact.t, true);
  }

  /** Ways of ego and adversaries: thin where they were, thick with a dot each half second where they go. */
  drawWays() {
    const { scene, state, colours } = this;
    const { recordedPath, ego } = scene;
    if (recordedPath) this.faintly(0.6, () => this.line(recordedPath, colours.ego, 2, [5, 6]));
    for (const agent of scene.agents.filter((each) => each.adversary)) {
      this.drawWay((frame) => this.boxOf(agent, frame), colours.adversary);
    }
    if (ego) return this.drawWay((frame) => this.egoBox(frame), colours.ego);
    const way = scene.recorded[state.frame] ?? [];
    this.line(way, colours.ego, 2);
    return this.marks(way, "circle", 2.5, colours.ego);
  }

  /** @param {(frame: number) => Box|null} boxOf @param {string} colour */
  drawWay(boxOf, colour) {
    const { frames } = this.scene;
    const now = this.state.frame;
    /** @param {number[]} numbers Of frames. */
    const places = (numbers) => numbers.flatMap((frame) => boxOf(frame) ?? []).flatMap(({ x, y }) => [x, y]);
    const numbers = [...frames.keys()];
    const behind = places(numbers.filter((frame) => frame <= now && frames[now] - frames[frame] <= PAST_S));
    const next = numbers.filter((frame) => frame >= now && frames[frame] - frames[now] <= FUTURE_S + 0.01);
    const ahead = places(next);
    /** @param {number} frame */
    const half = (frame) => Math.floor(2 * (frames[frame] - frames[now] + 0.01));
    const dots = places(next.filter((frame) => frame > now && half(frame) > half(frame - 1)));
    this.faintly(0.55, () => {
      this.line(behind, colour, 1);
      this.line(ahead, colour, 2);
    });
    this.marks(dots, "circle", 2.5, colour);
  }

  /** @param {Agent} agent @param {number} frame @returns {Box|null} Null where it is not there. */
  boxOf(agent, frame) {
    const at = frame - agent.first;
    if (at < 0 || at >= agent.count || Number.isNaN(agent.x[at])) return null;
    return { x: agent.x[at], y: agent.y[at], yaw: agent.yaw[at], length: agent.length, width: agent.width };
  }

  drawAgents() {
    const { colours, scene, state } = this;
    const seen = scene.agents.flatMap((agent) =>
      [this.boxOf(agent, state.frame) ?? []].flat().map((box) => ({ agent, box })));
    for (const kind of ["thing", "person", "cycle", "vehicle"]) {
      const boxes = seen.filter(({ agent }) => agent.kind === kind && !agent.adversary).map(({ box }) => box);
      this.boxes(boxes, colours[kind], kind === "vehicle" || kind === "cycle");
    }
    for (const { agent, box } of seen.filter((each) => each.agent.adversary)) {
      this.boxes([box], colours.adversary, false, 2);
      this.write(agent.letter, ...this.pixel(box.x, box.y), Math.max(10, Math.min(16, 1.4 * this.scale)), "#ffffff");
    }
  }

  drawEgo() {
    const box = this.egoBox(this.state.frame);
    if (box) this.boxes([box], this.colours.ego, true, this.scene.ego ? 2 : 1);
  }

  /** @param {number} frame @returns {Box|null} The recorded body; without a sheet that of any planner's start. */
  egoBox(frame) {
    const { ego, body, models } = this.scene;
    if (ego) return boxAt(ego.x[frame], ego.y[frame], ego.yaw[frame], ego);
    const plan = models.map((model) => model.plan(frame)).find(Boolean);
    return plan ? boxAt(plan.path[0], plan.path[1], 0, body) : null;
  }

  /** Other modes of a plan, and what the planner expects of others. @param {Drawn} of */
  drawExpectations({ plan, style }) {
    const { state, colours } = this;
    const { colour, dash } = style;
    if (state.show.modes) {
      const start = [plan.path[0], plan.path[1]];
      this.faintly(0.5, () => plan.modes.forEach((mode) => this.line([...start, ...mode], colour, 1.2, dash)));
    }
    if (!state.show.forecasts) return;
    this.faintly(0.9, () => {
      this.trace(plan.forecasts);
      this.stroke(colour, 1, [2, 2]);
      for (const { path, x, y } of plan.forecasts) {
        if (!path) continue;
        this.line([x, y, ...path], colours.paper, 3);
        this.line([x, y, ...path], colour, 1.4, [3, 3]);
        this.marks(path, "circle", 2.2, colour, true);
      }
    });
  }

  /** The ego's outline at each waypoint, a line in the planner's pattern, its mark at each waypoint. @param {Drawn} of */
  drawPlan({ plan, style }) {
    if (this.state.show.bodies) {
      this.faintly(0.6, () => {
        this.trace(plan.boxes);
        this.stroke(style.colour);
      });
    }
    this.line(plan.path, this.colours.paper, 5);
    this.line(plan.path, style.colour, 2.6, style.dash);
    this.marks(plan.path.subarray(2), style.shape, 5, style.colour);
  }

  /** Where and when a plan first touches something, and with what. @param {Drawn} of */
  drawContact({ model, plan, style, verdict }) {
    if (!verdict || verdict.contact === null) return;
    const counts = isBad(verdict);
    const { colours, scene, state } = this;
    const start = scene.samples[this.sample];
    const box = bodyAlong(plan, verdict.contact, scene.body, scene.ego ? scene.ego.yaw[start.frame] : 0);
    this.trace([box]);
    this.faintly(0.35, () => this.paint(style.colour));
    this.stroke(counts ? colours.contact : colours.faint, 2);
    const seconds = start.t + verdict.contact;
    const agent = state.protocol === "exact" && seconds <= scene.frames[scene.frames.length - 1] + 0.05
      ? scene.agents[plan.hit ?? -1] : undefined;
    const hit = agent && this.boxOf(agent, frameAt(scene, seconds));
    if (hit) {
      this.trace([hit]);
      this.stroke(colours.ink, 2, [4, 3]);
    }
    const other = hit ?? box;
    const letters = [...model.name];
    const name = letters.length > NAME_LETTERS ? `${letters.slice(0, NAME_LETTERS - 1).join("")}…` : model.name;
    this.announce((other.x + box.x) / 2, (other.y + box.y) / 2, verdict.mark === "a" ? `${name} another` : name,
      seconds, counts);
  }

  /** A star with what is there and when, inside the canvas and clear of what is written; faint if it does not count.
   * @param {number} x @param {number} y @param {string} what @param {number} seconds @param {boolean} counts */
  announce(x, y, what, seconds, counts) {
    const { context, colours } = this;
    const [across, down] = this.pixel(x, y);
    context.beginPath();
    traceShape(context, "contact", across, down, 10);
    this.paint(counts ? colours.contact : colours.paper);
    this.stroke(counts ? colours.paper : colours.faint, 2);
    const text = `${what} at ${seconds.toFixed(1)} s`;
    context.font = FONT(LABEL_PX);
    const { width } = context.measureText(text);
    // Where it would leave the canvas it is moved, and up, so that it does not cover what it names.
    const outside = across + width + 20 > this.width;
    const begin = Math.max(outside ? this.width - width - 6 : across + 14, 4);
    let top = outside ? down - 22 : down;
    while (this.labels.some(([otherBegin, otherTop, otherWidth]) => begin < otherBegin + otherWidth + 6
      && otherBegin < begin + width + 6 && Math.abs(otherTop - top) < LINE_PX)) top += outside ? -LINE_PX : LINE_PX;
    this.labels.push([begin, top, width]);
    this.write(text, begin, top, LABEL_PX, counts ? colours.contact : colours.faint, true);
  }

  /** A bar of a round number of metres. */
  drawScale() {
    const { context, colours } = this;
    const metres = [50, 20, 10, 5, 2].find((length) => length * this.scale <= this.width / 4) ?? 1;
    const [x, y, length] = [12, 18, metres * this.scale];
    context.beginPath();
    traceLine(context, [x, y - 5, x, y, x + length, y, x + length, y - 5]);
    this.stroke(colours.paper, 4);
    this.stroke(colours.ink, 1.5);
    this.write(`${metres} m`, x + length + 8, y - 5, 11, colours.ink, true);
  }
}
