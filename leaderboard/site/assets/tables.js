"use strict";
/* Tables that can be sorted and filtered, and the tabs that are made of them. */

/** Letters above which a cell, or a column's head, may be broken into lines. */
const LONG = 28, SHORT = 11;
/** Tables by place, light ...: one kind at a time, all of its slices or one; the kind is named by a column. */
const SLICES = "slices", KIND = 2, EVERY = "all";
const STEPS_OF = { ArrowLeft: -1, ArrowRight: 1, ArrowUp: -1, ArrowDown: 1 };
/** How much smaller than drawn a figure may be. */
const LEAST_SIZE = 0.97;
/** Columns that name planners, beside the first one. */
const OF_PLANNERS = ["planner", "failed by", "scenes of"];

// --- what stands behind a number ---------------------------------------------------------------------------------------
/** @param {CellFacts} cell @param {string} text What it shows. @returns {string[]} Lines of text. */
function factLines(cell, text) {
  const [unit, of, protocol, record, source] = (site().origins[cell.record] ?? []).map((place) => site().words[place]);
  const behind = unit && unit !== of ? ` ${unit}` : "";
  return [
    `${text}${text.startsWith("[") || text === UNDEFINED ? "" : behind}`,
    cell.n === undefined ? "N not known" : `N = ${cell.n}${of ? ` ${of}` : ""}`,
    cell.low === undefined ? "" : `95 %: ${cell.low} to ${cell.high}${behind}`,
    protocol ? `protocol ${protocol}` : "", record ? `record ${record}` : "", source ? `source: ${source}` : "",
  ].filter(Boolean);
}

/** The note beside a cell that says what stands behind its number. */
const note = element("div", { id: "cell-facts", class: "facts-note", role: "tooltip", hidden: true });

/** @param {HTMLElement} cell @param {CellFacts} facts */
function showNote(cell, facts) {
  note.replaceChildren(...factLines(facts, cell.textContent ?? "").map((line) => element("div", {}, line)));
  note.hidden = false;
  if (!note.isConnected) document.body.append(note);
  const at = cell.getBoundingClientRect();
  const left = Math.max(6, Math.min(at.left, document.documentElement.clientWidth - note.offsetWidth - 6));
  const above = at.top - note.offsetHeight - 6;
  note.style.left = `${left + scrollX}px`;
  note.style.top = `${(above > 0 ? above : at.bottom + 6) + scrollY}px`;
  cell.setAttribute("aria-describedby", "cell-facts");
}

/** @param {Element|null} [cell] */
function hideNote(cell) {
  cell?.removeAttribute("aria-describedby");
  note.hidden = true;
}

/** Arrow keys lead from cell to cell, Tab past. @param {HTMLTableSectionElement} body @param {CellFacts[]} known */
function listenToCells(body, known) {
  /** @param {Event} event @returns {HTMLTableCellElement|null} */
  const cellOf = ({ target }) => (target instanceof Element ? target.closest("td[data-facts]") : null);
  for (const type of ["pointerover", "focusin", "click"]) {
    body.addEventListener(type, (event) => {
      const cell = cellOf(event);
      if (cell) showNote(cell, known[Number(cell.dataset.facts)]);
    });
  }
  for (const type of ["pointerout", "focusout"]) body.addEventListener(type, (event) => hideNote(cellOf(event)));
  body.addEventListener("keydown", (event) => {
    const cell = cellOf(event);
    if (!cell) return;
    if (event.key === "Escape") hideNote(cell);
    const next = neighbour(cell, event.key);
    if (!next) return;
    event.preventDefault();
    cell.tabIndex = -1;
    next.tabIndex = 0;
    next.focus();
  });
}

/** @param {HTMLTableCellElement} cell @param {string} key @returns {HTMLTableCellElement|undefined} The next number. */
function neighbour(cell, key) {
  const [step, row, body] = [own(STEPS_OF, key), cell.closest("tr"), cell.closest("tbody")];
  if (!step || !row || !body) return undefined;
  const column = [...body.rows].filter((each) => !each.hidden && each.cells.length > 1).map((each) => each.cells[cell.cellIndex]);
  const numbers = (/Left|Right/.test(key) ? [...row.cells] : column).filter((each) => each.dataset.facts !== undefined);
  return numbers[numbers.indexOf(cell) + step];
}

