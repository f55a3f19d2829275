"use strict";
/* The scene browser, what the search tried, and the pages around the player. */

const ATTEMPTS_SHOWN = 400;

/** @param {SceneData} scene @param {string} model @param {string} protocol @returns {string|undefined} Its kind of mark. */
function kindOf(scene, model, protocol) {
  const mark = own(own(scene.marks, model), protocol);
  return mark && site().legend[mark][1];
}

/** @param {string|undefined} key @returns {SceneData} */
function sceneOf(key) {
  const scene = site().scenes.find((each) => each.key === key);
  if (!scene) throw new AddressError(`There is no scene with the key “${key ?? ""}”.`);
  return scene;
}

// --- lists that are filtered -------------------------------------------------------------------------------------------
/** What an address asks of a list, and the controls. @template T @param {Route} here @param {Filter[]} filters
 * @param {(item: T, name: string, value: string) => boolean} fits @param {() => void} refresh */
function filtersOf(here, filters, fits, refresh) {
  const used = filters.filter(({ choices }) => choices.length);
  for (const { name, choices } of used) asked(here, name, choices.map((each) => [each].flat()[0]));
  return {
    controls: used.filter(({ name, choices }) => name !== "data" || choices.length > 1).map(
      ({ name, label, any, choices }) => placedChoice(here, label, name, [["", any], ...choices], refresh)),
    fitting: (/** @type {T[]} */ items) => items.filter((item) => filters.every(({ name }) => {
      const value = here.params.get(name);
      return !value || fits(item, name, value);
    })),
  };
}

/** @param {string} testid @returns {HTMLElement} Where it stands how many of a list are shown. */
const countPlace = (testid) => element("p", { class: "count", "data-testid": testid, "aria-live": "polite" });

// --- scenes ------------------------------------------------------------------------------------------------------------
/** @param {SceneData} scene @param {string} protocol @param {string|null} [model] Whose plans its page starts with. */
function sceneCard(scene, protocol, model) {
  const href = address(["scene", scene.key], { model });
  // One mark a planner, in the order of the tables: shape and words, never colour alone.
  const marks = site().models.flatMap(({ name }) => {
    const mark = own(own(scene.marks, name), protocol);
    if (!mark) return [];
    const [sign, kind, words] = site().legend[mark];
    return [element("span", { class: kind, title: `${name}: ${words}` }, sign)];
  });
  return element("article", { class: "card", "data-testid": "scene-card", "data-key": scene.key },
    element("a", { class: "picture", href, tabindex: "-1", "aria-hidden": "true" },
      scene.thumb ? picture({ light: scene.thumb, dark: scene.thumbDark ?? "", alt: "", width: 320, height: 320 })
        : element("span", { class: "no-picture" }, "no sheet")),
    element("div", { class: "card-text" },
      element("a", { class: "name", href }, scene.scene),
      element("span", { class: "tags" }, [scene.split, scene.manoeuvre].filter(Boolean).map((tag) =>
        element("span", { class: "tag" }, tag))),
      element("span", { class: "verdict" }, own(scene.tally, protocol) ?? "not judged", own(scene.samples, model)?.[1]),
      scene.judged.length ? element("span", { class: "judged", "data-testid": "judged" },
        scene.judged.map(([kind, words, title], at) =>
          [at ? " · " : "", element("span", { class: kind || null, title: title || null }, words)])) : null,
      element("span", { class: "marks", "aria-hidden": "true" }, marks)));
}

/** @param {any} scene @param {string} name @param {string} value @param {string} protocol @returns {boolean} */
function sceneFits(scene, name, value, protocol) {
  if (name === "fails") return kindOf(scene, value, protocol) === "bad";
  if (name === "passes") return ["good", "other"].includes(kindOf(scene, value, protocol) ?? "");
  return Array.isArray(scene[name]) ? scene[name].includes(value) : scene[name] === value;
}

