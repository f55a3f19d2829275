"use strict";
/* What the search tried. */
(() => {
  const site = window.ChallengerSite;
  const { UNDEFINED, address, choice, counted, element, filterField, matcher, pages, remember, requireKnown, unique } = site;

  const KEPT = "kept";

  pages.attempts = (here) => {
    const { attempts } = window.CHALLENGER;
    const reasonOf = (attempt) => attempt.reason ?? (attempt.scene ? KEPT : "not said");
    const list = element("div");
    const count = element("p", { class: "count", "data-testid": "attempt-count", "aria-live": "polite" });
    const of = (name) => unique(attempts.map((attempt) => attempt[name]).filter(Boolean));
    const reasons = unique(attempts.map(reasonOf)).sort();
    const tally = reasons.map((reason) => [reason, attempts.filter((each) => reasonOf(each) === reason).length])
      .sort((a, b) => b[1] - a[1]);
    const most = Math.max(1, ...tally.map(([, number]) => number));
    const refresh = (changes) => {
      remember(here, changes);
      const wanted = (name) => here.params.get(name) ?? "";
      const matches = matcher(wanted("q"));
      const found = attempts.filter((attempt) => (!wanted("reason") || reasonOf(attempt) === wanted("reason"))
        && (!wanted("data") || attempt.data === wanted("data")) && (!wanted("split") || attempt.split === wanted("split"))
        && matches(Object.values(attempt).join(" ").toLowerCase()));
      count.textContent = found.length === attempts.length ? counted(attempts.length, "attempt")
        : `${found.length} of ${counted(attempts.length, "attempt")}`;
      list.replaceChildren(attemptTable(found, reasonOf));
    };
    const filter = (label, name, values) => choice({ label, value: here.params.get(name) ?? "", testid: `filter-${name}`,
      choices: [["", "all"], ...values], change: (value) => refresh({ [name]: value }) });
    requireKnown(here, { data: of("data"), split: of("split"), reason: reasons });
    if (attempts.length) refresh({});
    const lead = "A vehicle is tried as the adversary, and kept only if the scene is physically sound, solvable and "
      + "hard enough. This is what became of each.";
    if (!attempts.length) {
      return { title: "Attempts", nodes: [element("h1", {}, "What the search tried"), element("p", { class: "lead" }, lead),
        element("p", { class: "remark" }, "Nothing is known of a search: the sheets of generated splits say it (",
          element("code", {}, "challenger-bench sheets --split adv"), "), then write the leaderboard again.")] };
    }
    return {
      title: "Attempts",
      nodes: [
        element("h1", {}, "What the search tried"), element("p", { class: "lead" }, lead),
        element("dl", { class: "tally" }, tally.map(([reason, number]) => {
          const bar = element("span", { class: reason === KEPT ? "bar kept" : "bar" });
          bar.style.width = `${(100 * number) / most}%`;
          return [element("dt", {}, element("a", { href: address(["attempts"], { reason }) }, reason)),
            element("dd", {}, bar, element("span", {}, String(number)))];
        })),
        element("div", { class: "toolbar" },
          filterField({ label: "Attempts with", value: here.params.get("q") ?? "", change: (q) => refresh({ q }) }),
          of("data").length > 1 ? filter("Data set", "data", of("data")) : null,
          of("split").length > 1 ? filter("Split", "split", of("split")) : null,
          filter("Outcome", "reason", reasons)),
        count, list,
      ],
    };
  };

  /** @param {*[]} found @param {(attempt: *) => string} reasonOf @returns {HTMLElement} */
  function attemptTable(found, reasonOf) {
    const most = 400;
    const known = new Set(window.CHALLENGER.scenes.map((scene) => scene.key));
    const view = site.tableView({
      id: "attempts", title: "Attempts", textColumns: 6,
      columns: ["recording", "vehicle", "split", "outcome", "manoeuvre", "scene"],
      rows: found.slice(0, most).map((attempt) => [attempt.source, attempt.agent, attempt.split, reasonOf(attempt),
        attempt.manoeuvre ?? UNDEFINED, attempt.scene ?? UNDEFINED]),
      notes: found.length > most ? [`The first ${most} of ${found.length}; filter to see others.`] : [],
    });
    for (const [index, row] of [...view.node.querySelectorAll("tbody tr")].entries()) {
      const { key, scene } = found[index];
      if (scene && known.has(key)) row.lastChild.replaceChildren(element("a", { href: address(["scene", key]) }, scene));
    }
    return view.node;
  }
})();
