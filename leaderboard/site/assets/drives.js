"use strict";
/* Drives in closed loop: a page that plays one, and links to them from their scene. */
(() => {
  const site = window.ChallengerSite;
  const { AddressError, address, element, pages, remember } = site;

  /** @param {*} drive @returns {string} How it ended, in words. */
  function outcome({ end, contact, failure }) {
    if (end === "failed") return `failed (${failure}): nothing is scored`;
    if (!contact) return "no contact";
    const whom = `${contact.category}${contact.adversary ? ", the adversary" : ""}`;
    return `contact after ${contact.seconds.toFixed(1)} s with ${whom}, ${contact.at_fault ? "at fault" : "not at fault"}`;
  }

  /** @param {*} drive @returns {string} What was measured. */
  const measured = (drive) =>
    `${drive.world}${drive.family ? `, ${drive.family}` : ""}, sensor ${drive.sensor}${drive.runs > 1 ? `, run ${drive.run}` : ""}`;

  /** @param {*} scene @returns {HTMLElement|null} Its drives, if it has any. */
  function driveLinks(scene) {
    const drives = (window.CHALLENGER.drives ?? []).filter((each) => each.scene === scene.key);
    if (!drives.length) return null;
    return element("section", { "data-testid": "drives" }, element("h2", {}, "Driven in closed loop"),
      element("ul", {}, drives.map((each) => element("li", {},
        each.key ? element("a", { href: address(["drive", each.key]) }, site.marked({ ...each, name: each.planner }))
          : site.marked({ ...each, name: each.planner }),
        ` ${measured(each)}: ${outcome(each)}`))));
  }

  pages.drive = (here) => {
    const drive = (window.CHALLENGER.drives ?? []).find(({ key }) => key !== null && key === here.parts[1]);
    if (!drive) throw new AddressError(`There is no drive with the key “${here.parts[1] ?? ""}”.`);
    const scene = window.CHALLENGER.scenes.find(({ key }) => key === drive.scene);
    const node = element("div", { class: "player-place", "data-testid": "player" });
    const asked = Number(here.params.get("t") ?? NaN);
    let player = null;
    return {
      title: `${drive.planner} drives`,
      nodes: [
        element("h1", {}, site.marked({ ...drive, name: drive.planner }), " drives ",
          scene ? element("a", { href: address(["scene", scene.key]) }, scene.scene) : "a scene"),
        element("p", {}, `Closed loop: ${measured(drive)}; ${outcome(drive)}.`),
        element("p", { class: "remark", "data-testid": "drive-note" },
          "Green is the driven ego, the pale dashes are the recorded path, the line with marks is the plan of each instant. ",
          drive.adversary ? "Orange is the adversary as it drove. " : "",
          drive.everybody ? "The others are where the recording has them."
            : `Only the ego ${drive.adversary ? "and the adversary are" : "is"} shown as driven: the record does not hold where the others went. challenger-bench film --drives shows everybody.`),
        node,
      ],
      ready() {
        player = window.ChallengerPlayer.mount(node, drive.key, {
          t: Number.isFinite(asked) ? asked : undefined,
          models_order: window.CHALLENGER.models.map((model) => model.name),
          onState: (state) => remember(here, { t: state.t }),
        });
      },
      destroy: () => player?.destroy(),
    };
  };

  Object.assign(site, { driveLinks });
})();