pages.scenes = (here) => {
  const { scenes, protocols, sceneFilters, sceneOrders, legend } = site();
  const count = countPlace("scene-count");
  const cards = element("div", { class: "cards" });
  const protocol = () => here.params.get("protocol") || protocols[0];
  const list = filtersOf(here, sceneFilters, (scene, name, value) => sceneFits(scene, name, value, protocol()),
    () => refresh());
  function refresh() {
    const [order, model] = [asked(here, "sort", sceneOrders.map(([name]) => name)), here.params.get("fails")];
    const matches = matcher(here.params.get("q"));
    /** @param {SceneData} scene @returns {number} Least first. */
    const key = ({ counts, order: known }) => {
      const [bad, split] = own(counts, protocol()) ?? [0, 0];
      return own({ name: 0, hardest: -bad, easiest: bad, split: -split, ...known }, order) ?? Number.MAX_VALUE;
    };
    const found = list.fitting(scenes).filter((scene) => matches(scene.text)).sort((a, b) => key(a) - key(b));
    count.textContent = countLine(found.length, scenes.length, "scene");
    cards.replaceChildren(...found.map((scene) => sceneCard(scene, protocol(), model)));
  }
  asked(here, "protocol", protocols);
  refresh();
  const signs = Object.values(scenes.some((scene) => scene.manoeuvre) ? { X: legend.X, a: legend.a, o: legend.o }
    : { x: legend.x, o: legend.o });
  return {
    title: "Scenes",
    nodes: [
      element("h1", {}, "Scenes"),
      element("div", { class: "toolbar" },
        filterField(here, "Scenes with", refresh), list.controls,
        protocols.length > 1 ? placedChoice(here, "Protocol", "protocol", protocols, refresh) : null,
        placedChoice(here, "Order", "sort", sceneOrders, refresh)),
      element("div", { class: "count-line" }, count, element("p", { class: "legend" },
        signs.map(([sign, kind, words]) => [element("span", { class: kind }, sign), ` ${words}  `]),
        element("span", { class: "open" }, UNDEFINED), " cannot be said; one mark a planner")),
      cards,
    ],
  };
};

// --- what the search tried ---------------------------------------------------------------------------------------------
pages.generation = (here) => {
  const { attempts, attemptFilters, attemptTally, scenes } = site();
  const place = element("div");
  const known = new Set(scenes.map((scene) => scene.key));
  const count = countPlace("attempt-count");
  const list = filtersOf(here, attemptFilters, (/** @type {Record<string, string>} */ attempt, name, value) =>
    attempt[name] === value, () => refresh());
  function refresh() {
    const matches = matcher(here.params.get("q"));
    const found = list.fitting(attempts).filter((attempt) => matches(Object.values(attempt).join(" ").toLowerCase()));
    count.textContent = countLine(found.length, attempts.length, "attempt");
    const shown = found.slice(0, ATTEMPTS_SHOWN);
    const { node } = tableView({
      id: "attempts", title: "Attempts", textColumns: 6, groups: [], cells: null,
      columns: ["recording", "vehicle", "split", "outcome", "manoeuvre", "scene"],
      rows: shown.map((attempt) => ["source", "agent", "split", "reason", "manoeuvre", "scene"]
        .map((name) => attempt[name] ?? UNDEFINED)),
      notes: found.length > shown.length ? [`The first ${shown.length} of ${found.length}; filter to see others.`] : [],
    });
    node.querySelectorAll("tbody tr").forEach((row, at) => {
      const { key, scene } = shown[at];
      if (known.has(key)) row.lastElementChild?.replaceChildren(element("a", { href: address(["scene", key]) }, scene));
    });
    place.replaceChildren(node);
  }
  refresh();
  const every = element("h2", {}, "Every attempt");
  return tabPage(here, {
    tab: "generation", title: "Generation", also: refresh, target: here.params.get("reason") ? every : undefined,
    lead: "A vehicle is tried as the adversary, and kept only if the scene is physically sound, solvable and hard enough.",
    first: attempts.length ? [element("dl", { class: "tally" }, attemptTally.map(([reason, value]) => [
      element("dt", {}, element("a", { href: address(["generation"], { reason }) }, reason)),
      element("dd", {}, element("progress", { max: attemptTally[0][1], value, "aria-hidden": "true" }), value)]))]
      : [element("p", { class: "remark" }, "Nothing is known of a search: the sheets of generated splits say it (",
        element("code", {}, "challenger-bench sheets --split adv"), "), then write the leaderboard again.")],
    last: attempts.length ? [every, element("div", { class: "toolbar" }, list.controls), count, place] : [],
  });
};

