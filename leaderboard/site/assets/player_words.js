"use strict";
/* The scene player, part 6: verdicts in words, and marks on the time line. */
(() => {
  const player = window.ChallengerPlayer;
  const HORIZONS = [["1 s", 2], ["2 s", 4], ["3 s", 6]];
  const COMMANDS = ["right", "left", "straight"];
  const DID = {
    track: "The adversary drives the scene's own track.", searched: "The adversary drives what its search found.",
    slowed: "The adversary's search found nothing admissible; it brakes or keeps its plan.",
  };
  const COLUMNS = 8, LAST_COMPARED = 5;

  /**
   * @param {string} tag @param {Object<string, *>} [attributes] Functions listen; true and false set and leave out.
   * @param {...(Node|string|null)} children @returns {*} The element.
   */
  function element(tag, attributes = {}, ...children) {
    const node = document.createElement(tag);
    for (const [name, value] of Object.entries(attributes)) {
      if (typeof value === "function") node.addEventListener(name, value);
      else if (value === true) node.setAttribute(name, "");
      else if (value !== false && value !== null && value !== undefined) node.setAttribute(name, String(value));
    }
    node.append(...children.filter((child) => child !== null));
    return node;
  }

  /** @param {*} scene @param {number} sample @returns {string} */
  const seconds = (scene, sample) => `${scene.samples[sample].t.toFixed(1)} s`;

  /** Mark, class and words of a contact by whom it is with. */
  const MARKS = {
    anybody: ["✕", "bad", "hits"], adversary: ["✕", "bad", "hits"], other: ["◇", "other", "another"],
    unsaid: ["–", "other", "hits, whom is not said"],
  };
  const SENTENCES = {
    anybody: "collides", adversary: "hits the adversary", other: "hits another than the adversary",
    unsaid: "hits somebody, whom is not said,",
  };

  /** @param {*} verdict @returns {boolean} Whether it is what is counted: a contact with the adversary, where one is. */
  const fails = (verdict) => verdict.whom === "anybody" || verdict.whom === "adversary";

  /** @param {*} scene @param {*} model @param {string|null} protocol @returns {number[]} Samples that collide and count. */
  function collisions(scene, model, protocol) {
    const judge = scene.protocols.indexOf(protocol);
    return scene.samples.map((_, sample) => sample).filter((sample) => {
      const verdict = model.verdict(sample, judge);
      return verdict !== null && verdict.counted && verdict.steps > 0;
    });
  }

  // --- the time line -------------------------------------------------------------------------------------------------
  /** @param {*} scene @param {number} frame @returns {string} How far along a track. */
  const along = (scene, frame) => `${100 * frame / Math.max(scene.frames.length - 1, 1)}%`;

  /**
   * Marks where plans of one planner collide, and where it failed.
   * @param {HTMLElement} track @param {*} scene @param {*} model Null leaves the track empty.
   * @param {string|null} protocol @param {(frame: number) => void} seek
   */
  function fillTrack(track, scene, model, protocol, seek) {
    if (!model) return track.replaceChildren();
    const { name } = model;
    // Tab passes the marks by, because there may be hundreds: two buttons and two keys go from one to the next.
    const mark = (sign, frame, words, kind) => {
      const node = element("button", {
        type: "button", tabindex: "-1", class: `cp-mark ${kind}`, title: words, "aria-label": words,
        click: () => seek(frame),
      }, sign);
      node.style.left = along(scene, frame);
      return node;
    };
    const failed = scene.samples.flatMap(({ frame }, sample) => (model.at(sample)?.failed === undefined ? []
      : [mark("?", frame, `${name} failed at ${seconds(scene, sample)}`, "cp-failed")]));
    const judge = scene.protocols.indexOf(protocol);
    const hits = collisions(scene, model, protocol).map((sample) => {
      const { frame } = scene.samples[sample];
      const { contact, whom } = model.verdict(sample, judge);
      const [sign, kind] = MARKS[whom];
      const node = mark(sign, frame, `${name}: the plan made at ${seconds(scene, sample)} ${SENTENCES[whom]} ${
        contact.toFixed(1)} s later (${protocol})`, `cp-hit cp-${kind}`);
      Object.assign(node.dataset, { testid: "player-collision", frame, model: name, contact, whom });
      return node;
    });
    return track.replaceChildren(...failed, ...hits);
  }

  /**
   * A line where the plan in force first touches something.
   * @param {HTMLElement} track @param {*} scene @param {number|null} frame Null for nowhere. @param {boolean} counts
   * Whether it is with whom contacts are counted.
   */
  function markMoment(track, scene, frame, counts) {
    track.querySelector(".cp-moment")?.remove();
    if (frame === null) return;
    const node = element("i", { class: counts ? "cp-moment" : "cp-moment cp-other", "aria-hidden": "true" });
    node.style.left = along(scene, frame);
    track.append(node);
  }

  /** @param {HTMLCanvasElement} canvas @param {*} style A piece of a plan's line. */
  function paintSwatch(canvas, { colour, dash, shape }) {
    const context = canvas.getContext("2d");
    const { width, height } = canvas;
    context.clearRect(0, 0, width, height);
    context.strokeStyle = context.fillStyle = colour;
    context.lineWidth = 4;
    context.setLineDash(dash.map((length) => length * 1.5));
    context.beginPath();
    context.moveTo(0, height / 2);
    context.lineTo(width, height / 2);
    context.stroke();
    context.setLineDash([]);
    context.beginPath();
    player.traceShape(context, shape, width / 2, height / 2, 9);
    context.fill();
  }

  // --- one sample ----------------------------------------------------------------------------------------------------
  /**
   * @param {*} model @param {number} sample @param {number} judge Number of the protocol.
   * @returns {{name: string, cells: {words: string, kind?: string, title?: string}[], sentence: string}}
   */
  function entry(model, sample, judge) {
    const { name } = model;
    const plan = model.at(sample);
    const nothing = (words) => Array.from({ length: COLUMNS }, (_, at) => ({ words: at ? "–" : words }));
    if (!plan) return { name, cells: nothing("did not run"), sentence: `${name} did not run.` };
    if (plan.failed !== undefined) {
      const cells = nothing("failed");
      Object.assign(cells[0], { kind: "cp-bad", title: plan.failed });
      return { name, cells, sentence: `${name} failed: ${plan.failed}` };
    }
    const verdict = model.verdict(sample, judge);
    const contact = verdict?.contact ?? null;
    const cause = contact !== null ? plan.cause : null;
    const cells = [
      ...HORIZONS.map(([, steps]) => within(verdict, steps)),
      { words: contact === null ? "–" : `${contact.toFixed(1)} s` },
      { words: cause ?? "–", title: cause ? plan.reason : undefined },
      ...HORIZONS.map(([, steps]) => ({ words: plan.l2[steps - 1]?.toFixed(2) ?? "–" })),
    ];
    const sentence = !verdict ? `${name} was not judged.` : contact === null ? `${name} is clear.`
      : `${name} ${SENTENCES[verdict.whom]} after ${contact.toFixed(1)} seconds${cause ? `, ${cause}: ${plan.reason}` : ""}.`;
    return { name, cells, sentence };
  }

  /** @param {*} verdict @param {number} steps @returns {{words: string, kind?: string}} */
  function within(verdict, steps) {
    if (!verdict) return { words: "not judged" };
    const hits = (verdict.steps & ((1 << steps) - 1)) !== 0;
    const [sign, kind, words] = hits ? MARKS[verdict.whom] : ["○", "good", "clear"];
    return { words: `${sign} ${words}${verdict.counted ? "" : " ‡"}`, kind: `cp-${kind}` };
  }

  /**
   * Verdicts on the plans of one sample.
   * @param {*} scene @param {*[]} models @param {number} sample @param {string|null} protocol
   * @param {boolean} compare Whether to mark what differs between the first two.
   * @returns {HTMLElement[]} A table, and what is to be said below it.
   */
  function verdicts(scene, models, sample, protocol, compare) {
    const judge = scene.protocols.indexOf(protocol);
    const entries = models.map((model) => entry(model, sample, judge));
    const command = COMMANDS[scene.samples[sample].command];
    const caption = [`Sample ${sample + 1} of ${scene.samples.length}, ${seconds(scene, sample)}`,
      command ? `, command: ${command}` : "", protocol ? `; verdicts of ${protocol}` : ""].join("");
    if (scene.driven) {
      // Plans that were driven are not judged one by one: what came of them is what is seen.
      return [element("p", { class: "cp-note" }, [`${caption}.`, ...driven(scene, models, sample)].join(" "))];
    }
    const notes = compare && models.length === 2 ? [difference(models, entries, sample)] : [];
    if (entries.some(({ cells }) => cells[0].words.endsWith("‡"))) {
      notes.push(element("p", { class: "cp-quiet cp-apart" },
        `‡ No rate of ${protocol} counts this sample: the recording ends too early.`));
    }
    if (!models.length) {
      const why = scene.models.length ? "No planner is chosen." : "No planner ran on this scene.";
      return [element("p", { class: "cp-note" }, `${caption}. ${why}`)];
    }
    return [element("div", { class: "cp-box" }, table(caption, models, entries, compare)), ...notes.filter(Boolean)];
  }

  /** @returns {string[]} What is said of an instant of a drive. */
  function driven(scene, models, sample) {
    const did = scene.considered.findLast(({ t }) => t <= scene.samples[sample].t + 0.001)?.did;
    const failed = models.map((model) => model.at(sample)?.failed).filter((why) => why !== undefined);
    return [...(did ? [DID[did]] : []), ...failed.map((why) => `The planner failed: ${why}`)];
  }

  /** What stands after the names of planners that see what no car sees, and of miniatures. @returns {(Node|null)[]} */
  function marks({ privileged, miniature }) {
    return [privileged ? element("abbr", { title: "Sees boxes, map or the recorded future" }, " †") : null,
      miniature ? element("abbr", { title: "Miniature: shows the pipeline, ranks nothing" }, " §") : null];
  }

  /** @returns {HTMLElement} */
  function table(caption, models, entries, compare) {
    const groups = [["", 1], ["collides within", 3], ["contact", 1], ["cause", 1], ["L2, metres, at", 3]];
    const heads = ["planner", ...HORIZONS.map(([words]) => words), "", "", ...HORIZONS.map(([words]) => words)];
    // Distances always differ.
    const differs = heads.map((_, column) => compare && entries.length === 2 && column > 0 && column <= LAST_COMPARED
      && entries[0].cells[column - 1].words !== entries[1].cells[column - 1].words);
    const kinds = (kind, column) => [kind, differs[column] ? "cp-differs" : null].filter(Boolean).join(" ") || null;
    return element("table", {}, element("caption", {}, caption),
      element("thead", {},
        element("tr", {}, ...groups.map(([words, span]) => element("th", { scope: "colgroup", colspan: span }, words))),
        element("tr", {}, ...heads.map((words, column) => element(words ? "th" : "td",
          { scope: words ? "col" : null, class: kinds(null, column) }, words)))),
      element("tbody", {}, ...entries.map(({ name, cells }, row) => element("tr", {},
        element("th", { scope: "row", title: name }, name, ...marks(models[row])),
        ...cells.map(({ words, kind, title }, at) => element("td", { class: kinds(kind, at + 1), title }, words))))));
  }

  /** @returns {HTMLElement|null} How two plans differ, in words. */
  function difference(models, entries, sample) {
    const plans = models.map((model) => model.at(sample));
    if (plans.some((plan) => !plan?.path)) return null;
    const [a, b] = plans.map(({ path }) => path);
    const apart = [4, 8, 12].map((at) => Math.hypot(a[at] - b[at], a[at + 1] - b[at + 1]).toFixed(2));
    const [first, second] = entries.map(({ cells }) => cells[2].words);
    const words = first === second ? `Both: ${first} within 3 s.`
      : `They differ: ${models[0].name} ${first}, ${models[1].name} ${second} within 3 s.`;
    return element("p", { class: "cp-apart", "data-testid": "player-difference" }, words,
      ` The plans are ${apart[0]} m apart after 1 s, ${apart[1]} m after 2 s, ${apart[2]} m after 3 s.`);
  }

  /** @returns {string} The verdicts on one sample, for those who listen. */
  function sentence(scene, models, sample, protocol) {
    if (scene.driven) return [`${seconds(scene, sample)}.`, ...driven(scene, models, sample)].join(" ");
    const judge = scene.protocols.indexOf(protocol);
    return [`${seconds(scene, sample)}.`, ...models.map((model) => entry(model, sample, judge).sentence)].join(" ");
  }

  Object.assign(player, { element, along, collisions, fails, fillTrack, markMoment, marks, paintSwatch, verdicts, sentence });
})();
