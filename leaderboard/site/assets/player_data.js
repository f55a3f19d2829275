"use strict";
/* The scene player: loads a scene's script and unpacks its numbers (leaderboard/site/packing.py). */

const CENTIMETRE = 0.01, DECIMETRE = 0.1, MILLIRADIAN = 0.001, CENTIRADIAN = 0.01;
const SCENES_KEPT = 6;
const STEPS = 6, STEP_S = 0.5;

/** @param {(number|null)[]} steps @param {number} count @param {number} unit @returns {Float64Array} NaN for null. */
function unpack(steps, count, unit) {
  let now = 0;
  return Float64Array.from({ length: count }, (_, at) => {
    const step = at < steps.length ? steps[at] : 0;
    now += step ?? 0;
    return step === null ? NaN : now * unit;
  });
}

/** @param {number[]} steps x and y in turn. @param {number} unit @returns {Float64Array} Metres, from x, y. */
function unpackPath(steps, unit, x = 0, y = 0) {
  const now = [Math.round(x / unit), Math.round(y / unit)];
  return Float64Array.from(steps, (step, at) => (now[at % 2] += step) * unit);
}

/** Adds a line. @param {Path2D|CanvasRenderingContext2D} path @param {ArrayLike<number>} points x and y in turn.
 * @param {(x: number, y: number) => [number, number]} [place] Where they are in the path. */
function traceLine(path, points, place = (x, y) => [x, y]) {
  for (let at = 0; at < points.length; at += 2) path[at ? "lineTo" : "moveTo"](...place(points[at], points[at + 1]));
}

/** @param {number[][]} lines @param {boolean} areas @returns {Path2D} In metres. */
function pathOf(lines, areas) {
  const path = new Path2D();
  for (const line of lines) {
    traceLine(path, unpackPath(line, CENTIMETRE));
    if (areas) path.closePath();
  }
  return path;
}

/** @param {any} road @returns {Scene["ground"]} Dividers by their paint. */
function groundOf({ dividers, ...areas }) {
  const lines = Object.groupBy(/** @type {{paint: string, points: number[]}[]} */ (dividers), ({ paint }) => paint);
  return {
    areas: Object.fromEntries(Object.entries(areas).map(([name, polygons]) => [name, pathOf(polygons.flat(), true)])),
    dividers: Object.entries(lines).map(([paint, of = []]) => [paint, pathOf(of.map(({ points }) => points), false)]),
  };
}

/** @param {string} category @returns {string} What decides its colour. */
function agentKind(category) {
  if (category === "vehicle.bicycle" || category === "vehicle.motorcycle") return "cycle";
  if (category.startsWith("vehicle.")) return "vehicle";
  return /^(human|animal)/.test(category) ? "person" : "thing";
}

/** @param {any} raw @returns {Agent[]} In a drive an adversary is where it went. Adversaries have letters. */
function agentsOf({ agents, moved }) {
  const there = moved ? [...agents.filter((/** @type {any} */ { id }) => id !== moved.id), moved] : agents;
  const several = there.filter((/** @type {any} */ { adversary }) => adversary).length > 1;
  let number = 0;
  return there.map((/** @type {any} */ raw) => {
    const { id, category, size: [length, width], adversary, first, count } = raw;
    number += adversary ? 1 : 0;
    return {
      id, kind: agentKind(category), adversary, letter: adversary ? `A${several ? number : ""}` : "", length, width, first,
      count,
      x: unpack(raw.x, count, CENTIMETRE), y: unpack(raw.y, count, CENTIMETRE), yaw: unpack(raw.yaw, count, MILLIRADIAN),
    };
  });
}

/** @param {number} x @param {number} y @param {number} yaw @param {Body} body @returns {Box} The ego's at a lidar's pose. */
function boxAt(x, y, yaw, { length, width, ahead }) {
  return { x: x + ahead * Math.cos(yaw), y: y + ahead * Math.sin(yaw), yaw, length, width };
}

/** Where the ego's rectangle is along a plan: linear between waypoints, the heading by the shortest arc.
 * @param {Plan} plan @param {number} seconds After the sample. @param {Body} body @param {number} startYaw */
function bodyAlong(plan, seconds, body, startYaw) {
  const place = Math.min(Math.max(seconds / STEP_S, 0), STEPS);
  const before = Math.min(Math.floor(place), STEPS - 1);
  const share = place - before;
  /** @param {number} at */
  const between = (at) => plan.path[at] * (1 - share) + plan.path[at + 2] * share;
  const from = before ? plan.yaw[before - 1] : startYaw;
  const turn = plan.yaw[before] - from;
  const yaw = from + share * Math.atan2(Math.sin(turn), Math.cos(turn));
  return boxAt(between(2 * before), between(2 * before + 1), yaw, body);
}

