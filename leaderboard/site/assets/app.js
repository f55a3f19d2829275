"use strict";
/* What all pages share: elements, addresses, theme, and which page an address means.
 *
 * The scripts of the site share one scope. They compute no number of a table: they show, filter, sort and play what
 * Python wrote. */

const UNDEFINED = "–";
const SVG = "http://www.w3.org/2000/svg";

/** An address that means nothing here; its message is shown. */
class AddressError extends Error {}

/** @returns {SiteIndex} */
const site = () => window.CHALLENGER;

// --- elements ----------------------------------------------------------------------------------------------------------
/** Gives a node what is there; text from records only ever becomes text. @template {Element} T @param {T} node
 * @param {Record<string, any>} attributes Functions are listeners. @param {any[]} children @returns {T} */
function fill(node, attributes, children) {
  for (const [name, value] of Object.entries(attributes)) {
    if ((value ?? false) === false) continue;
    if (typeof value === "function") node.addEventListener(name.slice(2), value);
    else node.setAttribute(name, value === true ? "" : String(value));
  }
  node.append(...children.flat(Infinity).filter((child) => (child ?? false) !== false));
  return node;
}

/** @template {keyof HTMLElementTagNameMap} K @param {K} tag @param {Record<string, any>} [attributes]
 * @param {...any} children @returns {HTMLElementTagNameMap[K]} */
const element = (tag, attributes = {}, ...children) => fill(document.createElement(tag), attributes, children);

/** @param {string} tag @param {Record<string, any>} [attributes] @param {...any} children @returns {Element} */
const drawn = (tag, attributes = {}, ...children) => fill(document.createElementNS(SVG, tag), attributes, children);

/** @param {string} name @returns {HTMLElement} The part of every page with this id. */
function part(name) {
  const found = document.getElementById(name);
  if (!found) throw new Error(`index.html has no ${name}`);
  return found;
}

/** A member that is the object's own: names come from strangers, and one may be called "constructor".
 * @template T @param {Record<string, T>|undefined} object @param {string|null|undefined} name @returns {T|undefined} */
const own = (object, name) => (object && typeof name === "string" && Object.hasOwn(object, name) ? object[name] : undefined);

/** @param {...any} names @returns {string|null} The true ones as an attribute. */
const classes = (...names) => names.filter(Boolean).join(" ") || null;

/** @template T @param {Iterable<T>} values @returns {T[]} Each once, in the order of first sight. */
const unique = (values) => [...new Set(values)];

/** @param {number} found @param {number} of @param {string} noun @returns {string} How many of a list are shown. */
const countLine = (found, of, noun) => `${found === of ? "" : `${found} of `}${of} ${noun}${of === 1 ? "" : "s"}`;

/** @param {string} text @returns {(string|Element)[]} What its abbreviations stand for is said when they are pointed at. */
function spelled(text) {
  const { abbreviations } = site();
  const known = new RegExp(`\\b(${Object.keys(abbreviations).join("|")}|docs/[\\w/.-]+\\.md)\\b`);
  return text.split(known).map((part, at) => (at % 2 === 0 ? part : own(abbreviations, part)
    ? element("abbr", { title: abbreviations[part] }, part) : element("code", {}, part)));
}

/** @param {{light: string, dark: string, alt: string, width?: number|null, height?: number|null}} of For each theme. */
const picture = ({ light, dark, ...attributes }) => element("img", {
  src: theme() === "dark" ? dark : light, "data-light": light, "data-dark": dark, loading: "lazy", decoding: "async",
  ...attributes });

// --- addresses ---------------------------------------------------------------------------------------------------------
/** @param {URLSearchParams} query @param {Record<string, any>} changes Values or lists; empty ones leave nothing. */
function changeQuery(query, changes) {
  for (const [name, value] of Object.entries(changes)) {
    query.delete(name);
    for (const each of [value].flat()) if ((each ?? "") !== "") query.append(name, String(each));
  }
  return query;
}

/** @param {string[]} parts @param {Record<string, any>} [params] @returns {string} Address in this site. */
function address(parts, params = {}) {
  const query = String(params instanceof URLSearchParams ? params : changeQuery(new URLSearchParams(), params));
  return `#/${parts.map(encodeURIComponent).join("/")}${query && `?${query}`}`;
}

