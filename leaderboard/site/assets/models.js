"use strict";
/* The pages of planners: rows of the tables, worst scenes, and what exactly ran. */

const WORST_SHOWN = 12;

pages.planners = (here) => {
  const { protocols } = site();
  const protocol = asked(here, "protocol", protocols);
  return tabPage(here, { tab: "planners", title: "Planners", lead: "Collision rates; a planner's page has all of its rows.",
    choices: [pageChoice(here, "Protocol", "protocol", protocols)], link: "model-link",
    fits: ({ judge }) => judge === protocol });
};

pages.model = (here) => {
  const { models, protocols, tables } = site();
  const model = models.find((each) => each.name === here.parts[1]);
  if (!model) throw new AddressError(`There is no planner called “${here.parts[1] ?? ""}”.`);
  const protocol = asked(here, "protocol", protocols);
  const mine = tables.filter((table) => table.ofPlanner && table.columns[0] === "planner").map((table) => {
    const fits = table.rows.map((row) => unmarked(row[0]) === model.name);
    return { ...table, rows: table.rows.filter((_, at) => fits[at]), cells: table.cells?.filter((_, at) => fits[at]) ?? null };
  }).filter((table) => table.rows.length);
  return {
    title: model.name,
    nodes: [
      element("h1", {}, model.shown),
      element("p", { class: "lead" }, model.lead.join(" ")),
      element("div", { class: "toolbar" }, pageChoice(here, "Protocol", "protocol", protocols)),
      element("h2", {}, `Its worst scenes, protocol ${protocol}`), worstScenes(model, protocol),
      element("p", {}, element("a", { href: address(["scenes"], { fails: model.name }) }, "All scenes that it fails")),
      element("h2", {}, "Its rows of the tables"),
      ...tableViews(mine, here).nodes,
      element("h2", {}, "What ran"), factList(model.facts),
      ...model.runs.map((run) => element("details", { class: "run" }, element("summary", {}, run.title),
        factList(run.facts))),
    ],
  };
};

/** @param {Fact[]} facts @returns {HTMLElement} */
const factList = (facts) => element("dl", { class: "facts" }, facts.map(([term, text, code]) =>
  [element("dt", {}, term), element("dd", {}, code ? element("code", {}, text) : text)]));

/** @param {ModelData} model @param {string} protocol @returns {HTMLElement} */
function worstScenes(model, protocol) {
  /** @param {SceneData} scene */
  const colliding = (scene) => own(scene.samples, model.name)?.[0] ?? 0;
  const found = site().scenes.filter((scene) => kindOf(scene, model.name, protocol) === "bad")
    .sort((a, b) => colliding(b) - colliding(a)).slice(0, WORST_SHOWN);
  if (!found.length) return element("p", { class: "quiet" }, `It fails no scene under protocol ${protocol}.`);
  return element("div", { class: "cards" }, found.map((scene) => sceneCard(scene, protocol, model.name)));
}
