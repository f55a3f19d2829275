"use strict";
/* The scene player, part 7: whom and which moment it shows at first. */
(() => {
  const player = window.ChallengerPlayer;
  const BEFORE_S = 2;
  const FAILING = 2, SHOWN = 3;

  /** @param {*} scene @param {*} model @param {string|null} protocol @param {(verdict: *) => boolean} [fits]
   * @returns {number[]} Samples that collide and count, and touch the adversary first where there is one. */
  function failures(scene, model, protocol, fits = player.fails) {
    const judge = scene.protocols.indexOf(protocol);
    return player.collisions(scene, model, protocol).filter((sample) => fits(model.verdict(sample, judge)));
  }

  /**
   * Planners whose verdicts differ: two that fail and one that does not; where all plain planners agree, a privileged one
   * may be who differs. Where nobody differs, the first ones, those that fail before the others.
   * @param {*} scene @param {*[]} models In the order of lanes. @param {string|null} protocol
   * @returns {string[]} Names in that order.
   */
  function differing(scene, models, protocol) {
    const judge = scene.protocols.indexOf(protocol);
    const ran = models.filter((model) => scene.samples.some((_, sample) => model.at(sample)));
    const fails = new Set(ran.filter((model) => failures(scene, model, protocol).length));
    const judged = ran.filter((model) => scene.samples.some((_, sample) => model.verdict(sample, judge)?.counted));
    const plainFirst = (list) => [...list.filter((each) => !each.privileged), ...list.filter((each) => each.privileged)];
    const failing = plainFirst(ran.filter((model) => fails.has(model)));
    const clear = plainFirst(judged.filter((model) => !fails.has(model)));
    const plain = ran.filter((model) => !model.privileged);
    const first = failing.length && clear.length
      ? [...failing.slice(0, FAILING), ...clear].slice(0, SHOWN)
      : [...plain.filter((model) => fails.has(model)), ...plain, ...ran].slice(0, SHOWN);
    return models.filter((model) => first.includes(model)).map((model) => model.name);
  }

  /** @param {*} scene @param {*[]} models @param {string|null} protocol @param {(verdict: *) => boolean} [fits]
   * @returns {number|null} When the first plan of theirs touches the adversary, or without one anybody, seconds after the
   * scene began. */
  function firstContact(scene, models, protocol, fits = player.fails) {
    const judge = scene.protocols.indexOf(protocol);
    const moments = models.flatMap((model) => failures(scene, model, protocol, fits)
      .map((sample) => scene.samples[sample].t + (model.verdict(sample, judge).contact ?? 0)));
    return moments.length ? Math.min(...moments) : null;
  }

  /** @param {*} scene @returns {number|null} When an adversary is closest to the recorded ego, seconds. */
  function closestApproach(scene) {
    if (!scene.ego) return null;
    let [least, found] = [Infinity, null];
    for (const agent of scene.agents.filter((each) => each.adversary)) {
      for (let at = 0; at < agent.count; at++) {
        const frame = agent.first + at;
        const apart = Math.hypot(agent.x[at] - scene.ego.x[frame], agent.y[at] - scene.ego.y[frame]);
        if (apart < least) [least, found] = [apart, scene.frames[frame]];
      }
    }
    return found;
  }

  /** @param {*} scene @param {*[]} models @param {string|null} protocol @returns {number} What it is all about, seconds. */
  const decisive = (scene, models, protocol) => firstContact(scene, models, protocol) ?? closestApproach(scene) ?? 0;

  /** @param {*} scene @param {*[]} models @param {string|null} protocol @returns {number} When to begin, seconds. */
  const beginning = (scene, models, protocol) => Math.max(decisive(scene, models, protocol) - BEFORE_S, 0);

  Object.assign(player, { beginning, decisive, differing, firstContact });
})();