/** @param {any} raw @param {Body} body @returns {Plan} */
function planOf(raw, body) {
  const path = unpackPath(raw.path, CENTIMETRE);
  const yaw = unpack(raw.yaw, STEPS, MILLIRADIAN);
  const { modes = [], forecasts = [] } = raw;
  return {
    ...raw, path, yaw,
    boxes: Array.from(yaw, (each, step) => boxAt(path[2 * step + 2], path[2 * step + 3], each, body)),
    modes: modes.map((/** @type {number[]} */ mode) => unpackPath(mode, CENTIMETRE, path[0], path[1])),
    forecasts: forecasts.map(forecastOf),
  };
}

/** @param {any[]} raw One forecast. @returns {Box & {path: Float64Array|null}} */
function forecastOf(raw) {
  const [x, y, length, width] = raw.slice(0, 4).map((value) => value * DECIMETRE);
  return { x, y, length, width, yaw: raw[4] * CENTIRADIAN, path: raw[5] ? unpackPath(raw[5], DECIMETRE, x, y) : null };
}

/** @param {any} raw @param {Body} body @returns {Planner} Its samples are unpacked when they are first asked for. */
function plannerOf({ name, shown, first, outcome, samples }, body) {
  const made = /** @type {Map<number, Plan>} */ (new Map());
  return {
    name, shown, first, outcome,
    plan(sample) {
      const raw = samples[sample];
      if (!raw || raw.failed !== undefined) return null;
      const found = made.get(sample) ?? planOf(raw, body);
      made.set(sample, found);
      return found;
    },
    failed: (sample) => samples[sample]?.failed,
    verdict(sample, protocol) {
      const raw = samples[sample]?.judged?.[protocol];
      if (!raw) return null;
      const [marks, counted, contact = null, words = UNDEFINED] = raw;
      return { marks, mark: marks.at(-1), counted: counted === 1, contact, words };
    },
  };
}

/** @param {any} raw The value of a scene's script. @returns {Scene} What the player draws from. */
function decode(raw) {
  const count = raw.frames.length;
  const sampleOf = new Int32Array(count).fill(-1);
  for (const [number, sample] of raw.samples.entries()) sampleOf.fill(number, sample.frame);
  const { ego } = raw;
  return {
    ...raw, sampleOf, agents: agentsOf(raw), ground: groundOf(raw.road), driven: raw.base !== undefined,
    ego: ego && { ...ego, x: unpack(ego.x, count, CENTIMETRE), y: unpack(ego.y, count, CENTIMETRE),
      yaw: unpack(ego.yaw, count, MILLIRADIAN) },
    recorded: (raw.recorded ?? []).map((/** @type {number[]} */ way) => unpackPath(way, CENTIMETRE)),
    recordedPath: raw.recordedPath ? unpackPath(raw.recordedPath, CENTIMETRE) : null, contact: raw.contact ?? null,
    considered: (raw.considered ?? []).map((/** @type {any} */ { t, did, paths, shares, chosen }) => ({
      t, did, shares: shares.map((/** @type {number} */ share) => share / 100),
      paths: paths.map((/** @type {number[]} */ path) => unpackPath(path, DECIMETRE)),
      chosen: chosen && unpackPath(chosen, DECIMETRE),
    })),
    models: raw.models.map((/** @type {any} */ model) => plannerOf(model, raw.body)),
  };
}

/** Why there is no scene, in a sentence. */
class LoadError extends Error {}

/** @param {string} key @returns {string} */
const missing = (key) => `data/scenes/${key}.js is missing or damaged; write the site again with challenger-bench leaderboard.`;

/** Loads a scene, or a drive, which says what is other than in its scene.
 * @param {string} key @returns {Promise<Scene>} Rejected with a sentence. */
async function loadScene(key) {
  const raw = await loadScript(key);
  const whole = raw.base ? { ...await loadScript(raw.base), ...raw } : raw;
  try {
    return decode(whole);
  } catch (error) {
    console.error(error);
    throw new LoadError(missing(key));
  }
}

/** By a script tag: pages from disk may not fetch. @param {string} key @returns {Promise<any>} The script's value. */
function loadScript(key) {
  const store = (window.CHALLENGER_SCENES ??= {});
  if (Object.hasOwn(store, key)) return Promise.resolve(store[key]);
  return new Promise((resolve, reject) => {
    const script = element("script", { src: `data/scenes/${key}.js` });
    script.onload = script.onerror = () => {
      script.remove();
      if (!Object.hasOwn(store, key)) reject(new LoadError(missing(key)));
      for (const old of Object.keys(store).slice(0, -SCENES_KEPT)) if (old !== key) delete store[old];
      resolve(store[key]);
    };
    document.head.append(script);
  });
}
