"use strict";
/* The scene player: what is in force at a frame, verdicts in words, and marks on the time line. */

const BEFORE_S = 2;
const COMMANDS = ["right", "left", "straight"];
/** @type {Record<string, string>} */
const DID = {
  track: "The adversary drives the scene's own track.", searched: "The adversary drives what its search found.",
  slowed: "The adversary's search found nothing admissible; it brakes or keeps its plan.",
};

/** @param {Scene} scene @param {number} seconds @returns {number} The nearest frame. */
function frameAt({ frames }, seconds) {
  const apart = frames.map((time) => Math.abs(time - seconds));
  return apart.indexOf(apart.reduce((least, each) => Math.min(least, each), Infinity));
}

/** Seconds of a first contact, else when an adversary is closest. @param {Scene} scene @param {Planner[]} models
 * @param {number} judge Number of the protocol. @returns {number} */
function decisive(scene, models, judge) {
  const first = Math.min(...models.map((model) => model.first[judge] ?? Infinity));
  return Number.isFinite(first) ? first : scene.closest ?? 0;
}

/** @param {Verdict} verdict @returns {boolean} Whether it is a contact that counts: with the adversary, where one is. */
const isBad = ({ mark }) => site().legend[mark][1] === "bad";

/** @param {Scene} scene @param {Planner} model @param {number} judge @returns {number[]} Samples that collide and count. */
const collisions = (scene, model, judge) => [...scene.samples.keys()].filter((sample) =>
  model.verdict(sample, judge)?.counted && model.verdict(sample, judge)?.contact !== null);

/** @param {Scene} scene @param {number} sample @returns {string} */
const sampleTime = (scene, sample) => `${scene.samples[sample].t.toFixed(1)} s`;

// --- the time line -----------------------------------------------------------------------------------------------------
/** @template {HTMLElement} T @param {T} node @param {Scene} scene @param {number} frame @returns {T} In its place. */
function along(node, scene, frame) {
  node.style.left = `${100 * frame / Math.max(scene.frames.length - 1, 1)}%`;
  return node;
}

/** Marks where plans of one planner collide, and where it failed; grey where it is not shown.
 * @param {HTMLElement} track @param {Scene} scene @param {Planner} model @param {string|null} protocol
 * @param {boolean} shown @param {(frame: number) => void} seek */
function fillTrack(track, scene, model, protocol, shown, seek) {
  track.classList.toggle("cp-off", !shown);
  const { name } = model;
  const judge = scene.protocols.indexOf(protocol ?? "");
  // Tab passes the marks by, because there may be hundreds: two buttons and two keys go from one to the next.
  /** @param {string} sign @param {number} sample @param {string} title @param {string} kind @param {any} data */
  const mark = (sign, sample, title, kind, data) => along(element("button", {
    type: "button", tabindex: "-1", class: `cp-mark ${kind}`, title, "aria-label": title, ...data,
    onclick: () => seek(scene.samples[sample].frame),
  }, sign), scene, scene.samples[sample].frame);
  track.replaceChildren(...[...scene.samples.keys()].flatMap((sample) => {
    const [verdict, at] = [model.verdict(sample, judge), sampleTime(scene, sample)];
    if (model.failed(sample) !== undefined) return mark("?", sample, `${name} failed at ${at}`, "cp-failed", {});
    if (!verdict?.counted || verdict.contact === null) return [];
    const [sign, kind, , , sentence] = site().legend[verdict.mark];
    const words = `${name}: the plan made at ${at} ${sentence} at ${verdict.words} (${protocol})`;
    return mark(sign, sample, words, `cp-hit cp-${kind}`, { "data-testid": shown && "player-collision", "data-model": name,
      "data-frame": scene.samples[sample].frame, "data-contact": verdict.contact, "data-mark": verdict.mark });
  }));
}

/** A line where the plan in force first touches something.
 * @param {HTMLElement|undefined} track @param {Scene} scene @param {number} sample @param {Verdict|null} verdict */
function markMoment(track, scene, sample, verdict) {
  track?.querySelector(".cp-moment")?.remove();
  if (!verdict || verdict.contact === null) return;
  const kind = isBad(verdict) ? "cp-moment" : "cp-moment cp-other";
  const frame = frameAt(scene, scene.samples[sample].t + verdict.contact);
  track?.append(along(element("i", { class: kind, "aria-hidden": "true" }), scene, frame));
}

// --- one sample --------------------------------------------------------------------------------------------------------
/** @typedef {{words: string, kind?: string, title?: string}} Said */