// --- one table ---------------------------------------------------------------------------------------------------------
/** @param {string} text @returns {number|null} The number that a cell shows; intervals by their lower end. */
function numberIn(text) {
  const fraction = /^(\d+)\/(\d+)$/.exec(text);
  if (fraction) return Number(fraction[2]) ? Number(fraction[1]) / Number(fraction[2]) : null;
  const plain = text.replaceAll("−", "-").replaceAll(/(?<=\d),(?=\d{3})/g, "");
  if (/∞/.test(plain)) return plain.includes("-∞") ? -Infinity : Infinity;
  const found = /-?\d+(?:\.\d+)?(?:e[+-]?\d+)?/.exec(plain);
  return found ? Number(found[0]) : null;
}

/** @param {TableData} table @param {number} column @param {boolean} descending Dashes are last, rows that
 * stand apart behind all others. */
function ordered(table, column, descending) {
  const collator = new Intl.Collator("en", { numeric: true });
  const keys = table.rows.map((row) => {
    if (row[column] === UNDEFINED || row[column] === "") return null;
    return column < table.textColumns ? row[column] : numberIn(row[column]) ?? row[column];
  });
  return table.rows.map((_, index) => index).sort((a, b) => {
    const [one, other] = [keys[a], keys[b]];
    const part = Number(a >= (table.apart ?? Infinity)) - Number(b >= (table.apart ?? Infinity));
    if (part) return part;
    if (one === null || other === null) return Number(one === null) - Number(other === null) || a - b;
    const sign = typeof one === "number" && typeof other === "number" ? Math.sign(one - other) || 0
      : collator.compare(String(one), String(other));
    return (descending ? -sign : sign) || a - b;
  });
}

/** @param {string} text @returns {string} A planner's name without the marks behind it. */
const unmarked = (text) => text.replace(/(?: [†‡§✓¶])+$/, "");

/** @param {TableData} table @param {string[]} row @param {number} column @param {string|undefined} link */
function cellContent(table, row, column, link) {
  const text = row[column];
  if (column !== 0 && !OF_PLANNERS.includes(table.columns[column])) return text;
  const name = unmarked(text);
  if (!site().models.some((model) => model.name === name)) return text;
  return element("a", { href: address(["model", name]), "data-testid": link }, text);
}

/** @param {TableData} table @returns {Set<number>} Columns that begin a group. */
function groupEdges(table) {
  let column = 0;
  return new Set(table.groups.map(([, span]) => (column += span) - span).filter((first) => first > 0));
}

/** @param {TableData} table @param {string|undefined} link Its planners' test id. @returns {HTMLTableSectionElement} */
function tableBody(table, link) {
  const body = element("tbody");
  const known = /** @type {CellFacts[]} */ ([]);
  const edges = groupEdges(table);
  for (const [index, row] of table.rows.entries()) {
    body.append(element("tr", {}, row.map((text, column) => {
      const long = text.length > LONG ? "long" : null;
      if (column === 0) return element("th", { scope: "row", class: long }, cellContent(table, row, column, link));
      const kind = classes(column < table.textColumns ? "text" : text === UNDEFINED && "undefined",
        edges.has(column) && "edge", long, table.heat?.[index][column]);
      const facts = table.cells?.[index][column];
      if (!facts) return element("td", { class: kind }, cellContent(table, row, column, link));
      const number = known.push(facts) - 1;
      return element("td", { class: kind, "data-facts": number, tabindex: number ? -1 : 0 }, text);
    })));
  }
  listenToCells(body, known);
  return body;
}

