"use strict";
/* The pages of planners: rows of the tables, drawn too, and what exactly ran. */

/** Colours that colour-blind readers tell apart (Okabe and Ito), always with a shape. */
const SERIES = ["var(--blue)", "var(--purple)", "var(--gold)", "var(--text)", "var(--sky)", "var(--brown)"];
const SERIES_SHAPES = ["square", "circle", "triangle", "diamond"];
const WORST_SHOWN = 12;

pages.models = (here) => {
  const { models, protocols, tables } = site();
  const names = unique(models.flatMap((model) => model.data));
  const data = asked(here, "data", names);
  const protocol = asked(here, "protocol", protocols);
  const { nodes, field } = tableViews(tables.filter((table) => table.data === data && table.judge === protocol), here,
    { link: "model-link" });
  return {
    title: "Planners",
    nodes: [
      element("h1", {}, "Planners"),
      element("div", { class: "toolbar" }, pageChoice(here, "Data set", "data", names),
        pageChoice(here, "Protocol", "protocol", protocols), field),
      ...nodes,
      models.length ? null : element("p", {}, "There are no run records."),
    ],
  };
};

pages.model = (here) => {
  const { models, protocols, tables } = site();
  const model = models.find((each) => each.name === here.parts[1]);
  if (!model) throw new AddressError(`There is no planner called “${here.parts[1] ?? ""}”.`);
  const protocol = asked(here, "protocol", protocols);
  const mine = tables.filter((table) => table.ofPlanner && table.columns[0] === "planner")
    .map((table) => rowsOf(table, (row) => unmarked(row[0]) === model.name)).filter((table) => table.rows.length);
  const drawings = mine.filter((table) => table.chart?.length && (!table.judge || table.judge === protocol));
  return {
    title: model.name,
    nodes: [
      element("h1", {}, model.shown),
      element("p", { class: "lead" }, model.lead.join(" ")),
      element("div", { class: "toolbar" }, pageChoice(here, "Protocol", "protocol", protocols)),
      element("div", { class: "charts" }, drawings.map((table) => chart(model.name, table))),
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

/** Some columns, a line for each split. @param {string} name @param {TableData} table Rows of one planner, by split. */
function chart(name, table) {
  const columns = table.chart ?? [];
  const split = table.columns.indexOf("split");
  const lines = table.rows.map((row, at) => columns.map((column) => {
    const value = numberIn(row[column]);
    const facts = table.cells?.[at][column];
    return value === null ? null : { value, low: Number(facts?.low ?? value), high: Number(facts?.high ?? value) };
  }));
  const top = Math.max(1, ...lines.flat().map((each) => each?.high ?? 0));
  const step = [0.25, 0.5, 1, 2, 5, 10, 25].find((each) => top / each <= 4) ?? 50;
  const limit = step * Math.ceil(top / step - 1e-9);
  const [left, right, upper, lower] = [44, 330, 12, 150];
  const apart = 285 / columns.length;
  /** @param {number} index */
  const middle = (index) => left - 7.5 + (index + 0.5) * apart;
  /** @param {number} index @param {number} series */
  const x = (index, series) => middle(index) + (series - (lines.length - 1) / 2) * Math.min(9, apart / 4);
  /** @param {number} value */
  const y = (value) => lower - (Math.min(value, limit) / limit) * (lower - upper);
  const ticks = Array.from({ length: Math.round(limit / step) + 1 }, (_, index) => index * step);
  return element("figure", { class: "chart" },
    drawn("svg", { viewBox: "0 0 340 178", role: "img", "aria-label": `${name}, ${table.title}; the numbers are below` },
      ticks.map((tick) => [
        drawn("line", { x1: left, x2: right, y1: y(tick), y2: y(tick), class: "grid" }),
        drawn("text", { x: left - 6, y: y(tick) + 4, "text-anchor": "end" }, `${tick} %`)]),
      columns.map((column, index) => drawn("text", { x: middle(index), y: 170, "text-anchor": "middle" },
        table.columns[column].replace(/^col\. /, ""))),
      lines.map((line, series) => drawn("g", { class: "series", stroke: SERIES[series % SERIES.length] },
        drawn("polyline", { fill: "none", points: line.map((each, index) => (each
          ? `${x(index, series)},${y(each.value)}` : "")).join(" ") }),
        line.map((each, index) => each && [
          drawn("line", { x1: x(index, series), x2: x(index, series), y1: y(each.low), y2: y(each.high), class: "whisker" }),
          seriesMark(series, x(index, series), y(each.value))])))),
    element("figcaption", {}, `${table.title}: `, table.rows.map((row, series) =>
      element("span", { class: "key" }, drawn("svg", { viewBox: "-7 -7 14 14", "aria-hidden": "true" },
        seriesMark(series)), row[split]))));
}

/** @param {number} series @param {number} [x] @param {number} [y] @returns {Element} Its mark. */
const seriesMark = (series, x, y) => outline(SERIES_SHAPES[series % SERIES_SHAPES.length],
  { fill: SERIES[series % SERIES.length] }, x, y);