/** @param {Planner} model @param {number} sample @param {number} judge @returns {{cells: Said[], left?: boolean}} */
function entryOf(model, sample, judge) {
  const nothing = Array(7).fill({ words: UNDEFINED });
  const failed = model.failed(sample);
  if (failed !== undefined) return { cells: [{ words: "failed", kind: "cp-bad", title: failed }, ...nothing] };
  const plan = model.plan(sample);
  if (!plan) return { cells: [{ words: "did not run" }, ...nothing] };
  const verdict = model.verdict(sample, judge);
  const within = [...(verdict?.marks ?? "---")].map((mark) => {
    const [sign, kind, , words] = site().legend[mark];
    return verdict ? { words: `${sign} ${words}${verdict.counted ? "" : " ‡"}`, kind: `cp-${kind}` } : { words };
  });
  const cause = (verdict?.contact ?? null) === null ? undefined : plan.cause;
  const cells = [...within, { words: verdict?.words ?? UNDEFINED }, { words: cause ?? UNDEFINED, title: cause && plan.reason },
    ...(plan.l2 ?? Array(3).fill(UNDEFINED)).map((words) => ({ words }))];
  return { cells, left: verdict !== null && !verdict.counted };
}

/** @param {Scene} scene @param {Planner[]} models @param {number} sample @returns {string[]} Of an instant of a drive. */
function sayDriven(scene, models, sample) {
  const did = scene.considered.findLast(({ t }) => t <= scene.samples[sample].t + 0.001)?.did;
  const failed = models.map((model) => model.failed(sample)).filter((why) => why !== undefined);
  return [...(did ? [DID[did]] : []), ...failed.map((why) => `The planner failed: ${why}`)];
}

/** Verdicts on the plans of one sample. @param {Scene} scene @param {Planner[]} models @param {number} sample
 * @param {string|null} protocol @param {boolean} compare Whether to mark what differs. @returns {HTMLElement[]} */
function verdictNodes(scene, models, sample, protocol, compare) {
  const command = COMMANDS[scene.samples[sample].command ?? -1];
  const caption = `Sample ${sample + 1} of ${scene.samples.length}, ${sampleTime(scene, sample)}${
    command ? `, command: ${command}` : ""}${protocol ? `; verdicts of ${protocol}` : ""}`;
  const plain = scene.driven ? sayDriven(scene, models, sample).join(" ") : models.length ? null
    : scene.models.length ? "No planner is chosen." : "No planner ran on this scene.";
  // Plans that were driven are not judged one by one: what came of them is what is seen.
  if (plain !== null) return [element("p", { class: "cp-note" }, `${caption}. ${plain}`)];
  const entries = models.map((model) => entryOf(model, sample, scene.protocols.indexOf(protocol ?? "")));
  const both = compare && models.length === 2;
  const apart = both ? differenceOf(scene, models, sample) : null;
  const uncounted = entries.some((each) => each.left) ? element("p", { class: "cp-quiet cp-apart" },
    `‡ No rate of ${protocol} counts this sample: the recording ends too early.`) : null;
  const table = verdictsTable(caption, models, entries.map(({ cells }) => cells), both);
  return [element("div", { class: "cp-box" }, table), apart, uncounted].filter((node) => node !== null);
}

/** @param {string} caption @param {Planner[]} models @param {Said[][]} rows @param {boolean} both */
function verdictsTable(caption, models, rows, both) {
  const groups = [["", 1], ["collides within", 3], ["contact at", 1], ["cause", 1], ["L2, metres, at", 3]];
  const heads = ["planner", "1 s", "2 s", "3 s", "", "", "1 s", "2 s", "3 s"];
  // Distances always differ.
  const differs = heads.map((_, column) => both && column > 0 && column < 6
    && rows[0][column - 1].words !== rows[1][column - 1].words);
  /** @param {string|undefined} kind @param {number} column */
  const kinds = (kind, column) => classes(kind, differs[column] && "cp-differs");
  return element("table", {}, element("caption", {}, caption),
    element("thead", {},
      element("tr", {}, groups.map(([words, span]) => element("th", { scope: "colgroup", colspan: span }, words))),
      element("tr", {}, heads.map((words, column) => element(words ? "th" : "td",
        { scope: words ? "col" : null, class: kinds(undefined, column) }, words)))),
    element("tbody", {}, rows.map((cells, row) => element("tr", {},
      element("th", { scope: "row", title: models[row].name }, models[row].shown),
      cells.map(({ words, kind, title }, at) => element("td", { class: kinds(kind, at + 1), title }, words))))));
}

/** How far two plans part. @param {Scene} scene @param {Planner[]} models @param {number} sample */
function differenceOf(scene, models, sample) {
  const [first, second] = models.map((model) => scene.models.indexOf(model)).sort((a, b) => a - b);
  const apart = scene.apart[first]?.[second - first - 1]?.[sample];
  if (!apart) return null;
  return element("p", { class: "cp-apart", "data-testid": "player-difference" },
    `The plans are ${apart[0]} m apart after 1 s, ${apart[1]} m after 2 s, ${apart[2]} m after 3 s.`);
}
