"use strict";
/* Tables that can be sorted and filtered, and the page of all tables. */
(() => {
  const site = window.ChallengerSite;
  const { AddressError, UNDEFINED, address, choice, element, filterField, matcher, pages, picture, remember, show, unique } = site;

  const MARKS = ["†", "‡", "§"];

  /** Letters above which a cell, or a column's head, may be broken into lines. */
  const LONG = 28, SHORT = 11;
  const FIGURES = "figures";
  /** Tables by place, light ...: one kind at a time, all of its slices or one. */
  const SLICES = "slices";
  const KIND = 2;
  const EVERY = "all";
  /** What the first groups were called while they were one. */
  const ONCE = "exact and own protocols";
  /** How much smaller than drawn a figure may be. */
  const LEAST_SIZE = 0.97;

  // --- cells -------------------------------------------------------------------------------------------------------
  /** @param {string} text @returns {number|null} The number that a cell shows; intervals by their lower end. */
  function numberIn(text) {
    const fraction = /^(\d+)\/(\d+)$/.exec(text);
    if (fraction) return Number(fraction[2]) ? Number(fraction[1]) / Number(fraction[2]) : null;
    const plain = text.replaceAll("−", "-");
    if (/∞/.test(plain)) return plain.includes("-∞") ? -Infinity : Infinity;
    const found = /-?\d+(?:\.\d+)?(?:e[+-]?\d+)?/.exec(plain);
    return found ? Number(found[0]) : null;
  }

  /** @typedef {{n?: number, low?: number|string, high?: number|string, record?: number, origin?: string[]}} Cell Facts
   *   behind a number; `record` is a place among the origins of the index, `origin` stands for one that is not there. */

  /** @param {Cell} cell @returns {(string|undefined)[]} Unit, what is counted, protocol, record, source. */
  const originOf = (cell) => cell.origin
    ?? (window.CHALLENGER.origins[cell.record] ?? []).map((place) => window.CHALLENGER.words[place]);

  /** @param {Cell} cell @param {string} text What it shows. @returns {string[]} The same as lines of text. */
  function factLines(cell, text) {
    const [unit, of, protocol, record, source] = originOf(cell);
    const behind = unit && unit !== of ? ` ${unit}` : "";
    return [
      `${text}${text.startsWith("[") || text === UNDEFINED ? "" : behind}`,
      cell.n === undefined ? "N not known" : `N = ${cell.n}${of ? ` ${of}` : ""}`,
      cell.low === undefined ? null : `95 %: ${cell.low} to ${cell.high}${behind}`,
      protocol ? `protocol ${protocol}` : null,
      record ? `record ${record}` : null,
      source ? `source: ${source}` : null,
    ].filter((line) => line !== null);
  }

  /** The note beside a cell that says what stands behind its number. */
  const note = element("div", { id: "cell-facts", class: "facts-note", role: "tooltip", hidden: true });

  /** @param {HTMLElement} cell @param {*} facts */
  function showNote(cell, facts) {
    note.replaceChildren(...factLines(facts, cell.textContent).map((line) => element("div", {}, line)));
    note.hidden = false;
    if (!note.isConnected) document.body.append(note);
    const at = cell.getBoundingClientRect();
    const left = Math.max(6, Math.min(at.left, document.documentElement.clientWidth - note.offsetWidth - 6));
    const above = at.top - note.offsetHeight - 6;
    note.style.left = `${left + scrollX}px`;
    note.style.top = `${(above > 0 ? above : at.bottom + 6) + scrollY}px`;
    cell.setAttribute("aria-describedby", "cell-facts");
  }

  /** @param {HTMLElement} [cell] */
  function hideNote(cell) {
    cell?.removeAttribute("aria-describedby");
    note.hidden = true;
  }

  /** Arrow keys lead from cell to cell; Tab passes a table's numbers in one step.
   * @param {HTMLTableSectionElement} body */
  function listenToCells(body) {
    const known = (event) => (event.target instanceof Element ? event.target.closest("td[data-facts]") : null);
    const facts = (cell) => body.cellFacts[Number(cell.dataset.facts)];
    for (const type of ["pointerover", "focusin", "click"]) {
      body.addEventListener(type, (event) => { const cell = known(event); if (cell) showNote(cell, facts(cell)); });
    }
    body.addEventListener("pointerout", (event) => hideNote(known(event) ?? undefined));
    body.addEventListener("focusout", (event) => hideNote(known(event) ?? undefined));
    body.addEventListener("keydown", (event) => {
      const cell = known(event);
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

  /** @param {HTMLElement} cell @param {string} key @returns {HTMLElement|null} */
  function neighbour(cell, key) {
    const across = { ArrowLeft: "previousElementSibling", ArrowRight: "nextElementSibling" }[key];
    const along = { ArrowUp: "previousElementSibling", ArrowDown: "nextElementSibling" }[key];
    let next = cell;
    let row = cell.parentElement;
    do {
      if (across) next = next[across];
      else if (along) { row = row?.[along]; next = row?.children[cell.cellIndex]; }
      else return null;
    } while (next && (next.dataset.facts === undefined || row.hidden));
    return next ?? null;
  }

  // --- one table -----------------------------------------------------------------------------------------------------
  /**
   * @typedef {{id: string, title: string, columns: string[], textColumns: number, rows: string[][], groups?: [string,
   *   number][], cells?: *[][]|null, notes: string[], files?: Object<string, string>, link?: string}} TableData
   */

  /** @param {TableData} table @param {number} column @returns {number[]} Rows from least to most; dashes at the end. */
  function ordered(table, column, descending) {
    const collator = new Intl.Collator("en", { numeric: true });
    const key = table.rows.map((row) => {
      if (row[column] === UNDEFINED || row[column] === "") return null;
      if (column < table.textColumns) return row[column];
      return numberIn(row[column]) ?? row[column];
    });
    const sign = descending ? -1 : 1;
    const compare = (a, b) => (typeof a === "number" && typeof b === "number"
      ? (a === b ? 0 : a < b ? -1 : 1) : collator.compare(String(a), String(b)));
    return table.rows.map((_, index) => index).sort((a, b) => {
      if (key[a] === null || key[b] === null) return (key[a] === null) - (key[b] === null) || a - b;
      return sign * compare(key[a], key[b]) || a - b;
    });
  }

  /** @param {TableData} table @param {string[]} row @param {number} column @returns {Node|string} */
  function cellContent(table, row, column) {
    const text = row[column];
    if (!["planner", "failed by", "scenes of"].includes(table.columns[column]) && column !== 0) return text;
    const name = MARKS.reduce((rest, mark) => rest.replace(` ${mark}`, ""), text);
    if (!window.CHALLENGER.models.some((model) => model.name === name)) return text;
    return element("a", { href: address(["model", name]), "data-testid": table.link }, text);
  }

  /** @param {TableData} table @returns {Set<number>} Columns that begin a group. */
  function groupEdges(table) {
    let column = 0;
    return new Set((table.groups ?? []).map(([, span]) => (column += span) - span).filter((first) => first > 0));
  }

  /** @param {TableData} table @returns {HTMLTableSectionElement} Rows in their first order. */
  function tableBody(table) {
    const body = element("tbody");
    body.cellFacts = [];
    const edges = groupEdges(table);
    let first = true;
    for (const [index, row] of table.rows.entries()) {
      body.append(element("tr", {}, row.map((text, column) => {
        const facts = table.cells?.[index]?.[column];
        const long = text.length > LONG;
        const kind = [column < table.textColumns ? "text" : text === UNDEFINED ? "undefined" : "",
          edges.has(column) ? "edge" : "", long ? "long" : ""].filter(Boolean).join(" ") || null;
        if (column === 0) return element("th", { scope: "row", class: long ? "long" : null }, cellContent(table, row, column));
        if (!facts) return element("td", { class: kind }, cellContent(table, row, column));
        body.cellFacts.push(facts);
        const cell = element("td", { class: kind, "data-facts": body.cellFacts.length - 1, tabindex: first ? 0 : -1 },
          text);
        first = false;
        return cell;
      })));
    }
    listenToCells(body);
    return body;
  }

  /**
   * A table with its title, files and notes.
   * @param {TableData} table
   * @param {{notes?: string[], sort?: string|null, sorted?: (value: string|null) => void}} [state] Notes to show, if
   *   not all; order as `column.asc` or `column.desc`.
   * @returns {{node: HTMLElement, filter: (matches: (text: string) => boolean, fits?: (row: string[]) => boolean) =>
   *   number}}
   */
  function tableView(table, { notes = table.notes, sort = null, sorted = () => {} } = {}) {
    const body = tableBody(table);
    const rows = [...body.rows];
    const edges = groupEdges(table);
    const heads = table.columns.map((name, column) => element("th", {
      scope: "col", "aria-sort": "none",
      class: [column < table.textColumns ? "text" : "", edges.has(column) ? "edge" : "", name.length > SHORT ? "long" : ""]
        .filter(Boolean).join(" ") || null,
    }, element("button", { type: "button", onclick: () => turn(column) }, name)));

    /** @param {string|null} order */
    function arrange(order) {
      const [column, direction] = order ? order.split(".") : [];
      const at = /^\d+$/.test(column ?? "") && Number(column) < heads.length ? Number(column) : null;
      const descending = direction === "desc";
      heads.forEach((head, index) => head.setAttribute("aria-sort",
        index !== at ? "none" : descending ? "descending" : "ascending"));
      const places = at === null ? rows.map((_, index) => index) : ordered(table, at, descending);
      body.append(...places.map((index) => rows[index]));
    }

    /** First click: up; second: down; third: as it came. @param {number} column */
    function turn(column) {
      const state = heads[column].getAttribute("aria-sort");
      const next = state === "none" ? `${column}.asc` : state === "ascending" ? `${column}.desc` : null;
      arrange(next);
      sorted(next);
    }

    if (sort) arrange(sort);
    const groups = (table.groups ?? []).some(([label]) => label)
      ? element("tr", { class: "groups" }, table.groups.map(([label, span]) =>
        element(label ? "th" : "td", { colspan: span, scope: label ? "colgroup" : null, class: "edge" }, label)))
      : null;
    const nothing = element("p", { class: "quiet", hidden: true }, "No row matches the filter.");
    const files = Object.entries(table.files ?? {}).sort();
    const name = `title-${table.id}`;
    const node = element("section", { class: "table-section", id: `section-${table.id}` },
      element("div", { class: "table-head" },
        element("h3", { id: name }, table.title),
        files.length ? element("span", { class: "files" }, files.map(([kind, path]) =>
          element("a", { href: path, download: "", "aria-label": `${kind.toUpperCase()} of: ${table.title}` },
            { csv: "CSV", tex: "TeX", json: "JSON" }[kind] ?? kind))) : null),
      element("div", { class: "table-box", tabindex: "0", role: "region", "aria-labelledby": name },
        element("table", { "data-testid": `table-${table.id}`, "aria-labelledby": name },
          element("thead", {}, groups, element("tr", {}, heads)), body)),
      nothing,
      notes.length ? element("ul", { class: "notes" }, notes.map((sentence) => element("li", {}, sentence))) : null);

    const texts = table.rows.map((row) => row.join(" ").toLowerCase());
    return {
      node,
      filter(matches, fits = () => true) {
        const kept = rows.filter((row, index) => {
          row.hidden = !(matches(texts[index]) && fits(table.rows[index]));
          return !row.hidden;
        }).length;
        nothing.hidden = kept > 0;
        return kept;
      },
    };
  }

  // --- all tables -----------------------------------------------------------------------------------------------------
  pages.tables = (here) => {
    const { tables, figures } = window.CHALLENGER;
    const names = unique(tables.map((table) => table.data).filter(Boolean));
    const data = here.params.get("data") ?? names[0] ?? "";
    if (names.length && !names.includes(data)) throw new AddressError(`There is no data set called “${data}”.`);
    const mine = tables.filter((table) => table.data === data || table.data === "");
    const pictures = figures.filter((figure) => figure.data === data);
    const groups = [...unique(mine.map((table) => table.group)), ...(pictures.length ? [FIGURES] : [])];
    const sort = /^(\d+\.(?:asc|desc))\.(.*)$/s.exec(here.params.get("sort") ?? "");
    const asked = here.params.get("group");
    const sorted = mine.find((table) => table.id === sort?.[2]);
    const group = asked && asked !== ONCE ? asked : sorted?.group ?? groups[0];
    if (!groups.includes(group)) throw new AddressError(`There are no tables called “${group}” of ${data}.`);
    const sliced = slicesOf(mine.filter((table) => table.group === group), group, here);
    const shown = sliced.tables;
    const said = new Set();
    const views = shown.map((table) => {
      const notes = table.notes.filter((sentence) => !said.has(sentence));
      notes.forEach((sentence) => said.add(sentence));
      return tableView(table, {
        notes,
        sort: sort?.[2] === table.id ? sort[1] : null,
        sorted: (order) => remember(here, { sort: order ? `${order}.${table.id}` : null }),
      });
    });
    const filter = (text) => {
      const matches = matcher(text);
      views.forEach((view) => view.filter(matches, sliced.fits));
    };
    filter(here.params.get("q") ?? "");
    return {
      title: "Tables",
      nodes: [
        element("h1", {}, "Tables"),
        element("p", { class: "lead" }, "Every number stands under the protocol that judged it; two protocols never ",
          "share a column. Point at a number, tap it or go to it with the arrow keys: it says its sample count, 95 % ",
          "interval and record."),
        element("div", { class: "toolbar" },
          names.length > 1 ? choice({ label: "Data set", value: data, choices: names, testid: "filter-data",
            change: (value) => { location.hash = address(["tables"], { data: value }); } }) : null,
          ...sliced.choices,
          filterField({ label: "Rows with", value: here.params.get("q") ?? "", change: (text) => {
            remember(here, { q: text });
            filter(text);
          } })),
        element("div", { class: "tabs", role: "navigation", "aria-label": "Groups of tables" }, groups.map((each) =>
          element("a", {
            href: address(["tables"], { data: names.length > 1 ? data : null, group: each, q: here.params.get("q") }),
            "aria-current": each === group ? "true" : null,
          }, each))),
        contents(shown),
        views.map((view) => view.node),
        group === FIGURES ? element("section", { class: "figures" }, pictures.map(figureView)) : null,
      ].flat().filter((node) => node !== null),
      destroy: () => hideNote(),
    };
  };

  /** What is chosen among the tables of a group: of slices one kind, and all of its slices or one.
   * @param {TableData[]} tables @param {string} group @param {*} here
   * @returns {{tables: TableData[], fits: (row: string[]) => boolean, choices: HTMLElement[]}} */
  function slicesOf(tables, group, here) {
    if (group !== SLICES) return { tables, fits: () => true, choices: [] };
    const kinds = unique(tables.map((table) => table.columns[KIND]));
    const by = here.params.get("by") ?? kinds[0];
    if (!kinds.includes(by)) throw new AddressError(`There are no tables by “${by}”.`);
    const shown = tables.filter((table) => table.columns[KIND] === by);
    const names = unique(shown.flatMap((table) => table.rows.map((row) => row[KIND])));
    const only = here.params.get("slice") ?? EVERY;
    if (only !== EVERY && !names.includes(only)) throw new AddressError(`There is no ${by} called “${only}”.`);
    const go = (changes) => { remember(here, changes); show(); };
    return {
      tables: shown,
      fits: (row) => only === EVERY || row[KIND] === only,
      choices: [
        choice({ label: "By", value: by, choices: kinds, testid: "filter-by",
          change: (value) => go({ by: value, slice: null, sort: null }) }),
        choice({ label: by.charAt(0).toUpperCase() + by.slice(1), value: only, choices: [EVERY, ...names], testid: "filter-slice",
          change: (value) => go({ slice: value === EVERY ? null : value }) }),
      ],
    };
  }

  /** @param {TableData[]} shown @returns {HTMLElement|null} Titles that lead to their tables. */
  function contents(shown) {
    if (shown.length < 4) return null;
    const jump = (id, text) => element("li", {}, element("button", { type: "button", class: "link", onclick: () => {
      const section = document.getElementById(`section-${id}`);
      section?.scrollIntoView();
      section?.querySelector("[tabindex]")?.focus({ preventScroll: true });
    } }, text));
    return element("details", { class: "contents" }, element("summary", {}, `${shown.length} tables on this page`),
      element("ol", {}, shown.map((table) => jump(table.id, table.title))));
  }

  /** @param {{title: string, path: string, dark: string, size: [number, number]}} figure @returns {HTMLElement} */
  function figureView({ title, path, dark, size: [width, height] }) {
    const shown = picture({ light: path, dark, alt: title, width: width || null, height: height || null });
    // Letters are as large as they were meant where the figure is as wide as it was drawn; narrower pages scroll it.
    if (width) shown.style.minWidth = `${Math.round(LEAST_SIZE * width)}px`;
    return element("figure", { class: "figure" },
      element("div", { class: "figure-box", tabindex: "0", role: "region", "aria-label": title },
        element("a", { href: path }, shown)),
      element("figcaption", {}, title));
  }

  Object.assign(site, { figureView, hideNote, tableView });
})();
