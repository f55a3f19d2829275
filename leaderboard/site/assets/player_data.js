"use strict";
/* The scene player, part 1: loads a scene's script and unpacks its numbers (leaderboard/site/packing.py). */
(() => {
  const player = (window.ChallengerPlayer = window.ChallengerPlayer ?? {});
  const CENTIMETRE = 0.01, DECIMETRE = 0.1, MILLIRADIAN = 0.001, CENTIRADIAN = 0.01;
  const SCENES_KEPT = 6;
  const STEPS = 6, STEP_S = 0.5;
  const COUNTED = 64;
  const WHOM = ["other", "adversary"];
  const KEY = /^[0-9a-f]{16}$/;

  /**
   * @param {(number|null)[]} steps @param {number} count @param {number} unit
   * @returns {Float64Array} Values; NaN where there is none.
   */
  function unpack(steps, count, unit) {
    const values = new Float64Array(count);
    let now = 0;
    for (let at = 0; at < count; at++) {
      const step = at < steps.length ? steps[at] : 0;
      if (step !== null) now += step;
      values[at] = step === null ? NaN : now * unit;
    }
    return values;
  }

  /**
   * @param {number[]} steps x and y in turn. @param {number} unit @param {number} [x] @param {number} [y] Where it begins.
   * @returns {Float64Array} x and y in turn, metres.
   */
  function unpackPath(steps, unit, x = 0, y = 0) {
    const path = new Float64Array(steps.length);
    let [nowX, nowY] = [Math.round(x / unit), Math.round(y / unit)];
    for (let at = 0; at < steps.length; at += 2) {
      nowX += steps[at];
      nowY += steps[at + 1];
      path[at] = nowX * unit;
      path[at + 1] = nowY * unit;
    }
    return path;
  }

  /** @param {number[][][]} polygons @returns {Path2D} In metres. */
  function areas(polygons) {
    const path = new Path2D();
    for (const ring of polygons.flat()) {
      const points = unpackPath(ring, CENTIMETRE);
      for (let at = 0; at < points.length; at += 2) {
        if (at) path.lineTo(points[at], points[at + 1]);
        else path.moveTo(points[at], points[at + 1]);
      }
      path.closePath();
    }
    return path;
  }

  /** @param {{paint: string, points: number[]}[]} lines @returns {Map<string, Path2D>} By paint, in metres. */
  function dividers(lines) {
    /** @type {Map<string, Path2D>} */
    const found = new Map();
    for (const { paint, points } of lines) {
      const path = found.get(paint) ?? new Path2D();
      const way = unpackPath(points, CENTIMETRE);
      for (let at = 0; at < way.length; at += 2) {
        if (at) path.lineTo(way[at], way[at + 1]);
        else path.moveTo(way[at], way[at + 1]);
      }
      found.set(paint, path);
    }
    return found;
  }

  /** @param {string} category @returns {string} What decides its colour. */
  function kindOf(category) {
    if (category === "vehicle.bicycle" || category === "vehicle.motorcycle") return "cycle";
    if (category.startsWith("vehicle.")) return "vehicle";
    return /^(human|animal)/.test(category) ? "person" : "thing";
  }

  /** @param {*} raw @param {number} frames @returns {*} One object with its places by frame. */
  function agentOf(raw, letter) {
    return {
      id: raw.id, category: raw.category, kind: kindOf(raw.category), adversary: raw.adversary, letter,
      length: raw.size[0], width: raw.size[1], first: raw.first, count: raw.count,
      reach: Math.hypot(raw.size[0], raw.size[1]) / 2,
      x: unpack(raw.x, raw.count, CENTIMETRE),
      y: unpack(raw.y, raw.count, CENTIMETRE),
      yaw: unpack(raw.yaw, raw.count, MILLIRADIAN),
    };
  }

  /** @param {*[]} agents @returns {*[]} Unpacked; adversaries have a letter, with a number if there are several. */
  function agentsOf(agents) {
    const adversaries = agents.filter((agent) => agent.adversary).length;
    let number = 0;
    return agents.map((raw) => {
      if (!raw.adversary) return agentOf(raw, "");
      number += 1;
      return agentOf(raw, adversaries > 1 ? `A${number}` : "A");
    });
  }

  /** @param {Float64Array} path Seven points. @param {Float64Array} yaw At the last six. @param {*} body @returns {*[]} */
  function footprints(path, yaw, body) {
    return Array.from({ length: STEPS }, (_, step) => boxAt(path[2 * step + 2], path[2 * step + 3], yaw[step], body));
  }

  /** @returns {{x: number, y: number, yaw: number, length: number, width: number}} The ego's box at a lidar's pose. */
  function boxAt(x, y, yaw, body) {
    return {
      x: x + body.ahead * Math.cos(yaw), y: y + body.ahead * Math.sin(yaw), yaw, length: body.length, width: body.width,
    };
  }

  /** @param {number} angle @returns {number} In [-pi, pi]. */
  const wrapped = (angle) => Math.atan2(Math.sin(angle), Math.cos(angle));

  /**
   * Where the ego's rectangle is along a plan: linear between waypoints, the heading by the shortest arc.
   * @param {*} plan @param {number} seconds After the sample. @param {*} body @param {number} startYaw
   */
  function bodyAlong(plan, seconds, body, startYaw) {
    const place = Math.min(Math.max(seconds / STEP_S, 0), STEPS);
    const before = Math.min(Math.floor(place), STEPS - 1);
    const share = place - before;
    const between = (at) => plan.path[at] * (1 - share) + plan.path[at + 2] * share;
    const [x, y] = [between(2 * before), between(2 * before + 1)];
    const from = before ? plan.yaw[before - 1] : startYaw;
    return boxAt(x, y, from + share * wrapped(plan.yaw[before] - from), body);
  }

  /** @param {*} raw One forecast. */
  function forecastOf(raw) {
    const [x, y, length, width] = raw.slice(0, 4).map((value) => value * DECIMETRE);
    return { x, y, length, width, yaw: raw[4] * CENTIRADIAN, path: raw[5] ? unpackPath(raw[5], DECIMETRE, x, y) : null };
  }

  /** @param {*} raw @param {*} body @returns {*} What a planner did at one sample; null if it was not asked. */
  function planOf(raw, body) {
    if (!raw) return null;
    if (raw.failed !== undefined) return { failed: raw.failed };
    const path = unpackPath(raw.path, CENTIMETRE);
    const yaw = unpack(raw.yaw, STEPS, MILLIRADIAN);
    return {
      path, yaw, boxes: footprints(path, yaw, body),
      modes: (raw.modes ?? []).map((mode) => unpackPath(mode, CENTIMETRE, path[0], path[1])),
      forecasts: (raw.forecasts ?? []).map(forecastOf),
      verdicts: raw.verdicts, contact: raw.contact, cause: raw.cause ?? null, reason: raw.reason ?? null,
      hit: raw.hit ?? null, l2: raw.l2 ?? [],
    };
  }

  /** @param {*} raw @returns {*} A planner whose samples are unpacked when they are first asked for. */
  function modelOf(raw, body) {
    /** @type {Map<number, *>} */
    const made = new Map();
    return {
      name: raw.name, privileged: raw.privileged, miniature: raw.miniature, native: raw.native,
      /** @param {number} sample @returns {*} */
      at(sample) {
        if (!made.has(sample)) made.set(sample, planOf(raw.samples[sample], body));
        return made.get(sample);
      },
      /**
       * @param {number} sample @param {number} protocol Its number.
       * @returns {{steps: number, counted: boolean, contact: number|null, whom: string|null}|null} Null without a verdict;
       *   `whom` it touches first: `anybody` where no adversary is, `adversary`, `other`, or `unsaid`.
       */
      verdict(sample, protocol) {
        const bits = raw.samples[sample]?.verdicts?.[protocol] ?? null;
        if (bits === null) return null;
        const { contact, whom } = raw.samples[sample];
        const seconds = contact?.[protocol] ?? null;
        return {
          steps: bits & (COUNTED - 1), counted: bits >= COUNTED, contact: seconds,
          whom: seconds === null ? null : whom ? WHOM[whom[protocol]] ?? "unsaid" : "anybody",
        };
      },
    };
  }

  /** @param {*} raw A planning frame of an adversary. @returns {*} What it considered, in metres. */
  function consideredOf({ t, did, paths, shares, chosen }) {
    return {
      t, did, shares: shares.map((share) => share / 100), paths: paths.map((path) => unpackPath(path, DECIMETRE)),
      chosen: chosen ? unpackPath(chosen, DECIMETRE) : null,
    };
  }

  /** @param {*} raw @returns {*[]} The objects of a scene; in a drive an adversary is where it went. */
  function whoWasThere({ agents, moved }) {
    return moved ? [...agents.filter(({ id }) => id !== moved.id), moved] : agents;
  }

  /** @param {*} scene @returns {Int32Array} For each frame the sample whose plans are in force; -1 before the first. */
  function samplesOfFrames(scene) {
    const found = new Int32Array(scene.frames.length).fill(-1);
    for (const [number, sample] of scene.samples.entries()) found.fill(number, sample.frame);
    return found;
  }

  /** @param {*} raw The value of a scene's script. @returns {*} What the player draws from. */
  function decode(raw) {
    const count = raw.frames.length;
    const ego = raw.ego && {
      ...raw.ego,
      x: unpack(raw.ego.x, count, CENTIMETRE), y: unpack(raw.ego.y, count, CENTIMETRE),
      yaw: unpack(raw.ego.yaw, count, MILLIRADIAN),
    };
    return {
      ...raw, ego,
      agents: agentsOf(whoWasThere(raw)),
      ground: {
        drivable: areas(raw.road.drivable), crossings: areas(raw.road.crossings),
        walkways: areas(raw.road.walkways), carparks: areas(raw.road.carparks),
        dividers: dividers(raw.road.dividers),
      },
      recorded: (raw.recorded ?? []).map((way) => unpackPath(way, CENTIMETRE)),
      recordedPath: raw.recordedPath ? unpackPath(raw.recordedPath, CENTIMETRE) : null,
      contact: raw.contact ?? null,
      considered: (raw.considered ?? []).map(consideredOf),
      driven: raw.base !== undefined,
      models: raw.models.map((model) => modelOf(model, raw.body)),
      sampleOf: samplesOfFrames(raw),
      pictures: Int32Array.from(raw.pictures),
    };
  }

  /** Why there is no scene, in a sentence. */
  class LoadError extends Error {}

  /**
   * Load a scene by a script tag: pages from disk may not fetch.
   * @param {string} key @returns {Promise<*>} The scene; rejected with a sentence.
   */
  function load(key) {
    return loadRaw(key).then((raw) => (raw.base
      // A drive says what is other than in its scene.
      ? loadRaw(raw.base).then((scene) => decoded({ ...scene, ...raw }, key)) : decoded(raw, key)));
  }

  /** @param {*} raw @param {string} key @returns {*} The scene; a damaged one is a sentence. */
  function decoded(raw, key) {
    try {
      return decode(raw);
    } catch (error) {
      console.error(error);
      throw new LoadError(missingOf(key));
    }
  }

  /** @param {string} key @returns {string} */
  const missingOf = (key) =>
    `data/scenes/${key}.js is missing or damaged; write the site again with challenger-bench leaderboard.`;

  /** @param {string} key @returns {Promise<*>} The value of a scene's script. */
  function loadRaw(key) {
    const store = (window.CHALLENGER_SCENES = window.CHALLENGER_SCENES ?? {});
    if (!KEY.test(key)) return Promise.reject(new LoadError(`“${key}” is not the key of a scene.`));
    const path = `data/scenes/${key}.js`;
    const missing = missingOf(key);
    if (Object.hasOwn(store, key)) return Promise.resolve(store[key]);
    return new Promise((resolve, reject) => {
      const script = document.createElement("script");
      script.addEventListener("error", () => { script.remove(); reject(new LoadError(missing)); });
      script.addEventListener("load", () => {
        script.remove();
        if (!Object.hasOwn(store, key)) return reject(new LoadError(missing));
        for (const old of Object.keys(store).slice(0, -SCENES_KEPT)) if (old !== key) delete store[old];
        return resolve(store[key]);
      });
      script.src = path;
      document.head.append(script);
    });
  }

  Object.assign(player, { LoadError, load, bodyAlong, STEPS, STEP_S });
})();