/** @param {string} hash @returns {Route} */
function route(hash) {
  const [path, ...query] = hash.replace(/^#\/?/, "").split("?");
  try {
    const parts = path.split("/").filter(Boolean).map(decodeURIComponent);
    return { parts, params: new URLSearchParams(query.join("?")) };
  } catch {
    throw new AddressError("This address is damaged: it has a % that stands for nothing.");
  }
}

/** Writes the state of a page into its address. @param {Route} here @param {Record<string, any>} changes */
function remember(here, changes) {
  history.replaceState(null, "", address(here.parts, changeQuery(here.params, changes)));
}

/** What an address asks for, or the first that there is; what is not there is refused.
 * @param {Route} here @param {string} name @param {string[]} values @returns {string} */
function asked(here, name, values) {
  const value = here.params.get(name);
  if (value && !values.includes(value)) throw new AddressError(`Nothing here has ${name} “${value}”.`);
  return value || (values[0] ?? "");
}

// --- controls ----------------------------------------------------------------------------------------------------------
/** @param {Choices} choices @param {string} value @param {(value: string) => void} change @param {any} attributes */
function selectOf(choices, value, change, attributes) {
  const options = choices.map((each) => [each].flat()).map(([name, shown = name]) =>
    element("option", { value: name, selected: name === value }, shown));
  const select = element("select", { ...attributes, onchange: () => change(select.value) }, options);
  return select;
}

/** @param {string} label @param {HTMLElement} control @param {string} [kind] */
const field = (label, control, kind = "field") =>
  element("label", { class: kind }, element("span", {}, label), control);

/** A list whose choice stands in the address. @param {Route} here @param {string} label @param {string} name
 * @param {Choices} choices @param {() => void} again Shows what is chosen. */
const placedChoice = (here, label, name, choices, again) => field(label, selectOf(choices, here.params.get(name) ?? "",
  (value) => { remember(here, { [name]: value }); again(); }, { "data-testid": `filter-${name}` }));

/** A list that shows the page again with what is chosen; nothing where there is no choice.
 * @param {Route} here @param {string} label @param {string} name @param {string[]} values */
const pageChoice = (here, label, name, values) =>
  (values.length < 2 ? null : placedChoice(here, label, name, values, show));

/** `/` leads to it. @param {Route} here @param {string} label @param {(text: string) => void} change */
function filterField(here, label, change) {
  const input = element("input", {
    type: "search", value: here.params.get("q") ?? "", autocomplete: "off", spellcheck: "false",
    "data-testid": "filter-text", placeholder: "press / to filter",
    oninput: () => { remember(here, { q: input.value }); change(input.value); },
  });
  return field(label, input, "field grow");
}

/** @param {string|null} text @returns {(haystack: string) => boolean} Whether all words of the text occur. */
function matcher(text) {
  const words = (text ?? "").toLowerCase().split(/\s+/).filter(Boolean);
  return (haystack) => words.every((word) => haystack.includes(word));
}

// --- theme -------------------------------------------------------------------------------------------------------------
const DARK = matchMedia("(prefers-color-scheme: dark)");

/** @returns {"light"|"dark"} */
const theme = () => (document.documentElement.dataset.theme === "dark" ? "dark" : "light");

/** @param {string} [name] To keep. @returns {string|null} What was kept; a page from disk may have no storage. */
function keptTheme(name) {
  try {
    if (name) localStorage.setItem("challenger-theme", name);
    return localStorage.getItem("challenger-theme");
  } catch {
    return null;
  }
}

function showTheme(name = keptTheme() ?? (DARK.matches ? "dark" : "light")) {
  document.documentElement.dataset.theme = name;
  for (const image of document.querySelectorAll("img")) if (image.dataset.dark) image.src = image.dataset[name] ?? "";
  document.dispatchEvent(new Event("theme"));
  const button = document.querySelector("[data-testid=theme-toggle]");
  if (!button) return;
  button.textContent = name === "dark" ? "☾ dark" : "☀ light";
  button.setAttribute("aria-label", `Theme is ${name}; switch to ${name === "dark" ? "light" : "dark"}`);
}

function switchTheme() {
  const name = theme() === "dark" ? "light" : "dark";
  keptTheme(name);
  showTheme(name);
}

showTheme();
DARK.addEventListener("change", () => keptTheme() ?? showTheme());

// --- which page --------------------------------------------------------------------------------------------------------
/** @type {Record<string, PageMaker>} By the first part of the address. */
const pages = {};
/** Tabs of pages that are none themselves. */
const TAB_OF = { "": "results", model: "planners", scene: "scenes", compare: "scenes", drive: "scenes" };
/** Pages of earlier sites. */
const MOVED = { tables: "results", models: "planners", attempts: "generation" };
let shownPage = /** @type {Page|null} */ (null);
let shownPath = /** @type {string|null} */ (null);
let followed = false;
const scrolled = /** @type {Map<string, number>} */ (new Map());

/** @param {string} sentence */
const errorLine = (sentence) => element("p", { "data-testid": "error", role: "alert", class: "error" }, sentence);

/** @param {string} sentence @returns {Page} */
const errorPage = (sentence) => ({
  title: "Not found",
  nodes: [element("h1", {}, "There is nothing here"), errorLine(sentence),
    element("p", {}, element("a", { href: "#/" }, "To the results"))],
});

/** @param {Route} here @returns {Route} Where an address of an earlier site leads now. */
function moved(here) {
  const { parts: [name], params } = here;
  const instead = own(MOVED, name);
  if (!instead) return here;
  const { tables, tabs } = site();
  const sorted = tables.find((table) => params.get("sort")?.endsWith(`.${table.id}`));
  const group = params.get("group") ?? sorted?.group ?? "";
  const protocol = /^protocol (.+)$/s.exec(group)?.[1];
  if (protocol || !tables.some((table) => table.group === group)) params.delete("group");
  const parts = [own(tabs, group) ?? instead];
  history.replaceState(null, "", address(parts, changeQuery(params, protocol ? { protocol } : {})));
  return { parts, params };
}

/** @returns {Page} */
function pageOfAddress() {
  if (!window.CHALLENGER) {
    return errorPage("data/index.js is missing or damaged; write the site again with challenger-bench leaderboard.");
  }
  try {
    const here = moved(route(location.hash));
    const name = here.parts[0] ?? "results";
    const page = own(pages, name);
    if (!page) throw new AddressError(`There is no page called “${name}”.`);
    return page(here);
  } catch (error) {
    if (error instanceof AddressError) return errorPage(error.message);
    throw error;
  }
}

/** Draws the page that the address means; where it is the same page, focus and place are kept. */
function show() {
  window.CHALLENGER_READY = false;
  const main = part("main");
  main.classList.remove("settled");
  const path = location.hash.split("?")[0];
  const jump = followed;
  const same = path === shownPath;
  const held = same && document.activeElement?.getAttribute("data-testid");
  const place = same && !followed ? scrollY : followed ? 0 : scrolled.get(location.hash) ?? 0;
  shownPage?.destroy?.();
  hideNote();
  shownPage = pageOfAddress();
  const name = /^#\/([^/?]*)/.exec(location.hash)?.[1] ?? "";
  const tab = own(TAB_OF, name) ?? name;
  const more = window.CHALLENGER ? site().pages.filter((page) => page.tab === tab) : [];
  main.replaceChildren(...shownPage.nodes.filter((node) => node !== null), more.length ? element("p", { class: "more" },
    "Pages of extensions: ", more.map((page, at) => [at ? ", " : "", element("a", { href: page.path }, page.name)])) : "");
  shownPage.ready?.();
  document.title = `${shownPage.title} · ${window.CHALLENGER?.title ?? "challenger-bench"}`;
  for (const link of document.querySelectorAll("[data-testid=nav] a")) {
    link.ariaCurrent = link.getAttribute("href") === `#/${tab === "results" ? "" : tab}` ? "page" : null;
  }
  const { target } = shownPage;
  const settle = () => (target && !place && (jump || !same) ? target.scrollIntoView() : scrollTo(0, place));
  settle();
  if (shownPath !== null) {
    const again = held ? main.querySelector(`[data-testid="${CSS.escape(held)}"]`) : null;
    (again instanceof HTMLElement ? again : main).focus({ preventScroll: true });
  }
  followed = false;
  shownPath = location.hash.split("?")[0];
  requestAnimationFrame(() => setTimeout(() => {
    main.classList.add("settled");
    if (place || target) settle();
    window.CHALLENGER_READY = true;
  }));
}

document.addEventListener("DOMContentLoaded", () => {
  showTheme(theme());
  document.querySelector("[data-testid=theme-toggle]")?.addEventListener("click", switchTheme);
  document.querySelector(".skip")?.addEventListener("click", (event) => {
    event.preventDefault();
    part("main").focus();
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
    if (!(field instanceof HTMLElement)) return;
    event.preventDefault();
    field.focus();
  });
  history.scrollRestoration = "manual";
  addEventListener("hashchange", show);
  show();
});