// --- one scene ---------------------------------------------------------------------------------------------------------
/** @param {SceneData} scene @returns {HTMLElement} What its script says of it, once that is there. */
function sceneFacts(scene) {
  const place = element("div", { class: "columns" });
  loadScript(scene.key).then(({ page }) => {
    if (!page) return;
    const { facts, tables } = /** @type {ScenePage} */ (page);
    const views = tables.map((table) => {
      const { node } = tableView(table);
      for (const cell of node.querySelectorAll("tbody td")) {
        const kind = Object.values(site().legend).find(([sign]) => cell.textContent?.startsWith(`${sign} `))?.[1];
        if (kind) cell.classList.add(kind);
      }
      return node;
    });
    const terms = facts.map(([term, lines]) => [element("dt", {}, term), element("dd", {}, lines.map((parts) =>
      element("div", {}, parts.map((each) =>
        (Array.isArray(each) ? element("a", { href: each[1] }, spelled(each[0])) : spelled(each))))))]);
    place.replaceChildren(...views.slice(0, 1), element("dl", { class: "facts" }, terms), ...views.slice(1));
  }).catch(() => {});  // The player says why there is no script.
  return place;
}

/** @param {SceneData} scene @param {Record<string, any>} params @returns {HTMLElement[]} Links to those beside it. */
function neighbours(scene, params) {
  const same = site().scenes.filter((each) => each.data === scene.data && each.split === scene.split);
  const at = same.indexOf(scene);
  /** @param {SceneData|undefined} other @param {string} words @param {string} rel @returns {HTMLElement} */
  const to = (other, words, rel) => (other ? element("a", { href: address(["scene", other.key], params), rel }, words)
    : element("span", { class: "quiet" }, words));
  return [to(same[at - 1], "← previous", "prev"),
    element("span", { class: "quiet" }, `${at + 1} of ${same.length} in ${scene.split}`),
    to(same[at + 1], "next →", "next")];
}

/** @param {SceneData} scene @returns {HTMLElement|null} How its pictures are made, if they are not there. */
function missingSheet(scene) {
  if (scene.hasSheet) return null;
  return element("p", { class: "remark" }, "There is no sheet of this scene: no map, no other vehicles, no cameras. ",
    element("code", {}, `challenger-bench sheets --split ${scene.split}`),
    " makes it; then write the leaderboard again. Until then the plans stand on a plain grid.");
}

/** @param {SceneData} scene @returns {HTMLElement|null} How the search went round by round, if it was traced. */
function rounds(scene) {
  const found = site().figures.find((figure) => figure.path === scene.rounds);
  if (!found) return null;
  const title = "Rounds of refinement: candidates and scores of the adversary's search";
  return element("section", {}, element("h2", {}, "How the adversary was found"), figureView({ ...found, title }));
}

/** @param {SceneData} scene @returns {HTMLElement|null} Its drives, if it has any. */
function driveLinks(scene) {
  const drives = site().drives.filter((each) => each.scene === scene.key);
  if (!drives.length) return null;
  return element("section", { "data-testid": "drives" }, element("h2", {}, "Driven in closed loop"),
    element("ul", {}, drives.map(({ key, planner, measured, outcome }) => element("li", {},
      key ? element("a", { href: address(["drive", key]) }, planner) : planner, ` ${measured}: ${outcome}`))));
}

/** A page around a player. @param {Route} here @param {string} key @param {PlayerOptions} options Beside the address.
 * @param {(state: any) => Record<string, any>} kept What of its state goes there. @param {string} title
 * @param {(node: HTMLElement) => Page["nodes"]} around @param {() => void} [follow] After changes. @returns {Page} */
