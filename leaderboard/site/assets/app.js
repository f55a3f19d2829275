"use strict";
/* What all pages share: elements, addresses, theme, and which page an address means. */
(() => {
  /** @typedef {{parts: string[], params: URLSearchParams}} Route */
  /** @typedef {{title: string, nodes: (Node|string)[], ready?: () => void, destroy?: () => void}} Page */

  const UNDEFINED = "–";
  const SVG = "http://www.w3.org/2000/svg";

  /** An address that means nothing here; its message is shown. */
  class AddressError extends Error {}

  /**
   * Gives a node attributes and children; text from records only ever becomes text.
   * @template {Element} T
   * @param {T} node
   * @param {Object<string, *>} attributes `on...` are listeners; null, undefined and false are left out.
   * @param {*[]} children Nodes, texts, nested lists; null, undefined and false are left out.
   * @returns {T}
   */
  function fill(node, attributes, children) {
    for (const [name, value] of Object.entries(attributes)) {
      if (value === null || value === undefined || value === false) continue;
      if (typeof value === "function") node.addEventListener(name.slice(2), value);
      else node.setAttribute(name, value === true ? "" : String(value));
    }
    const kept = children.flat(Infinity).filter((child) => child !== null && child !== undefined && child !== false);
    node.append(...kept.map((child) => (child instanceof Node ? child : String(child))));
    return node;
  }

  /** @param {string} tag @param {Object<string, *>} [attributes] @param {...*} children @returns {HTMLElement} */
  const element = (tag, attributes = {}, ...children) => fill(document.createElement(tag), attributes, children);

  /** @param {string} tag @param {Object<string, *>} [attributes] @param {...*} children @returns {SVGElement} */
  const drawn = (tag, attributes = {}, ...children) => fill(document.createElementNS(SVG, tag), attributes, children);

  /** @param {number} number @param {string} noun @returns {string} */
  const counted = (number, noun) => `${number} ${noun}${number === 1 ? "" : "s"}`;

  /** A member that is the object's own: names come from strangers, and one may be called "constructor".
   * @param {Object<string, *>} object @param {string} name @returns {*} */
  const own = (object, name) => (Object.hasOwn(object, name) ? object[name] : undefined);

  /** @param {number|null|undefined} value Fraction. @param {number} [digits] @returns {string} Percentage without sign. */
  const percent = (value, digits = 2) =>
    value === null || value === undefined ? UNDEFINED : (100 * value).toFixed(digits);

  /** @param {string[]} parts @param {Object<string, *>|URLSearchParams} [params] @returns {string} Address in this site. */
  function address(parts, params = {}) {
    const pairs = params instanceof URLSearchParams ? [...params] : Object.entries(params).flatMap(([name, value]) =>
      (Array.isArray(value) ? value : [value]).map((each) => [name, each]));
    const query = pairs
      .filter(([, value]) => value !== null && value !== undefined && value !== "")
      .map(([name, value]) => `${encodeURIComponent(name)}=${encodeURIComponent(value)}`)
      .join("&");
    return `#/${parts.map(encodeURIComponent).join("/")}${query ? `?${query}` : ""}`;
  }

  /** @param {string} hash @returns {Route} */
  function route(hash) {
    const text = hash.replace(/^#\/?/, "");
    const cut = text.indexOf("?");
    const path = cut < 0 ? text : text.slice(0, cut);
    let parts;
    try {
      parts = path.split("/").filter(Boolean).map(decodeURIComponent);
    } catch {
      throw new AddressError("This address is damaged: it has a % that stands for nothing.");
    }
    return { parts, params: new URLSearchParams(cut < 0 ? "" : text.slice(cut + 1)) };
  }

  /** Writes the state of a page into the address, so that the address leads back to it.
   * @param {Route} here @param {Object<string, string|string[]|number|null|undefined>} changes */
  function remember(here, changes) {
    for (const [name, value] of Object.entries(changes)) {
      here.params.delete(name);
      for (const each of Array.isArray(value) ? value : [value]) {
        if (each !== null && each !== undefined && each !== "") here.params.append(name, String(each));
      }
    }
    history.replaceState(null, "", address(here.parts, here.params));
  }

  /**
   * A list to choose from.
   * @param {{label: string, value: string, choices: (string|[string, string])[], testid?: string,
   *   change: (value: string) => void}} of Choices are values, or values with what is shown.
   * @returns {HTMLElement}
   */
  function choice({ label, value, choices, testid, change }) {
    const pairs = choices.map((each) => (Array.isArray(each) ? each : [each, each]));
    const options = pairs.map(([name, shown]) => element("option", { value: name, selected: name === value }, shown));
    const select = element("select", { "data-testid": testid, onchange: () => change(select.value) }, options);
    return element("label", { class: "field" }, element("span", {}, label), select);
  }

  /** A field to filter by; `/` leads to it.
   * @param {{label: string, value: string, change: (value: string) => void}} of @returns {HTMLElement} */
  function filterField({ label, value, change }) {
    const input = element("input", {
      type: "search", value, autocomplete: "off", spellcheck: "false", "data-testid": "filter-text",
      placeholder: "press / to filter", oninput: () => change(input.value),
    });
    return element("label", { class: "field grow" }, element("span", {}, label), input);
  }

  /** @param {string} text @returns {(haystack: string) => boolean} Whether all words of the text occur. */
  function matcher(text) {
    const words = text.toLowerCase().split(/\s+/).filter(Boolean);
    return (haystack) => words.every((word) => haystack.includes(word));
  }

  /** @param {Iterable<string>} values @returns {string[]} Each once, in the order of first sight. */
  const unique = (values) => [...new Set(values)];

  const MINIATURE_NOTE = "§ miniature: shows the pipeline, ranks nothing.";

  /** @param {*} model @returns {string} Its name with its marks: privileged, miniature. */
  const marked = (model) => [model.name, model.privileged ? "†" : null, model.miniature ? "§" : null]
    .filter(Boolean).join(" ");

  /** A picture that there is for light pages and for dark ones.
   * @param {{light: string, dark?: string|null, alt: string, width?: number|null, height?: number|null}} of
   * @returns {HTMLElement} */
  function picture({ light, dark, alt, width = null, height = null }) {
    const night = dark ?? light;
    return element("img", {
      src: document.documentElement.dataset.theme === "dark" ? night : light, "data-light": light, "data-dark": night,
      alt, loading: "lazy", decoding: "async", width, height,
    });
  }

  /** @type {Object<string, (here: Route) => Page>} */
  const pages = {};
  window.ChallengerSite = {
    AddressError, MINIATURE_NOTE, UNDEFINED, address, choice, counted, drawn, element, filterField, marked, matcher, own, pages,
    percent, picture, remember, show, unique,
  };

  // --- theme -------------------------------------------------------------------------------------------------------
  const dark = matchMedia("(prefers-color-scheme: dark)");

  /** @returns {string|null} What was chosen earlier; a page from disk may have no storage. */
  function storedTheme() {
    try {
      const found = localStorage.getItem("challenger-theme");
      return found === "light" || found === "dark" ? found : null;
    } catch {
      return null;
    }
  }

  /** @param {string} theme */
  function showTheme(theme) {
    document.documentElement.dataset.theme = theme;
    for (const image of document.querySelectorAll("img[data-dark]")) image.src = image.dataset[theme];
    const button = document.querySelector("[data-testid=theme-toggle]");
    if (!button) return;
    const other = theme === "dark" ? "light" : "dark";
    button.textContent = theme === "dark" ? "☾ dark" : "☀ light";
    button.setAttribute("aria-label", `Theme is ${theme}; switch to ${other}`);
  }

  function switchTheme() {
    const theme = document.documentElement.dataset.theme === "dark" ? "light" : "dark";
    try {
      localStorage.setItem("challenger-theme", theme);
    } catch {
      // The choice then lasts as long as the page.
    }
    showTheme(theme);
  }

  showTheme(storedTheme() ?? (dark.matches ? "dark" : "light"));
  dark.addEventListener("change", () => storedTheme() ?? showTheme(dark.matches ? "dark" : "light"));

  // --- which page ----------------------------------------------------------------------------------------------------
  /** @type {Page|null} */
  let shown = null;
  /** @type {string|null} */
  let shownPath = null;
  let followed = false;
  const OF_TABLES = ["group", "sort", "q"];
  /** @type {Map<string, number>} */
  const scrolled = new Map();

  /** @param {string} sentence @returns {Page} */
  function errorPage(sentence) {
    return {
      title: "Not found",
      nodes: [
        element("h1", {}, "There is nothing here"),
        element("p", { "data-testid": "error", role: "alert", class: "error" }, sentence),
        element("p", {}, element("a", { href: "#/" }, "To the overview"), " · ",
          element("a", { href: "#/tables" }, "to the tables"), " · ",
          element("a", { href: "#/scenes" }, "to the scenes")),
      ],
    };
  }

  /** @returns {Page} */
  function pageOfAddress() {
    if (!window.CHALLENGER) {
      return errorPage("data/index.js is missing or damaged; write the site again with challenger-bench leaderboard.");
    }
    try {
      const here = route(location.hash);
      if (!here.parts.length && OF_TABLES.some((name) => here.params.has(name))) {
        // The tables stood at this address once.
        here.parts.push("tables");
        history.replaceState(null, "", address(here.parts, here.params));
      }
      const name = here.parts[0] ?? "start";
      const page = own(pages, name);
      if (!page) throw new AddressError(`There is no page called “${name}”.`);
      return page(here);
    } catch (error) {
      if (error instanceof AddressError) return errorPage(error.message);
      throw error;
    }
  }

  /** @param {string|undefined} name First part of the address. */
  function markPlace(name) {
    const place = { model: "models", scene: "scenes", compare: "scenes", drive: "scenes" }[name ?? ""] ?? name ?? "";
    for (const link of document.querySelectorAll("[data-testid=nav] a")) {
      if (link.getAttribute("href") === `#/${place}`) link.setAttribute("aria-current", "page");
      else link.removeAttribute("aria-current");
    }
  }

  /** Draws the page that the address means; where it is the same page, focus and place are kept. */
  function show() {
    window.CHALLENGER_READY = false;
    const main = document.getElementById("main");
    main.classList.remove("settled");
    const path = location.hash.split("?")[0];
    const same = path === shownPath;
    const held = same ? document.activeElement?.getAttribute("data-testid") : null;
    const place = same ? scrollY : followed ? 0 : scrolled.get(location.hash) ?? 0;
    shown?.destroy?.();
    shown = pageOfAddress();
    main.replaceChildren(...shown.nodes);
    shown.ready?.();
    document.title = `${shown.title} · ${window.CHALLENGER?.title ?? "challenger-bench"}`;
    markPlace(/^#\/([^/?]*)/.exec(location.hash)?.[1]);
    scrollTo(0, place);
    if (shownPath !== null) {
      const again = held ? main.querySelector(`[data-testid="${CSS.escape(held)}"]`) : null;
      (again ?? main).focus({ preventScroll: true });
    }
    followed = false;
    shownPath = path;
    requestAnimationFrame(() => setTimeout(() => {
      main.classList.add("settled");
      if (place) scrollTo(0, place);
      window.CHALLENGER_READY = true;
    }));
  }

  function start() {
    showTheme(document.documentElement.dataset.theme);
    document.querySelector("[data-testid=theme-toggle]").addEventListener("click", switchTheme);
    document.querySelector(".skip").addEventListener("click", (event) => {
      event.preventDefault();
      document.getElementById("main").focus();
    });
    document.addEventListener("click", (event) => {
      if (event.target instanceof Element && event.target.closest("a[href^='#/']")) {
        scrolled.set(location.hash, scrollY);
        followed = true;
      }
    });
    document.addEventListener("keydown", (event) => {
      const writing = event.target instanceof Element && event.target.closest("input:not([type=range]), select, textarea");
      if (event.key !== "/" || event.ctrlKey || event.metaKey || event.altKey || writing) return;
      const field = document.querySelector("[data-testid=filter-text]");
      if (!field) return;
      event.preventDefault();
      field.focus();
    });
    if (window.CHALLENGER) {
      const { models, scenes } = window.CHALLENGER;
      document.getElementById("made").textContent =
        `${counted(models.length, "planner")}, ${counted(scenes.length, "scene")}. Made from run records by challenger-bench leaderboard.`;
    }
    history.scrollRestoration = "manual";
    addEventListener("hashchange", show);
    show();
  }

  document.addEventListener("DOMContentLoaded", start);
})();
