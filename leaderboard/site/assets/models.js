"use strict";
/* The pages of planners. */
(() => {
  const site = window.ChallengerSite;
  const { AddressError, MINIATURE_NOTE, UNDEFINED, address, choice, drawn, element, filterField, marked } = site;
  const { counted, matcher, own, pages, percent } = site;
  const { hideNote, remember, show, tableView, unique } = site;

  const HORIZONS = ["1s", "2s", "3s"];
  const SUB_SCORES = ["nc", "dac", "ddc", "ep", "ttc", "lk", "hc", "ec"];
  /** Colours that colour-blind readers tell apart (Okabe and Ito), always with a shape. */
  const SERIES = ["var(--blue)", "var(--purple)", "var(--gold)", "var(--text)", "var(--sky)", "var(--brown)"];

  /** @param {*} rate @returns {string} */
  const rateText = (rate) => (rate ? percent(rate.value) : UNDEFINED);

  /** @param {*} rate @returns {string} */
  const intervalText = (rate) => (!rate || rate.low === null || rate.low === rate.high ? UNDEFINED
    : `[${percent(rate.low, 1)}, ${percent(rate.high, 1)}]`);

  /** @param {*} rate @param {number} scale @param {string[]} origin See `originOf`. @returns {Cell|null} */
  function rateCell(rate, scale, origin) {
    if (!rate || rate.value === null) return null;
    const shown = (value) => Number((scale * value).toPrecision(4));
    return { n: rate.n, ...(rate.low === null ? {} : { low: shown(rate.low), high: shown(rate.high) }), origin };
  }

  const recordName = (model, run) => `${run.record} ${model.name} on ${run.split}`;

  pages.models = (here) => {
    const { models, protocols } = window.CHALLENGER;
    const names = unique(models.flatMap((model) => model.runs.map((run) => run.data)));
    const data = here.params.get("data") ?? names[0] ?? "";
    const protocol = here.params.get("protocol") ?? protocols[0] ?? "exact";
    if (models.length && !names.includes(data)) throw new AddressError(`There is no data set called “${data}”.`);
    if (protocols.length && !protocols.includes(protocol)) throw new AddressError(`There is no protocol “${protocol}”.`);
    const mine = models.filter((model) => model.runs.some((run) => run.data === data));
    const splits = unique(mine.flatMap((model) => model.runs.filter((run) => run.data === data).map((run) => run.split)));
    const order = ["val", "val-r", "adv"];
    splits.sort((a, b) => (order.indexOf(a) + 4) % 4 - (order.indexOf(b) + 4) % 4 || (a < b ? -1 : 1));
    const rows = mine.map((model) => splits.map((split) => model.runs.find((run) => run.data === data
      && run.split === split)));
    const average = (run) => (run ? own(run.protocols, protocol)?.collision?.avg : undefined);
    const view = tableView({
      id: "models", link: "model-link", textColumns: 2, notes: [
        "Average of the collision rates at 1, 2 and 3 s, per cent.",
        ...(mine.some((model) => model.privileged)
          ? ["† privileged: sees boxes, the map or the recorded future; a reference row."] : []),
        ...(mine.some((model) => model.miniature) ? [MINIATURE_NOTE] : []),
        ...mine.flatMap((model) => model.runs.filter((run) => run.data === data && run.plansFrom)
          .map((run) => run.plansFrom)),
      ],
      title: `${data}: collision rate (%), protocol ${protocol}`,
      columns: ["planner", "own protocol", ...splits.flatMap((split) => [split, "95 %"]), "failed samples"],
      groups: [["", 2], [`protocol ${protocol}`, 2 * splits.length], ["", 1]],
      rows: mine.map((model, index) => [marked(model), model.nativeProtocol ?? UNDEFINED,
        ...rows[index].flatMap((run) => [rateText(average(run)), intervalText(average(run))]),
        String(rows[index].reduce((sum, run) => sum + (run?.failed ?? 0), 0))]),
      cells: mine.map((model, index) => [null, null, ...rows[index].flatMap((run) => {
        const cell = run ? rateCell(average(run), 100, ["%", "samples", protocol, recordName(model, run)]) : null;
        return [cell, null];
      }), null]),
    }, { sort: here.params.get("sort"), sorted: (order) => remember(here, { sort: order }) });
    const filter = (text) => view.filter(matcher(text));
    filter(here.params.get("q") ?? "");
    const go = (changes) => { remember(here, changes); show(); };
    return {
      title: "Planners",
      nodes: [
        element("h1", {}, "Planners"),
        element("div", { class: "toolbar" },
          names.length > 1 ? choice({ label: "Data set", value: data, choices: names, testid: "filter-data",
            change: (value) => go({ data: value }) }) : null,
          choice({ label: "Protocol", value: protocol, choices: protocols, testid: "filter-protocol",
            change: (value) => go({ protocol: value }) }),
          filterField({ label: "Rows with", value: here.params.get("q") ?? "", change: (text) => {
            remember(here, { q: text });
            filter(text);
          } })),
        models.length ? view.node : element("p", {}, "There are no run records."),
      ],
      destroy: () => hideNote(),
    };
  };

  pages.model = (here) => {
    const { models, protocols } = window.CHALLENGER;
    const model = models.find((each) => each.name === here.parts[1]);
    if (!model) throw new AddressError(`There is no planner called “${here.parts[1] ?? ""}”.`);
    const fallback = protocols.includes("exact") ? "exact" : protocols[0];
    const protocol = here.params.get("protocol") ?? fallback;
    if (!protocols.includes(protocol)) throw new AddressError(`There is no protocol “${protocol}”.`);
    const names = unique(model.runs.map((run) => run.data));
    const all = element("a", { href: address(["scenes"], { fails: model.name }) }, "All scenes that it fails");
    return {
      title: model.name,
      nodes: [
        element("h1", {}, model.name),
        model.miniature ? element("p", { class: "remark" }, "A miniature, trained on the embedded town: it shows the "
          + "pipeline, ranks nothing.") : null,
        element("p", { class: "lead" }, model.privileged
          ? "A reference: it is privileged (sees boxes, the map or the recorded future). " : null,
          model.nativeProtocol ? `Protocol of its own repository: ${model.nativeProtocol}.`
            : "It has no repository of its own, so that its own protocol is exact."),
        element("div", { class: "toolbar" }, choice({ label: "Protocol", value: protocol, choices: protocols,
          testid: "filter-protocol", change: (value) => { remember(here, { protocol: value }); show(); } })),
        element("div", { class: "charts" }, names.map((name) => [chart(model, name, protocol), profile(model, name)])),
        ratesView(model, here).node,
        drivingView(model, here),
        element("h2", {}, "Why it collides"), causesView(model),
        element("h2", {}, `Its worst scenes, protocol ${protocol}`), worstScenes(model, protocol), element("p", {}, all),
        element("h2", {}, "What ran"), factsView(model),
      ].filter((node) => node !== null),
      destroy: () => hideNote(),
    };
  };

  /** @param {*} model @param {*} here @returns {{node: HTMLElement}} Rates of all its runs under all protocols. */
  function ratesView(model, here) {
    const lines = model.runs.flatMap((run) => window.CHALLENGER.protocols
      .map((protocol) => [run, protocol, own(run.protocols, protocol)]).filter(([, , found]) => found));
    const several = unique(model.runs.map((run) => run.data)).length > 1;
    const place = (run) => (several ? [run.data, run.split] : [run.split]);
    const cells = ([run, protocol, found]) => {
      const origin = (unit) => [unit, "samples", protocol, recordName(model, run)];
      const average = rateCell(found.collision?.avg, 100, origin("%"));
      return [...place(run).map(() => null), null, ...HORIZONS.map((horizon) => rateCell(found.collision?.[horizon], 100, origin("%"))),
        average, average, rateCell(found.l2?.avg, 1, origin("m")), null, null, null, null];
    };
    return tableView({
      id: "model", title: "Collision rate (%) and L2 (m) under every protocol", textColumns: several ? 3 : 2,
      notes: [`Collisions are with anybody. Scenes in which a sample hits the adversary first; ${UNDEFINED}: there is none, or
        neither the record nor the protocol says whom.`, ...(lines.some(([, , found]) => found.stale)
        ? ["‡ judged by an earlier version of the protocol; run challenger-bench rescore."] : [])],
      columns: [...(several ? ["data set"] : []), "split", "protocol", "col. 1s", "col. 2s", "col. 3s", "col. avg", "95 % of avg", "L2 avg",
        "scenes: adversary hit", "anybody hit", "counted", "coverage"],
      rows: lines.map(([run, protocol, found]) => [...place(run), found.stale ? `${protocol} ‡` : protocol,
        ...[...HORIZONS, "avg"].map((horizon) => rateText(found.collision?.[horizon])),
        intervalText(found.collision?.avg),
        found.l2?.avg && found.l2.avg.value !== null ? found.l2.avg.value.toFixed(2) : UNDEFINED,
        found.scenesHit ? found.scenesHit.join("/") : UNDEFINED, `${found.scenesFailed}/${found.scenesDecided}`, String(found.counted), percent(run.coverage, 1)]),
      cells: lines.map(cells),
    }, { sort: here.params.get("sort"), sorted: (order) => remember(here, { sort: order }) });
  }

  /** @param {*} model @param {string} data @param {string} protocol @returns {HTMLElement} Rate over horizon by split. */
  function chart(model, data, protocol) {
    const runs = model.runs.filter((run) => run.data === data && own(run.protocols, protocol)?.collision);
    const rates = runs.map((run) => HORIZONS.map((horizon) => run.protocols[protocol].collision[horizon]));
    const top = Math.max(0.01, ...rates.flat().flatMap((rate) => [rate?.value ?? 0, rate?.high ?? 0]));
    const step = [0.0025, 0.005, 0.01, 0.02, 0.05, 0.1, 0.25, 0.5].find((each) => top / each <= 4) ?? 0.5;
    return plot({
      label: `${model.name} on ${data}, protocol ${protocol}: collision rate at 1, 2 and 3 s; the numbers are below`,
      caption: `${data}, protocol ${protocol}: `, names: HORIZONS.map((horizon) => horizon.replace("s", " s")), rates,
      splits: runs.map((run) => run.split), step, limit: step * Math.ceil(top / step - 1e-9), without: "not judged by it",
    });
  }

  /** @param {*} model @param {string} data @returns {HTMLElement|null} Its profile of sub-scores by split. */
  function profile(model, data) {
    const runs = model.runs.filter((run) => run.data === data && run.driving);
    if (!runs.length) return null;
    return plot({
      label: `${model.name} on ${data}, nuscenes-pdm: mean of each driving sub-score; the numbers are below`,
      caption: `${data}, nuscenes-pdm: `, names: SUB_SCORES.map((name) => name.toUpperCase()),
      rates: runs.map((run) => SUB_SCORES.map((name) => run.driving.means[name])), splits: runs.map((run) => run.split),
      step: 0.25, limit: 1, without: "",
    });
  }

  /** @param {*} model @param {*} here @returns {HTMLElement|null} Driving scores of all its runs. */
  function drivingView(model, here) {
    const runs = model.runs.filter((run) => run.driving);
    if (!runs.length) return null;
    const names = ["score", "score_without_ec", ...SUB_SCORES];
    const heads = { score: "score", score_without_ec: "without EC" };
    return tableView({
      id: "driving", title: "Driving scores (%), nuscenes-pdm", textColumns: 2,
      notes: ["Sub-scores of NAVSIM's PDM family on plans for nuScenes: 3 s, no traffic lights, the route is the recorded path. No number "
        + "here compares with one that is published for NAVSIM.",
      ...(runs.some((run) => run.driving.stale)
        ? ["‡ judged by an earlier version of the definition; run challenger-bench rescore."] : [])],
      columns: ["data set", "split", ...names.map((name) => heads[name] ?? name.toUpperCase()), "counted"],
      rows: runs.map((run) => [run.data, run.driving.stale ? `${run.split} ‡` : run.split,
        ...names.map((name) => scoreText(run.driving.means[name])), String(run.driving.counted)]),
      cells: runs.map((run) => [null, null, ...names.map((name) => rateCell(run.driving.means[name], 100,
        ["%", "samples", "nuscenes-pdm", recordName(model, run)])), null]),
    }, { sort: here.params.get("sort"), sorted: (order) => remember(here, { sort: order }) }).node;
  }

  /** @param {*} rate @returns {string} */
  const scoreText = (rate) => (rate && rate.value !== null ? percent(rate.value, 1) : UNDEFINED);

  /** @param {*} given Names along the axis, a line of rates a split, and the axis of values. @returns {HTMLElement} */
  function plot({ label, caption, names, rates, splits, step, limit, without }) {
    const [left, right, upper, lower] = [44, 330, 12, 150];
    const apart = 285 / names.length;
    const middle = (index) => left - 7.5 + (index + 0.5) * apart;
    const x = (index, series) => middle(index) + (series - (splits.length - 1) / 2) * Math.min(9, apart / 4);
    const y = (value) => lower - (value / limit) * (lower - upper);
    const ticks = Array.from({ length: Math.round(limit / step) + 1 }, (_, index) => index * step);
    return element("figure", { class: "chart" },
      drawn("svg", { viewBox: "0 0 340 178", role: "img", "aria-label": label },
        ticks.map((tick) => [
          drawn("line", { x1: left, x2: right, y1: y(tick), y2: y(tick), class: "grid" }),
          drawn("text", { x: left - 6, y: y(tick) + 4, "text-anchor": "end" }, `${Number((100 * tick).toFixed(2))} %`)]),
        names.map((name, index) => drawn("text", { x: middle(index), y: 170, "text-anchor": "middle" }, name)),
        rates.map((line, series) => drawn("g", { class: "series", stroke: seriesColour(series), fill: seriesColour(series) },
          drawn("polyline", { fill: "none", points: line.map((rate, index) => ((rate?.value ?? null) === null ? ""
            : `${x(index, series)},${y(rate.value)}`)).join(" ") }),
          line.map((rate, index) => ((rate?.value ?? null) === null ? null : [
            rate.low === null ? null : drawn("line", { x1: x(index, series), x2: x(index, series), y1: y(rate.low),
              y2: y(Math.min(rate.high, limit)), class: "whisker" }),
            drawn("path", { d: shape(series, x(index, series), y(rate.value)) })]))))),
      element("figcaption", {}, element("span", {}, caption),
        splits.length ? splits.map((split, series) => element("span", { class: "key" }, sample(series), split)) : without));
  }

  const seriesColour = (series) => SERIES[series % SERIES.length];

  /** @param {number} series @param {number} x @param {number} y @returns {string} A mark: square, disc, triangle, ... */
  function shape(series, x, y) {
    return [
      `M${x - 4},${y - 4}h8v8h-8z`,
      `M${x - 4.5},${y}a4.5,4.5 0 1 0 9,0a4.5,4.5 0 1 0 -9,0z`,
      `M${x},${y - 5.5}l5,9h-10z`,
      `M${x},${y - 5.5}l5,5.5l-5,5.5l-5,-5.5z`,
    ][series % 4];
  }

  const sample = (series) => drawn("svg", { viewBox: "0 0 14 14", width: 14, height: 14, "aria-hidden": "true" },
    drawn("path", { d: shape(series, 7, 7), fill: seriesColour(series) }));

  /** @param {*} model @returns {HTMLElement} Causes of its collisions by split. */
  function causesView(model) {
    const { scenes } = window.CHALLENGER;
    const lines = model.runs.map((run) => {
      const counts = new Map();
      for (const scene of scenes.filter((each) => each.data === run.data && each.split === run.split)) {
        for (const [cause, count] of Object.entries(own(scene.causes, model.name) ?? {})) {
          counts.set(cause, (counts.get(cause) ?? 0) + count);
        }
      }
      const adversarial = scenes.some((each) => each.data === run.data && each.split === run.split && each.adversarial);
      return { run, counts, adversarial, sum: [...counts.values()].reduce((sum, count) => sum + count, 0) };
    }).filter(({ sum }) => sum > 0);
    if (!lines.length) return element("p", { class: "quiet" }, "No diagnosed collision under protocol exact.");
    const causes = ["unseen", "misforecast", "misplanned", "not attributable"];
    return element("dl", { class: "bars" }, lines.map(({ run, counts, adversarial, sum }) => [
      element("dt", {}, `${run.data}, ${run.split}: of ${counted(sum, "colliding sample")}${
        adversarial ? " with the adversary" : ""} under exact, `,
        causes.filter((cause) => counts.get(cause)).map((cause) => `${counts.get(cause)} ${cause}`).join(", ")),
      element("dd", { "aria-hidden": "true" }, causes.filter((cause) => counts.get(cause)).map((cause) => {
        const part = element("span", { class: `cause ${cause.replace(" ", "-")}` }, cause);
        part.style.flexGrow = String(counts.get(cause));
        return part;
      }))]));
  }

  /** @param {*} model @param {string} protocol @returns {HTMLElement} */
  function worstScenes(model, protocol) {
    const count = (scene) => own(scene.colliding, model.name) ?? 0;
    const found = window.CHALLENGER.scenes
      .filter((scene) => own(own(scene.verdicts, model.name) ?? {}, protocol) === true)
      .sort((a, b) => count(b) - count(a)).slice(0, 12);
    if (!found.length) return element("p", { class: "quiet" }, `It fails no scene under protocol ${protocol}.`);
    return element("div", { class: "cards" }, found.map((scene) => site.sceneCard(scene, protocol, model.name)));
  }

  /** @param {*} model @returns {HTMLElement} What ran: hashes, seed, code, data, machine. */
  function factsView(model) {
    const term = (name, value) => (value === null || value === undefined || value === "" ? null
      : [element("dt", {}, name), element("dd", {}, value)]);
    const hash = (text) => (text ? element("code", {}, text) : null);
    const settings = Object.entries(model.facts.settings).map(([name, value]) => `${name}: ${value}`).join("; ");
    return element("div", {},
      element("dl", { class: "facts" }, term("weights, SHA-256", hash(model.facts.weights) ?? "none"),
        term("seed", String(model.facts.seed)), term("settings", settings)),
      model.runs.map((run) => element("details", { class: "run" },
        element("summary", {}, `${run.data}, ${run.split}: ${counted(run.samples, "sample")} of ${counted(run.scenes, "scene")}`),
        element("dl", { class: "facts" },
          term("record", hash(run.record)), term("data, fingerprint", hash(run.fingerprint)),
          term("code, SHA-256", hash(run.code)), term("commit", run.commit ? hash(`${run.commit}${
            run.dirty === "true" ? " with changes" : ""}`) : "not known"),
          term("scenes", `${run.scenes} of ${run.scenesInSplit}, from ${run.recordings} recordings`),
          term("samples without a plan", String(run.failed)), term("plans", run.plansFrom),
          term("judged anew since", run.rescored ? "yes" : "no"),
          term("machine", Object.entries(run.hardware).map(([name, value]) => `${name}: ${value}`).join("; ")),
          term("packages", Object.entries(run.packages).map(([name, value]) => `${name} ${value}`).join(", "))))));
  }
})();
