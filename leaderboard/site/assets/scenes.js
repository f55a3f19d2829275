"use strict";
/* The scene browser, and the frames around the player. */
(() => {
  const site = window.ChallengerSite;
  const { AddressError, UNDEFINED, address, choice, counted, element, filterField, matcher, own, pages } = site;
  const { remember, unique } = site;

  /** Cards that are made at once; the others follow while the page is already there. */
  const SLICE = 48;
  const WORDS = { true: ["✕", "fails"], false: ["○", "clear"], null: ["–", "cannot be said"] };
  /** On a split with adversaries. */
  const HITS = { ...WORDS, true: ["✕", "hits the adversary"], others: ["◇", "hits another"],
    unsaid: ["–", "whom not said"] };
  const KINDS = { "✕": "bad", "○": "good", "◇": "other", "–": "open" };

  /** @param {*} scene @param {string} model @param {string} protocol @returns {boolean|null|undefined} */
  const verdict = (scene, model, protocol) => own(own(scene.verdicts, model) ?? {}, protocol);

  /** @param {*} scene @param {string} name Of lists of protocols. @param {string} model @param {string} protocol */
  const says = (scene, name, model, protocol) => (own(scene[name], model) ?? []).includes(protocol);

  /** @param {*} scene @param {string} model @param {string} protocol
   * @returns {[string, string]} Mark and words: who hits the adversary, who another alone, of whom it cannot be said. */
  function markOf(scene, model, protocol) {
    const fails = verdict(scene, model, protocol);
    if (!scene.adversarial) return WORDS[fails];
    if (fails === false && says(scene, "others", model, protocol)) return HITS.others;
    return fails === null && says(scene, "unsaid", model, protocol) ? HITS.unsaid : HITS[fails];
  }

  /** @param {*} scene @param {string} protocol @returns {string} How many planners fail, and how many hit others alone. */
  function tally(scene, protocol) {
    const [bad, of] = [failing(scene, protocol).length, decided(scene, protocol).length];
    if (!scene.adversarial) return of ? `${bad} of ${counted(of, "planner")} ${bad === 1 ? "fails" : "fail"}` : "not judged";
    const names = Object.keys(scene.verdicts).filter((model) => verdict(scene, model, protocol) !== undefined);
    const count = (words) => names.filter((model) => markOf(scene, model, protocol) === words).length;
    const [others, unsaid] = [count(HITS.others), count(HITS.unsaid)];
    const said = [of ? `${bad} of ${counted(of, "planner")} ${bad === 1 ? "hits" : "hit"} the adversary` : "",
      others ? `${others} another` : "", unsaid ? `${UNDEFINED} of ${unsaid}, whom is not said` : ""].filter(Boolean);
    return said.join(", ") || "not judged";
  }

  /** @param {Object<string, number|null>} counts @param {string} model @returns {string} A dash where it is not said. */
  const countOf = (counts, model) => String((own(counts, model) === undefined ? 0 : own(counts, model)) ?? UNDEFINED);

  /** @param {*} scene @param {string} [model] @returns {string} What one planner's samples come to, after the tally. */
  function samplesOf(scene, model) {
    if (!model || !own(scene.verdicts, model)) return "";
    const [hits, others] = [scene.colliding, scene.bystanders].map((counts) => own(counts, model));
    if (!scene.adversarial) return hits ? `; ${counted(hits, "colliding sample")}` : "";
    const words = [hits ? `${counted(hits, "sample")} ${hits === 1 ? "hits" : "hit"} it` : "",
      others ? `${counted(others, "sample")} another` : ""].filter(Boolean).join(", ");
    return words ? `; ${words}` : "";
  }

  /** @param {*} scene @param {string} protocol @returns {string[]} Planners that fail it. */
  const failing = (scene, protocol) =>
    Object.keys(scene.verdicts).filter((model) => verdict(scene, model, protocol) === true);

  /** @param {*} scene @param {string} protocol @returns {string[]} Planners of which it can be said. */
  const decided = (scene, protocol) =>
    Object.keys(scene.verdicts).filter((model) => typeof verdict(scene, model, protocol) === "boolean");

  /** @param {string|undefined} key @returns {*} */
  function sceneOf(key) {
    const scene = window.CHALLENGER.scenes.find((each) => each.key === key);
    if (!scene) throw new AddressError(`There is no scene with the key “${key ?? ""}”.`);
    return scene;
  }

  /** @param {*} scene @param {string} protocol @returns {string[]} Two planners to compare: one that fails and one that
   * does not, where there are such; privileged ones only where no others are. */
  site.pairOf = (scene, protocol) => {
    const ran = window.CHALLENGER.models.filter((model) => own(scene.verdicts, model.name)).map((model) => model.name);
    const a = ran.find((name) => verdict(scene, name, protocol) === true) ?? ran[0];
    const others = ran.filter((name) => name !== a);
    const b = others.find((name) => verdict(scene, name, protocol) === false) ?? others[0];
    return [a, b].filter((name) => name !== undefined);
  };

  /** @returns {string} The protocol that pages start with. */
  const firstProtocol = () => window.CHALLENGER.protocols[0] ?? "exact";

  // --- cards ------------------------------------------------------------------------------------------------------------
  /** One mark a planner, in the order of the tables: shape and words, never colour alone.
   * @param {*} scene @param {string} protocol @returns {HTMLElement} */
  function marks(scene, protocol) {
    const judged = window.CHALLENGER.models.filter((model) => verdict(scene, model.name, protocol) !== undefined);
    return element("span", { class: "marks", "aria-hidden": "true" }, judged.map((model) => {
      const [mark, words] = markOf(scene, model.name, protocol);
      return element("span", { class: KINDS[mark], title: `${model.name}: ${words}` }, mark);
    }));
  }

  /** @param {*} scene @param {string} protocol @param {string} [model] Whose plans the scene page starts with.
   * @returns {HTMLElement} */
  site.sceneCard = (scene, protocol, model) => {
    return element("article", { class: "card", "data-testid": "scene-card", "data-key": scene.key },
      element("a", { class: "picture", href: address(["scene", scene.key], { model }), tabindex: "-1",
        "aria-hidden": "true" },
      scene.thumb ? site.picture({ light: scene.thumb, dark: scene.thumbDark, alt: "", width: 320, height: 320 })
        : element("span", { class: "no-picture" }, "no sheet")),
      element("div", { class: "card-text" },
        element("a", { class: "name", href: address(["scene", scene.key], { model }) }, scene.scene),
        element("span", { class: "tags" }, element("span", { class: "tag" }, scene.split),
          scene.manoeuvre ? element("span", { class: "tag" }, scene.manoeuvre) : null),
        element("span", { class: "verdict" }, tally(scene, protocol), samplesOf(scene, model)),
        site.judgementLine(scene, model),
        marks(scene, protocol)));
  };

  // --- browser ------------------------------------------------------------------------------------------------------------
  const ORDERS = {
    name: ["name", (a, b) => a.place - b.place],
    hardest: ["most fail first", (a, b) => b.bad - a.bad || a.place - b.place],
    easiest: ["fewest fail first", (a, b) => a.bad - b.bad || a.place - b.place],
    split: ["planners disagree most", (a, b) => b.split - a.split || a.place - b.place],
    ...Object.fromEntries(Object.entries(site.JUDGED_ORDERS).map(([name, [words]]) =>
      [name, [words, (a, b) => a.value - b.value || a.place - b.place]])),
  };

  /** @returns {string[]} Orders that tell these scenes apart. */
  const orders = () => Object.keys(ORDERS).filter((name) => !own(site.JUDGED_ORDERS, name)
    || window.CHALLENGER.scenes.some((scene) => Number.isFinite(site.JUDGED_ORDERS[name][1](scene))));

  /** @param {URLSearchParams} params @returns {*[]} Scenes that the address asks for, in its order. */
  function chosenScenes(params) {
    const wanted = (name) => params.get(name) ?? "";
    const protocol = wanted("protocol") || firstProtocol();
    const matches = matcher(wanted("q"));
    const fits = site.judgementFilter(params);
    const measure = own(site.JUDGED_ORDERS, wanted("sort"))?.[1] ?? (() => 0);
    const found = window.CHALLENGER.scenes.filter((scene) =>
      (!wanted("data") || scene.data === wanted("data")) && (!wanted("split") || scene.split === wanted("split"))
      && (!wanted("manoeuvre") || scene.manoeuvre === wanted("manoeuvre"))
      && (!wanted("fails") || verdict(scene, wanted("fails"), protocol) === true)
      && (!wanted("passes") || verdict(scene, wanted("passes"), protocol) === false)
      && fits(scene)
      && matches([scene.scene, scene.source, scene.data, scene.split, scene.manoeuvre, scene.description,
        ...scene.labels].join(" ").toLowerCase()));
    const ranked = found.map((scene, place) => {
      const [bad, of] = [failing(scene, protocol).length, decided(scene, protocol).length];
      // What has no such number comes last, and infinity less infinity would be none.
      const value = measure(scene, wanted("fails")) ?? Number.MAX_VALUE;
      return { scene, place, bad, split: Math.min(bad, of - bad), value };
    });
    return ranked.sort((own(ORDERS, wanted("sort")) ?? ORDERS.name)[1]).map(({ scene }) => scene);
  }

  /** Puts nodes in slices, the first at once. @param {HTMLElement} parent @param {(() => Node)[]} makers
   * @returns {() => void} Stops it. */
  function putInSlices(parent, makers) {
    let next = 0;
    let timer = 0;
    const put = () => {
      parent.append(...makers.slice(next, next + SLICE).map((make) => make()));
      next += SLICE;
      if (next < makers.length) timer = setTimeout(put, 16);
    };
    parent.replaceChildren();
    put();
    return () => clearTimeout(timer);
  }

  /** Refuses an address that asks for what is not there: a list would show "all" and hold nothing.
   * @param {Route} here @param {Object<string, string[]>} known Values by the name of the filter. */
  function requireKnown(here, known) {
    for (const [name, values] of Object.entries(known)) {
      const value = here.params.get(name);
      if (value && !values.includes(value)) throw new AddressError(`Nothing here has ${name} “${value}”.`);
    }
  }

  pages.scenes = (here) => {
    const { scenes, models, protocols } = window.CHALLENGER;
    const count = element("p", { class: "count", "data-testid": "scene-count", "aria-live": "polite" });
    const cards = element("div", { class: "cards" });
    let stop = () => {};
    const refresh = (changes) => {
      remember(here, changes);
      const found = chosenScenes(here.params);
      const protocol = here.params.get("protocol") ?? firstProtocol();
      count.textContent = found.length === scenes.length ? counted(scenes.length, "scene")
        : `${found.length} of ${counted(scenes.length, "scene")}`;
      stop();
      stop = putInSlices(cards, found.map((scene) => () => site.sceneCard(scene, protocol, here.params.get("fails"))));
    };
    const list = (label, name, values, any = "all") => choice({
      label, value: here.params.get(name) ?? "", testid: `filter-${name}`, choices: [["", any], ...values],
      change: (value) => refresh({ [name]: value }),
    });
    const of = (name) => unique(scenes.map((scene) => scene[name]).filter(Boolean));
    const names = models.map((model) => model.name);
    requireKnown(here, { data: of("data"), split: of("split"), manoeuvre: of("manoeuvre"), fails: names, passes: names,
      protocol: protocols, sort: orders(), ...site.judgementKnown() });
    refresh({});
    return {
      title: "Scenes",
      nodes: [
        element("h1", {}, "Scenes"),
        element("div", { class: "toolbar" },
          filterField({ label: "Scenes with", value: here.params.get("q") ?? "", change: (q) => refresh({ q }) }),
          of("data").length > 1 ? list("Data set", "data", of("data")) : null,
          list("Split", "split", of("split")),
          list("Manoeuvre", "manoeuvre", of("manoeuvre").sort()),
          list("Fails", "fails", names, "any"),
          list("Does not fail", "passes", names, "any"),
          site.judgementChoices(list),
          protocols.length > 1 ? choice({ label: "Protocol", value: here.params.get("protocol") ?? firstProtocol(),
            choices: protocols, testid: "filter-protocol", change: (protocol) => refresh({ protocol }) }) : null,
          choice({ label: "Order", value: here.params.get("sort") ?? "name", testid: "sort-scenes",
            choices: orders().map((name) => [name, ORDERS[name][0]]),
            change: (sort) => refresh({ sort }) })),
        element("div", { class: "count-line" }, count, element("p", { class: "legend" },
          element("span", { class: "bad" }, "✕"), " fails  ", element("span", { class: "good" }, "○"), " does not  ",
          scenes.some((scene) => scene.adversarial) ? [element("span", { class: "other" }, "◇"),
            " hits another than the adversary  "] : null,
          element("span", { class: "open" }, "–"), " cannot be said; one mark a planner")),
        cards,
      ],
      destroy: () => stop(),
    };
  };

  // --- one scene --------------------------------------------------------------------------------------------------------
  /** @param {*} scene @returns {HTMLElement} Facts and labels. */
  function sceneFacts(scene) {
    const line = (name, ...value) => [element("dt", {}, name), element("dd", {}, value)];
    const siblings = window.CHALLENGER.scenes.filter((each) =>
      each.data === scene.data && each.source === scene.source && each.key !== scene.key);
    return element("dl", { class: "facts" },
      line("data set", scene.data), line("split", scene.split),
      scene.manoeuvre ? line("manoeuvre", element("a", { href: address(["scenes"],
        { split: scene.split, manoeuvre: scene.manoeuvre }) }, scene.manoeuvre)) : null,
      scene.labels.length ? line(scene.labels.length > 1 ? "adversaries" : "adversary",
        scene.labels.map((label) => element("div", {}, label))) : null,
      site.judgementFacts(scene, line),
      scene.description ? line("description", scene.description) : null,
      line("length", `${scene.seconds.toFixed(1)} s`),
      scene.source !== scene.scene ? line("made from", scene.source) : null,
      siblings.length ? line("of the same recording", siblings.map((each) => element("div", {},
        element("a", { href: address(["scene", each.key]) }, `${each.scene} (${each.split})`)))) : null,
      scene.quality.map(({ masks, consistency, imaging }) => line(`video quality, masks from ${masks}`,
        `subject consistency ${consistency ?? UNDEFINED}, imaging quality ${imaging ?? UNDEFINED}`)));
  }

  /** @param {*} scene @returns {HTMLElement} Verdicts of all planners under all protocols. */
  function verdictTable(scene) {
    const { models, protocols } = window.CHALLENGER;
    const judged = models.filter((model) => own(scene.verdicts, model.name));
    if (!judged.length) return element("p", { class: "quiet" }, "No planner ran on this scene.");
    const words = (name, protocol) => (verdict(scene, name, protocol) === undefined ? UNDEFINED
      : markOf(scene, name, protocol).join(" "));
    const samples = scene.adversarial ? ["samples that hit it", "another"] : ["colliding samples"];
    const causes = (name) => Object.entries(own(scene.causes, name) ?? {})
      .map(([cause, count]) => `${cause} ${count}`).join(", ");
    const view = site.tableView({
      id: "verdicts", title: "Who fails this scene", textColumns: protocols.length + 1,
      columns: ["planner", ...protocols, ...samples, "failed samples", "causes (exact)"],
      groups: [["", 1], ["protocol", protocols.length], ["", samples.length + 2]],
      rows: judged.map(({ name, privileged, miniature }) => [site.marked({ name, privileged, miniature }),
        ...protocols.map((protocol) => words(name, protocol)), countOf(scene.colliding, name),
        ...(scene.adversarial ? [countOf(scene.bystanders, name)] : []), String(own(scene.failed, name) ?? 0), causes(name)]),
      notes: [scene.adversarial
        ? `A planner fails a scene if one of its counted samples hits the adversary first within 3 s under the protocol. ◇: one
          hits another first, and none the adversary. ${UNDEFINED}: neither the record nor the protocol says whom.`
        : "A planner fails a scene if one of its counted samples collides within 3 s under the protocol.",
        `${scene.adversarial ? "Samples" : "Colliding samples"} and causes are those under protocol exact.`,
        ...(judged.some((model) => model.miniature) ? [site.MINIATURE_NOTE] : [])],
    });
    for (const cell of view.node.querySelectorAll("tbody td")) {
      const kind = KINDS[cell.textContent[0]];
      if (kind) cell.classList.add(kind);
    }
    return view.node;
  }

  /** @param {*} scene @param {Object<string, *>} params What of the player's state they take along.
   * @returns {HTMLElement[]} Links to its neighbours in the split. */
  function neighbours(scene, params) {
    const same = window.CHALLENGER.scenes.filter((each) => each.data === scene.data && each.split === scene.split);
    const at = same.indexOf(scene);
    const to = (other, words, rel) => (other
      ? element("a", { href: address(["scene", other.key], params), rel }, words)
      : element("span", { class: "quiet" }, words));
    return [to(same[at - 1], "← previous", "prev"),
      element("span", { class: "quiet" }, `${at + 1} of ${same.length} in ${scene.split}`),
      to(same[at + 1], "next →", "next")];
  }

  /** @param {*} scene @returns {HTMLElement|null} How its pictures are made, if they are not there. */
  function missingSheet(scene) {
    if (scene.hasSheet) return null;
    return element("p", { class: "remark" }, "There is no sheet of this scene: no map, no other vehicles, no cameras. ",
      element("code", {}, `challenger-bench sheets --split ${scene.split}`),
      " makes it; then write the leaderboard again. Until then the plans stand on a plain grid.");
  }

  /** @param {*} scene @returns {HTMLElement|null} How the search went round by round, if it was traced. */
  function rounds(scene) {
    if (!scene.rounds) return null;
    const drawn = window.CHALLENGER.figures.find((figure) => figure.path === scene.rounds);
    if (!drawn) return null;
    const title = "Rounds of refinement: candidates and scores of the adversary's search";
    return element("section", {}, element("h2", {}, "How the adversary was found"), site.figureView({ ...drawn, title }));
  }

  /** @param {*} value @returns {number|undefined} */
  const seconds = (value) => (value !== null && value !== "" && Number.isFinite(Number(value)) ? Number(value) : undefined);

  /** @param {*} scene @returns {string[]} Planners that ran on it, in the order of the tables. */
  const available = (scene) => window.CHALLENGER.models.map((model) => model.name)
    .filter((name) => own(scene.verdicts, name));

  /**
   * The player in its place.
   * @param {Route} here @param {*} scene @param {Object<string, *>} options Beside those that both pages have.
   * @param {(state: *) => Object<string, *>} kept What of the player's state goes into the address.
   * @param {() => void} follow Called when the address has changed, for links that take the state along.
   * @returns {{node: HTMLElement, ready: () => void, destroy: () => void}}
   */
  function playerIn(here, scene, options, kept, follow) {
    const node = element("div", { class: "player-place", "data-testid": "player" });
    let player = null;
    return {
      node,
      ready() {
        player = window.ChallengerPlayer.mount(node, scene.key, {
          t: seconds(here.params.get("t")),
          protocol: here.params.get("protocol") ?? firstProtocol(),
          camera: here.params.get("camera") ?? undefined,
          models_available: available(scene),
          models_order: window.CHALLENGER.models.map((model) => model.name),
          ...options,
          onState: (state) => { remember(here, kept(state)); follow(); },
        });
      },
      destroy: () => player?.destroy(),
    };
  }

  pages.scene = (here) => {
    const scene = sceneOf(here.parts[1]);
    requireKnown(here, { protocol: window.CHALLENGER.protocols });
    const asked = here.params.getAll("model");
    const unknown = asked.find((name) => !window.CHALLENGER.models.some((model) => model.name === name));
    if (unknown !== undefined) throw new AddressError(`There is no planner called “${unknown}”.`);
    const links = element("p", { class: "neighbours" });
    const comparison = element("p");
    const follow = () => {
      const shown = here.params.getAll("model");
      const common = { protocol: here.params.get("protocol"), camera: here.params.get("camera") };
      links.replaceChildren(...neighbours(scene, { model: shown, ...common }));
      const [a, b] = shown.length > 1 ? shown : unique([...shown, ...site.pairOf(scene, firstProtocol())]);
      if (a && b) {
        comparison.replaceChildren(element("a", { class: "button", href: address(["compare", scene.key],
          { a, b, t: here.params.get("t"), ...common }) }, `Compare ${a} and ${b} on this scene`));
      }
    };
    follow();
    const player = playerIn(here, scene, { compare: false, models: asked }, (state) => ({
      t: state.t, model: state.models, protocol: state.protocol, camera: state.camera,
    }), follow);
    return {
      title: scene.scene,
      nodes: [
        links,
        element("h1", {}, scene.scene, scene.manoeuvre ? element("span", { class: "tag" }, scene.manoeuvre) : null),
        missingSheet(scene), player.node,
        comparison,
        element("div", { class: "columns" }, verdictTable(scene), sceneFacts(scene)), site.severityTable(scene),
        site.driveLinks(scene), rounds(scene),
      ].filter((node) => node !== null),
      ready: player.ready, destroy: player.destroy,
    };
  };

  pages.compare = (here) => {
    const scene = sceneOf(here.parts[1]);
    requireKnown(here, { protocol: window.CHALLENGER.protocols });
    const names = available(scene);
    const pair = site.pairOf(scene, here.params.get("protocol") ?? firstProtocol());
    const a = here.params.get("a") ?? pair[0];
    const b = here.params.get("b") ?? pair.find((name) => name !== a) ?? names.find((name) => name !== a);
    const unknown = [a, b].find((name) => name !== undefined && !names.includes(name));
    if (unknown !== undefined) throw new AddressError(`“${unknown}” did not run on this scene.`);
    if (b === undefined) throw new AddressError(`Fewer than two planners ran on ${scene.scene}: nothing to compare.`);
    const back = element("a", {}, scene.scene);
    const follow = () => back.setAttribute("href", address(["scene", scene.key], {
      model: [here.params.get("a") ?? a, here.params.get("b") ?? b], t: here.params.get("t"),
      protocol: here.params.get("protocol"), camera: here.params.get("camera") }));
    follow();
    const player = playerIn(here, scene, { compare: true, models: [a, b] }, (state) => ({
      a: state.models[0], b: state.models[1], t: state.t, protocol: state.protocol, camera: state.camera,
    }), follow);
    return {
      title: `${a} and ${b} on ${scene.scene}`,
      nodes: [element("h1", {}, "Two planners on ", back), missingSheet(scene), player.node,
        element("div", { class: "columns" }, verdictTable(scene), sceneFacts(scene)), site.severityTable(scene),
      ].filter((node) => node !== null),
      ready: player.ready, destroy: player.destroy,
    };
  };

  Object.assign(site, { requireKnown });
})();