/** @param {TableData} table @returns {string} Its rows as CSV, heads with their groups. */
function csvOf({ columns, groups, rows }) {
  const labels = groups.flatMap(([label, span]) => Array(span).fill(label));
  const heads = columns.map((name, at) => (labels[at] ? `${name} | ${labels[at]}` : name));
  /** @param {string} text */
  const quoted = (text) => (/[",\r\n]/.test(text) ? `"${text.replaceAll('"', '""')}"` : text === UNDEFINED ? "" : text);
  return [heads, ...rows].map((row) => `${row.map(quoted).join(",")}\n`).join("");
}

/** @param {TableData} table @returns {HTMLElement} Its title, and a link to its rows as a file. */
function tableHead(table) {
  const file = element("a", { href: "data:text/csv,", download: `${table.id}.csv`, "aria-label": `CSV of: ${table.title}`,
    onclick: () => { file.href = `data:text/csv;charset=utf-8,${encodeURIComponent(csvOf(table))}`; } }, "CSV");
  return element("div", { class: "table-head" }, element("h3", { id: `title-${table.id}` }, spelled(table.title)),
    element("span", { class: "files" }, file));
}

/** A table with its title and notes. @param {TableData} table @param {{notes?: string[], here?: Route, link?:
 * string}} [state] The page whose address holds the order, as `column.asc.id`; test id of its planners. */
function tableView(table, { notes = table.notes, here, link } = {}) {
  const body = tableBody(table, link);
  const rows = [...body.rows];
  const edges = groupEdges(table);
  const heads = table.columns.map((name, column) => element("th", {
    scope: "col", "aria-sort": column === table.sorted ? "ascending" : "none",
    class: classes(column < table.textColumns && "text", edges.has(column) && "edge", name.length > SHORT && "long"),
  }, element("button", { type: "button", onclick: () => turn(column) }, spelled(name))));

  const apart = table.apart ?? 0;
  const label = apart > 0 && apart < rows.length ? [element("tr", { class: "apart" }, element("th",
    { scope: "colgroup", colspan: heads.length }, "Baselines: what the numbers are read against"))] : [];

  /** @param {number[]} order Of its rows. */
  function place(order) {
    const placed = order.map((index) => rows[index]);
    body.append(...placed.slice(0, apart), ...label, ...placed.slice(apart));
  }

  /** @param {number|null} column @param {boolean} descending */
  function arrange(column, descending) {
    heads.forEach((head, index) => head.setAttribute("aria-sort",
      index !== column ? "none" : descending ? "descending" : "ascending"));
    place(column === null ? [...rows.keys()] : ordered(table, column, descending));
  }

  /** First click: up; second: down; third: as it came. @param {number} column */
  function turn(column) {
    const state = heads[column].getAttribute("aria-sort");
    arrange(state === "descending" ? null : column, state === "ascending");
    const next = state === "none" ? `${column}.asc` : state === "ascending" ? `${column}.desc` : null;
    if (here) remember(here, { sort: next && `${next}.${table.id}` });
  }

  place([...rows.keys()]);
  const sort = /^(\d+)\.(asc|desc)\.(.*)$/s.exec(here?.params.get("sort") ?? "");
  if (sort && sort[3] === table.id && Number(sort[1]) < heads.length) arrange(Number(sort[1]), sort[2] === "desc");
  const groups = table.groups.some(([label]) => label) ? element("tr", { class: "groups" }, table.groups.map(
    ([label, span]) => element(label ? "th" : "td", { colspan: span, scope: label ? "colgroup" : null, class: "edge" },
      spelled(label)),
  )) : null;
  const nothing = element("p", { class: "quiet", hidden: true }, "No row matches the filter.");
  const node = element("section", { class: "table-section", id: `section-${table.id}` },
    tableHead(table),
    element("div", { class: "table-box", tabindex: "0", role: "region", "aria-labelledby": `title-${table.id}` },
      element("table", { "data-testid": `table-${table.id}`, "aria-labelledby": `title-${table.id}` },
        element("thead", {}, groups, element("tr", {}, heads)), body)),
    nothing,
    notes.length ? element("ul", { class: "notes" }, notes.map((sentence) => element("li", {}, spelled(sentence)))) : null);
  return {
    node,
    /** @param {RowFilter} fits */
    filter(fits) {
      table.rows.forEach((row, index) => { rows[index].hidden = !fits(row.join(" ").toLowerCase(), row, table); });
      nothing.hidden = rows.some((row) => !row.hidden);
    },
  };
}

/** Several tables below each other, a note that stands above not said again, and what filters their rows.
 * @param {TableData[]} tables @param {Route} here
 * @param {{link?: string, fits?: (row: string[], table: TableData) => boolean}} [of] Test id of planners; rows that are
 * shown at all. @returns {{nodes: HTMLElement[], filter: (text: string|null) => void}} */
function tableViews(tables, here, { link, fits = () => true } = {}) {
  const said = new Set();
  const views = tables.map((table) => {
    const notes = table.notes.filter((sentence) => !said.has(sentence) && said.add(sentence));
    return tableView(table, { notes, here, link });
  });
  /** @param {string|null} text */
  const filter = (text) => {
    const matches = matcher(text);
    views.forEach((view) => view.filter((words, row, table) => matches(words) && fits(row, table)));
  };
  filter(here.params.get("q"));
  return { nodes: views.map((view) => view.node), filter };
}

// --- tabs of tables ----------------------------------------------------------------------------------------------------
/** A tab: what stands first, its figures, its tables below their groups, what stands last.
 * @param {Route} here @param {TabOptions} options @returns {Page} */
function tabPage(here, options) {
  const { tables, figures, starts, tabs } = site();
  const { tab, title, lead, first = [], last = [], choices = [], link, also } = options;
  const { fits = ({ group }) => own(tabs, group) === tab } = options;
  const names = unique([...starts, ...tables].map(({ data }) => data ?? "").filter(Boolean));
  const data = asked(here, "data", names);
  const mine = tables.filter((table) => [data, ""].includes(table.data ?? "") && fits(table));
  const groups = unique(mine.map((table) => table.group ?? "")).sort((a, b) => Number(/^protocol /.test(b)) - Number(/^protocol /.test(a)));
  const wanted = asked(here, "group", ["", ...groups]);
  const sliced = slicesOf(mine.filter((table) => table.group === SLICES), here);
  const shown = mine.filter((table) => table.group !== SLICES || sliced.tables.includes(table));
  const { nodes, filter } = tableViews(shown, here,
    { link, fits: (row, { group }) => group !== SLICES || sliced.fits(row) });
  const heads = new Map(groups.map((group) => [group, element("h2", {}, group.charAt(0).toUpperCase() + group.slice(1))]));
  const drawings = figures.filter((figure) => figure.data === data && figure.tab === tab);
  const kept = Object.fromEntries(["data", "protocol", "q"].map((name) => [name, here.params.get(name)]));
  return {
    title,
    target: heads.get(wanted) ?? options.target,
    nodes: [
      element("h1", {}, title), element("p", { class: "lead" }, lead), ...first,
      element("div", { class: "toolbar" }, pageChoice(here, "Data set", "data", names), choices,
        filterField(here, "Rows with", (text) => { filter(text); also?.(); })),
      groups.length > 1 ? element("nav", { class: "contents", "aria-label": "On this page" }, "On this page: ",
        groups.map((group) => element("a", { href: address([tab], { ...kept, group }) }, group))) : null,
      drawings.length ? element("section", { class: "figures" }, drawings.map(figureView)) : null,
      ...groups.flatMap((group) => [heads.get(group) ?? null,
        group === SLICES ? element("div", { class: "toolbar" }, sliced.choices) : null,
        ...nodes.filter((_, at) => shown[at].group === group)]),
      mine.length ? null : element("p", { class: "quiet" }, "The records have no tables for this page."),
      ...last,
    ],
  };
}

pages.transfer = (here) => tabPage(here, { tab: "transfer", title: "Transfer",
  lead: "Who else fails the scenes that a planner fails, and how far any two of them are apart." });

pages.protocols = (here) => {
  const names = unique(site().tables.flatMap(({ group }) => /^protocol (.+)$/s.exec(group ?? "")?.[1] ?? []));
  const shown = [`protocol ${asked(here, "protocol", names)}`, "protocols against exact"];
  return tabPage(here, { tab: "protocols", title: "Protocols", choices: [pageChoice(here, "Protocol", "protocol", names)],
    lead: "The same plans under other protocols. Two protocols never share a column; exact and each planner's own "
      + "protocol are among the results.", fits: ({ group }) => shown.includes(group ?? "") });
};

/** Of slices one kind, and all of its slices or one. @param {TableData[]} tables Of the group. @param {Route} here */
function slicesOf(tables, here) {
  if (!tables.length) return { tables, fits: () => true, choices: [] };
  const kinds = unique(tables.map((table) => table.columns[KIND]));
  const by = asked(here, "by", kinds);
  const shown = tables.filter((table) => table.columns[KIND] === by);
  const names = [EVERY, ...unique(shown.flatMap((table) => table.rows.map((row) => row[KIND])))];
  const only = asked(here, "slice", names);
  return {
    tables: shown,
    fits: (/** @type {string[]} */ row) => only === EVERY || row[KIND] === only,
    choices: [
      field("By", selectOf(kinds, by, (value) => { remember(here, { by: value, slice: null, sort: null }); show(); },
        { "data-testid": "filter-by" })),
      pageChoice(here, by.charAt(0).toUpperCase() + by.slice(1), "slice", names),
    ],
  };
}

/** @param {FigureData} figure @returns {HTMLElement} */
function figureView({ title, path, dark, size: [width, height] }) {
  const shown = picture({ light: path, dark, alt: title, width: width || null, height: height || null });
  // Letters are as large as they were meant where the figure is as wide as it was drawn; narrower pages scroll it.
  if (width) shown.style.minWidth = `${Math.round(LEAST_SIZE * width)}px`;
  return element("figure", { class: "figure" },
    element("div", { class: "figure-box", tabindex: "0", role: "region", "aria-label": title },
      element("a", { href: path }, shown)),
    element("figcaption", {}, title));
}
