"use strict";
/* Who survives a scene, how severe it is, and what is wrong with its adversary: on cards, in filters, on scene pages. */
(() => {
  const site = window.ChallengerSite;
  const { UNDEFINED, address, element, own, unique } = site;

  /** Verdicts to filter by; faults come behind them. */
  const VERDICTS = {
    solvable: ["somebody could avoid it", (said) => !said.unsolvable],
    unsolvable: ["nobody could avoid it", (said) => said.unsolvable],
    sound: ["adversary without fault", (said) => !said.faults.length],
    faulty: ["adversary with a fault", (said) => said.faults.length > 0],
  };
  const FAULT = "fault: ";

  /** @param {number|null|undefined} value @param {number} digits @param {string} unit @returns {string} */
  const amount = (value, digits, unit) =>
    value === null || value === undefined ? UNDEFINED : `${value.toFixed(digits)}${unit ? ` ${unit}` : ""}`;

  /** @param {number|null} margin @returns {string} Seconds with a sign. */
  const signed = (margin) => `${margin > 0 ? "+" : ""}${margin.toFixed(1)} s`;

  /** @param {string} name @returns {string} A reference driver in words. */
  const driver = (name) => window.CHALLENGER.drivers.find(([each]) => each === name)?.[1] ?? name;

  /** @returns {*[]} Scenes of which somebody said who survives them. */
  const judged = () => window.CHALLENGER.scenes.filter((scene) => scene.judgement);

  /** @param {*} scene @param {string} [model] @returns {*[]} How severe the plans of one planner, or of all, are. */
  const severities = (scene, model) => (model ? [own(scene.severity, model)].filter(Boolean)
    : Object.values(scene.severity));

  /** @param {*} scene @param {string} [model] @returns {*|null} The most severe contact of any planner, or of one; with
   * an adversary where there is one. */
  const hardest = (scene, model) => severities(scene, model).filter((each) => each.deltaV !== null)
    .reduce((worst, each) => (worst === null || each.deltaV > worst.deltaV ? each : worst), null);

  /** Orders of scenes: words, and a number, least first; what has none comes last.
   * @type {Object<string, [string, (scene: *, model?: string) => number|null|undefined]>} */
  const ORDERS = {
    severe: ["most severe contact first", (scene, model) => {
      const worst = hardest(scene, model);
      return worst ? -worst.deltaV : undefined;
    }],
    tight: ["least time to contact first", (scene) => scene.judgement?.ttc],
    late: ["shortest last chance first", (scene) => scene.judgement?.margin],
  };

  /** @returns {string[]} Faults that any adversary has. */
  const faults = () => unique(judged().flatMap((scene) => scene.judgement.faults)).sort();

  /** @param {URLSearchParams} params @returns {(scene: *) => boolean} Whether a scene is as the address asks. */
  function judgementFilter(params) {
    const [survivor, victim, verdict] = ["survives", "hits", "verdict"].map((name) => params.get(name) ?? "");
    if (!survivor && !victim && !verdict) return () => true;
    const fits = verdict.startsWith(FAULT) ? (said) => said.faults.includes(verdict.slice(FAULT.length))
      : own(VERDICTS, verdict)?.[1] ?? (() => true);
    return ({ judgement }) => judgement !== null && (!survivor || judgement.survives.includes(survivor))
      && (!victim || !judgement.survives.includes(victim)) && fits(judgement);
  }

  /** @returns {Object<string, string[]>} What an address may ask for. */
  const judgementKnown = () => {
    const names = judged().length ? window.CHALLENGER.drivers.map(([name]) => name) : [];
    return { survives: names, hits: names,
      verdict: judged().length ? [...Object.keys(VERDICTS), ...faults().map((fault) => FAULT + fault)] : [] };
  };

  /** @param {(label: string, name: string, values: *[], any: string) => HTMLElement} list Makes a choice.
   * @returns {HTMLElement[]} None where no scene was judged. */
  function judgementChoices(list) {
    if (!judged().length) return [];
    const verdicts = Object.entries(VERDICTS).map(([name, [words]]) => [name, words]);
    return [list("Survived by", "survives", window.CHALLENGER.drivers, "any"),
      list("Not survived by", "hits", window.CHALLENGER.drivers, "any"),
      list("Verdict", "verdict", [...verdicts, ...faults().map((fault) => [FAULT + fault, FAULT + fault])], "any")];
  }

  /** What a card says: who survives, the last chance, the most severe contact, faults.
   * @param {*} scene @param {string} [model] @returns {HTMLElement|null} */
  function judgementLine(scene, model) {
    const said = scene.judgement;
    const worst = hardest(scene, model);
    if (!said && !worst) return null;
    const careful = said?.survives.includes("cc");
    const drivers = window.CHALLENGER.drivers.length;
    const parts = [
      said?.unsolvable ? element("span", { class: "bad" }, "nobody could avoid it") : null,
      said && !said.unsolvable ? element("span", { class: careful ? "good" : "bad" },
        `careful human ${careful ? "survives" : "does not survive"}`) : null,
      said ? element("span", { title: `survived by ${said.survives.map(driver).join(", ") || "no reference driver"}` },
        `${said.survives.length} of ${drivers} drivers`) : null,
      said && said.margin !== null ? element("span", { title: "from when somebody could have reacted to the last chance" },
        `last chance ${signed(said.margin)}`) : null,
      worst ? element("span", { title: `most severe contact of a plan: impact at ${amount(worst.speed, 1, "m/s")}` },
        `delta-v ${amount(worst.deltaV, 1, "m/s")}`) : null,
      ...(said?.faults ?? []).map((fault) => element("span", { class: "bad" }, fault)),
    ].filter((part) => part !== null);
    return element("span", { class: "judged", "data-testid": "judged" }, parts.flatMap((part, place) =>
      (place ? [" · ", part] : [part])));
  }

  /** @param {*} scene @param {(name: string, ...value: *) => *} line Makes a line of facts.
   * @returns {*[]} What a scene's page says of it. */
  function judgementFacts(scene, line) {
    const said = scene.judgement;
    if (!said) return [];
    const link = (name, param) => element("a", { href: address(["scenes"], { split: scene.split, [param]: name }) }, driver(name));
    const listed = (names, param) => names.flatMap((name, place) => [...(place ? [", "] : []), link(name, param)]);
    const others = window.CHALLENGER.drivers.map(([name]) => name).filter((name) => !said.survives.includes(name));
    return [
      said.survives.length ? line("survived by", listed(said.survives, "survives")) : null,
      others.length ? line("not survived by", listed(others, "hits")) : null,
      said.unsolvable ? line("verdict", "nobody could avoid it") : null,
      said.margin !== null ? line("last chance", `${signed(said.margin)} from when somebody could have reacted`
        + (said.map ? "" : " (no map: it may lead off the road)")) : null,
      line("recorded ego", [`gap ${amount(said.gap, 2, "m")}`, `TTC ${amount(said.ttc, 2, "s")}`,
        `TET ${amount(said.tet, 1, "s")}`, `PET ${amount(said.pet, 1, "s")}`, `BTN ${amount(said.btn, 2, "")}`].join(", ")),
      line("adversary's faults", said.faults.join(", ") || "none",
        said.unknown.length ? element("div", { class: "quiet" }, `not known: ${said.unknown.join(", ")}`) : null),
    ];
  }

  /** @param {*} scene @returns {HTMLElement|null} How severe each planner's plans are in it. */
  function severityTable(scene) {
    const ran = window.CHALLENGER.models.filter((model) => own(scene.severity, model.name));
    if (!ran.length) return null;
    const verdict = (value) => (value === null ? UNDEFINED : value ? "yes" : "no");
    const { adversarial } = scene;
    return site.tableView({
      id: "severity", title: "How severe it is", textColumns: 1,
      columns: ["planner", "contacts", "at fault", "attributable", ...(adversarial ? ["with others"] : []), "kind",
        "impact, m/s", "delta-v, m/s", "P(fatal), %", "TTC, s", "gap, m"],
      groups: [["", 1], ["attack", adversarial ? 4 : 3], ["most severe contact", 4], ["without contact, least", 2]],
      rows: ran.map(({ name, privileged, miniature }) => {
        const of = own(scene.severity, name);
        return [site.marked({ name, privileged, miniature }), String(of.contacts), verdict(of.atFault),
          verdict(of.attributable), ...(adversarial ? [amount(of.bystanders, 0, "")] : []), of.kind ?? UNDEFINED,
          amount(of.speed, 1, ""),
          amount(of.deltaV, 1, ""), of.fatal === null ? UNDEFINED : (100 * of.fatal).toFixed(2), amount(of.ttc, 2, ""),
          amount(of.gap, 2, "")];
      }),
      notes: [`Contacts: samples whose plan touches ${adversarial ? "the adversary first" : "anybody"} within 3 s${
        adversarial ? "; with others: somebody else first" : ""}. At fault, attributable: whether any is the planner's
        fault, and whether the careful human survives the scene besides; ${UNDEFINED}: nobody can tell.`,
        "TTC, gap: plans without contact and the adversary (docs/severity.md)."],
    }).node;
  }

  Object.assign(site, { JUDGED_ORDERS: ORDERS, judgementChoices, judgementFacts, judgementFilter, judgementKnown,
    judgementLine, severityTable });
})();