function playerPage(here, key, options, kept, title, around, follow = () => {}) {
  const node = element("div", { class: "player-place", "data-testid": "player" });
  const t = Number(here.params.get("t") || NaN);
  let player = /** @type {{destroy: () => void}|null} */ (null);
  asked(here, "protocol", site().protocols);
  follow();
  return {
    title,
    nodes: around(node),
    ready() {
      player = playIn(node, key, (scene) => new Player(node, scene, {
        t: Number.isFinite(t) ? t : undefined, protocol: here.params.get("protocol") ?? undefined,
        camera: here.params.get("camera") ?? undefined, ...options,
        onState: (state) => { remember(here, kept(state)); follow(); },
      }), (sentence) => node.replaceChildren(errorLine(sentence)));
    },
    destroy: () => player?.destroy(),
  };
}

/** @param {Route} here @returns {Record<string, string|null>} What pages of a scene take along. */
const common = ({ params }) => ({ protocol: params.get("protocol"), camera: params.get("camera") });

pages.scene = (here) => {
  const scene = sceneOf(here.parts[1]);
  const models = here.params.getAll("model");
  const unknown = models.find((name) => !site().models.some((model) => model.name === name));
  if (unknown !== undefined) throw new AddressError(`There is no planner called “${unknown}”.`);
  const links = element("p", { class: "neighbours" });
  const comparison = element("p");
  const title = element("h1", {}, scene.scene, scene.manoeuvre && element("span", { class: "tag" }, scene.manoeuvre));
  return playerPage(here, scene.key, { models }, ({ models: model, ...state }) => ({ ...state, model }), scene.scene,
    (node) => [links, title, missingSheet(scene), node, comparison, sceneFacts(scene), driveLinks(scene),
      rounds(scene)], () => {
    const model = here.params.getAll("model");
    links.replaceChildren(...neighbours(scene, { model, ...common(here) }));
    const [a, b] = model.length > 1 ? model : unique([...model, ...scene.pair]);
    const href = address(["compare", scene.key], { a, b, t: here.params.get("t"), ...common(here) });
    if (b) comparison.replaceChildren(element("a", { class: "button", href }, `Compare ${a} and ${b} on this scene`));
  });
};

pages.compare = (here) => {
  const scene = sceneOf(here.parts[1]);
  const a = here.params.get("a") ?? scene.pair[0];
  const b = here.params.get("b") ?? scene.pair.find((name) => name !== a);
  const unknown = [a, b].find((name) => name !== undefined && !own(scene.marks, name));
  if (unknown !== undefined) throw new AddressError(`“${unknown}” did not run on this scene.`);
  if (b === undefined) throw new AddressError(`Fewer than two planners ran on ${scene.scene}: nothing to compare.`);
  const back = element("a", {}, scene.scene);
  return playerPage(here, scene.key, { compare: true, models: [a, b] },
    ({ models: [left, right], ...state }) => ({ ...state, a: left, b: right }), `${a} and ${b} on ${scene.scene}`,
    (node) => [element("h1", {}, "Two planners on ", back), missingSheet(scene), node, sceneFacts(scene)],
    () => back.setAttribute("href", address(["scene", scene.key], {
      model: [here.params.get("a") ?? a, here.params.get("b") ?? b], t: here.params.get("t"), ...common(here) })));
};

pages.drive = (here) => {
  const drive = site().drives.find(({ key }) => key !== null && key === here.parts[1]);
  if (!drive?.key) throw new AddressError(`There is no drive with the key “${here.parts[1] ?? ""}”.`);
  const scene = site().scenes.find(({ key }) => key === drive.scene);
  const { key, planner, measured, outcome, note } = drive;
  return playerPage(here, key, {}, ({ t }) => ({ t }), `${planner} drives`, (node) => [
    element("h1", {}, planner, " drives ",
      scene ? element("a", { href: address(["scene", scene.key]) }, scene.scene) : "a scene"),
    element("p", {}, `Closed loop: ${measured}; ${outcome}.`),
    element("p", { class: "remark", "data-testid": "drive-note" }, note), node,
  ]);
};
